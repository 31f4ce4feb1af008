"""Equilibrium of a solid by Newton's method."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import partial

import numpy as np
from numpy.typing import ArrayLike

from ..errors import InputError
from ..fem import solve
from ..fem.conjugate_gradients import Coarse, Kept, Preconditioner
from ..fem.points import checked_vector, held_of, mask_of
from ..parallel import global_norm, global_sum, together
from .solid import Form, Response, Solid

FIRST_FORCING, LARGEST_FORCING, GAMMA = 1e-2, 0.03, 0.9  # Eisenstat and Walker, choice 2
MOST_GRADIENTS = 80  # of a loose solve by multigrid: with more the tangent is about to lose stiffness along a direction
LEAST_STIFFENING = 1 / 8  # of what leaves no direction without stiffness
ENOUGH = 1e-4  # part of the expected fall that a step must reach
MOST_CUTS = 20
ROUNDING = 1e-10  # of potentials


@dataclass(frozen=True, eq=False)
class EquilibriumReport:
    """How Newton's method went; the same on all ranks."""

    converged: bool
    reason: str
    residuals: Sequence[float] = field(repr=False)  # N, L2 over free unknowns, before each iteration and at the end
    size: float  # N, L2 of internal forces and loads of all nodes: the residual is measured by it
    gradients: Sequence[int]  # iterations of CG, for each of Newton's
    lengths: Sequence[float]  # of steps, 1 unless the line search cut them
    energy: float  # J

    @property
    def iterations(self) -> int:
        """How many of Newton's there were."""
        return len(self.gradients)


def equilibrium(
    solid: Solid,
    *,
    fixed: ArrayLike,
    values: ArrayLike | float = 0.0,
    load: ArrayLike | None = None,
    start: ArrayLike | None = None,
    even: ArrayLike | None = None,
    tolerance: float = 1e-9,
    linear_tolerance: float | None = None,
    most_iterations: int = 30,
    form: Form = "current",
    preconditioner: Preconditioner = "p-multigrid",
    coarse: Coarse = "geometric",
    kept: Kept | None = None,
) -> tuple[np.ndarray, EquilibriumReport]:
    """Return the displacement (nodes, 3) in m at which internal forces are the `load` (nodes, 3) in N, and how it was found.

    Unknowns that are `fixed`, a mask (nodes,) or (nodes, 3), go to their `values` in m. The residual of the others falls to
    `tolerance` times the size of all forces. Linear solves end by Eisenstat and Walker's rule, or at `linear_tolerance`; where
    the tangent is not positive along a direction, or hardly, it is made stiffer until it is, by an eighth and twice as much
    each time, and half as much in the next iteration. Steps are halved until all det F are positive and the potential falls, or
    the residual does and the potential does not rise; those of stiffer tangents are doubled while it falls. The first step
    takes the walls along; it is halved towards `even`, a displacement (nodes, 3) in m that has their values, if that is given
    and leaves det F positive. What is `kept` of the preconditioner goes on to the next solve. What was reached is returned,
    converged or not. Collective; InputError on all ranks for arrays of other shapes.
    """
    constrained, target, force = _conditions(solid, fixed, values, load)
    u = np.zeros(target.shape) if start is None else _vector(solid, start, "start").copy()
    state, size = solid.respond(u), 0.0
    residuals: list[float] = []
    gradients: list[int] = []
    lengths: list[float] = []
    solved = partial(solve, fixed=constrained, preconditioner=preconditioner, coarse=coarse, kept=kept or Kept())
    if linear_tolerance is None and preconditioner == "p-multigrid":
        solved = partial(solved, most_iterations=MOST_GRADIENTS)
    before, stiffening, reason = None, 0.0, "it took the most iterations"
    for iteration in range(most_iterations + 1):
        residual, jump, energy = force - state.force, np.where(constrained, target - u, 0.0), state.energy
        moving = _norm(solid, jump) > 0
        residuals.append(_norm(solid, np.where(constrained, 0.0, residual)))
        size = max(size, _norm(solid, state.force) + _norm(solid, force))
        del state
        if residuals[-1] <= tolerance * size and not moving:
            reason = "the tolerance was met"
            break
        if iteration == most_iterations:
            break
        forcing = FIRST_FORCING if moving else _forcing(residuals[-1], before, tolerance * size)
        part = 0.0 if moving else stiffening
        eta = LARGEST_FORCING if part > 0 else linear_tolerance or forcing
        # Tangents hold 17 numbers a point: one at a time.
        step, linear = solved(solid.tangent(u, form, part), residual, values=jump, tolerance=eta)
        before = linear.residuals[0]
        gradients.append(linear.iterations)
        while not (linear.converged or moving or part == 1):
            part = min(max(2 * part, LEAST_STIFFENING), 1.0)
            step, linear = solved(solid.tangent(u, form, part), residual, tolerance=LARGEST_FORCING)
            gradients[-1] += linear.iterations
        stiffening = part / 2 if part > LEAST_STIFFENING else 0.0
        search = None
        if moving and even is not None:
            displacement = _vector(solid, even, "the even displacement")
            state = solid.respond(displacement)
            if state.smallest_j > 0:
                step, u = u + step - displacement, displacement
                residual, energy, moving, search = force - state.force, state.energy, False, (displacement, state, 0.0)
        search = _searched(solid, u, step, residual, energy, force, constrained, moving, size) or search
        if search is not None and part > 0:
            search = _farther(solid, u, step, force, search)
        if search is None:
            reason = "no part of a step leaves det F positive and lowers the residual or the potential"
            break
        u, state, length = search
        del search, step
        if moving and length == 1:
            u[constrained] = target[constrained]
        lengths.append(length)
    converged = reason == "the tolerance was met"
    return u, EquilibriumReport(converged, reason, residuals, size, gradients, lengths, energy)


def _forcing(residual: float, before: float | None, enough: float) -> float:
    """The tolerance of a linear solve: as the residual fell in the last iteration, and no lower than is of use."""
    eta = min(LARGEST_FORCING, GAMMA * (residual / before) ** 2) if before else FIRST_FORCING
    return max(eta, min(LARGEST_FORCING, 0.3 * enough / residual))


def _searched(
    solid: Solid,
    u: np.ndarray,
    step: np.ndarray,
    residual: np.ndarray,
    energy: float,
    force: np.ndarray,
    constrained: np.ndarray,
    moving: bool,
    size: float,
) -> tuple[np.ndarray, Response, float] | None:
    """Where a step or a part of it leads that is good enough; None if there is none. Collective.

    While walls move, potentials and residuals of both ends are not comparable, and det F alone decides. Elsewhere the potential
    must not rise: the residual also falls towards states that are not stable. It is known but to the rounding of what it is the
    sum of, about forces of this `size` times the width of an element.
    """
    norm, slope = _norm(solid, np.where(constrained, 0.0, residual)), _dot(solid, residual, step)
    work = _dot(solid, force, u)
    potential, uncertain = energy - work, ROUNDING * (abs(energy) + abs(work) + size * float(solid.mesh.spacing.max()))
    length = 1.0
    for _ in range(MOST_CUTS):
        trial = u + length * step
        response = solid.respond(trial)
        if response.smallest_j > 0:
            if moving:
                return trial, response, length
            change = response.energy - _dot(solid, force, trial) - potential
            left = _norm(solid, np.where(constrained, 0.0, force - response.force))
            if change <= -ENOUGH * length * slope < 0 or (change <= uncertain and left <= (1 - ENOUGH * length) * norm):
                return trial, response, length
        length /= 2
    return None


def _farther(
    solid: Solid, u: np.ndarray, step: np.ndarray, force: np.ndarray, search: tuple[np.ndarray, Response, float]
) -> tuple[np.ndarray, Response, float]:
    """Where a step leads that was found where the tangent is not positive, which says little of its length. Collective.

    It is doubled while the potential falls.
    """
    trial, response, length = search
    for _ in range(MOST_CUTS if length == 1 else 0):  # what is longer than a step that was cut is known not to be good
        beyond = u + 2 * length * step
        response_beyond = solid.respond(beyond)
        if not (
            response_beyond.smallest_j > 0
            and response_beyond.energy - response.energy < _dot(solid, force, beyond - trial)
        ):
            break
        trial, response, length = beyond, response_beyond, 2 * length
    return trial, response, length


def _conditions(
    solid: Solid, fixed: ArrayLike, values: ArrayLike | float, load: ArrayLike | None
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    count = len(solid.mesh.node_indices)
    with together(solid.mesh.comm, InputError):
        constrained = mask_of(fixed, count, 3, f"({count}, 3) there")
        target = held_of(values, (count, 3))
    force = np.zeros((count, 3)) if load is None else _vector(solid, load, "the load")
    return constrained, target, force


def _vector(solid: Solid, values: ArrayLike, name: str) -> np.ndarray:
    return checked_vector(solid.mesh, values, name, 3)[0].reshape(-1, 3)


def _dot(solid: Solid, a: np.ndarray, b: np.ndarray) -> float:
    return global_sum(solid.mesh.comm, float((a * b).sum()))


def _norm(solid: Solid, a: np.ndarray) -> float:
    return global_norm(solid.mesh.comm, a)

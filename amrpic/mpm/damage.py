"""Damage of a solid, and its equilibrium with damage, in turns."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from .. import _native
from ..errors import SolverError
from ..fem import Kept, Operator, Points, solve
from ..fem.points import mask_of
from ..parallel import global_max, global_norm
from .equilibrium import EquilibriumReport, equilibrium
from .solid import Solid

OF_DAMAGE = 1e-4  # tolerance of the damage of nodes, over that of forces that it may move
MOST_BEYOND = 4.0  # the longest step of damage, over the change that a turn leads to
FIRST_WITHIN, WITHIN = 3e-2, 0.3  # tolerances of equilibrium in the first turn, and over what the last one left
WEAK = (
    1e-3  # of the largest G/ℓ: what materials that do not break have of it, so that damage goes on smoothly into them
)


@dataclass(frozen=True, eq=False)
class DamageReport:
    """How displacement and damage came together; the same on all ranks."""

    converged: bool
    turns: int
    residuals: Sequence[
        float
    ]  # of equilibrium with the damage that it led to, over the size of forces, after each turn
    equilibria: Sequence[EquilibriumReport]
    growth: float = 0.0  # of the damage of a point, at most

    @property
    def most_iterations(self) -> int:
        """Newton iterations of an equilibrium, at most."""
        return max(equilibrium.iterations for equilibrium in self.equilibria)

    @property
    def reason(self) -> str:
        """How it ended."""
        last = self.equilibria[-1]
        if self.converged or not last.converged:
            return last.reason
        left = self.residuals[-1]
        return f"after {self.turns} turns damage has grown by {self.growth:.2g} and moves {left:.1e} of the forces"


@dataclass(frozen=True, eq=False)
class Settled:
    """A solid in equilibrium: its displacement (nodes, 3) in m, damage at nodes, and what points have seen."""

    displacement: np.ndarray
    damage: np.ndarray
    solid: Solid


class _DamageOperator(Operator):
    def __init__(self, points: Points, native: _native.FemOperator) -> None:
        self.points, self.mesh, self.components, self.native = points, points.mesh, 1, native


def damage_field(
    solid: Solid,
    driving: np.ndarray,
    *,
    fixed: ArrayLike | None = None,
    values: ArrayLike | float = 0.0,
    start: np.ndarray | None = None,
    tolerance: float = 1e-12,
) -> np.ndarray:
    """Return the damage of nodes (nodes,) for the largest driving energy of points, (n,) in J/m³. Collective.

    2 (1 - k)(1 - d) H = G/ℓ (d - ℓ² Δd), which is linear in d: integrals are over initial volumes, gradients in the mesh as it
    is. Nodes that are `fixed` have `values`; those whose elements hold no material that breaks have none. In other
    materials beside such a thousandth of the largest G/ℓ continues the field, which few points would not determine. The solve
    begins at `start`, which has these values. SolverError on all ranks if it does not end.
    """
    surface, length = solid.surface_and_length()
    breaks = surface > 0
    own = [(m.damage.toughness / m.damage.length, m.damage.length) for m in solid.materials if m.damage]
    strongest, longest = np.max(own, axis=0) if own else (0.0, 0.0)
    surface, length = np.where(breaks, surface, WEAK * strongest), np.where(breaks, length, longest)
    left = np.array([2 * (1 - m.damage.residual) if m.damage else 0.0 for m in solid.materials])[solid.material]
    source = np.ascontiguousarray(left * driving)
    points, volume = solid.points, solid.initial_volume
    operator = _DamageOperator(points, _native.mpm_damage(points.native, volume, source, surface, length))
    of_breaking = _DamageOperator(points, _native.mpm_damage(points.native, volume, source, surface * breaks, length))
    mask = np.zeros(len(solid.mesh.node_indices), dtype=bool) if fixed is None else np.asarray(fixed)
    empty = of_breaking.diagonal() <= 0
    fixed_values = np.where(mask, np.broadcast_to(values, mask.shape), 0.0)
    right, free = points.integrate(source / solid.j), ~(mask | empty)
    begin = fixed_values if start is None else start
    at_zero, at_begin = ((right - operator @ d) * free for d in (fixed_values, begin))
    within = tolerance * global_norm(solid.mesh.comm, at_zero)
    if (first := global_norm(solid.mesh.comm, at_begin)) <= within:
        return begin
    change, report = solve(operator, at_begin, fixed=~free, preconditioner="jacobi", tolerance=within / first)
    if not report.converged:
        raise SolverError(f"damage was not found in {report.iterations} iterations: {report.reason}")
    return begin + change


def settle(
    solid: Solid,
    *,
    fixed: ArrayLike,
    tolerance: float = 1e-8,
    damage_tolerance: float | None = None,
    most_turns: int = 100,
    most_growth: float = math.inf,
    start: ArrayLike | None = None,
    **conditions: Any,
) -> tuple[Settled, DamageReport]:
    """Return the equilibrium of a solid that may break, and how it was found. Collective.

    Displacement and damage are found in turns, each with the other as it is, until the forces that the displacement leaves with
    the damage that it leads to are within `damage_tolerance`, by default `tolerance`, of the size of all; then the displacement
    is found once more, to `tolerance`. Before that it is found no better than of use. From the third turn on damage goes beyond
    what the one before led to, up to four times as far. `conditions` and the rest are those of `equilibrium`. The driving
    energy of points grows from what the solid had before, whatever turns pass through. Turns end without convergence where the
    damage of a point grows by more than `most_growth`. What was reached is returned, converged or not.
    """
    u, enough = start, damage_tolerance or tolerance
    if not any(m.damage for m in solid.materials):
        u, report = equilibrium(solid, fixed=fixed, tolerance=tolerance, start=u, **conditions)
        nodes, last = np.zeros(len(solid.mesh.node_indices)), report.residuals[-1] / (report.size or 1)
        return Settled(u, nodes, solid), DamageReport(report.converged, 1, [last], [report])
    conditions.setdefault("kept", Kept())
    now, breaks, growth = solid, solid.surface_and_length()[0] > 0, 0.0
    residuals: list[float] = []
    reports: list[EquilibriumReport] = []
    past: list[tuple[np.ndarray, np.ndarray]] = []  # damage of nodes in a turn, and what it led to
    nodes = np.zeros(len(solid.mesh.node_indices))

    def damaged(nodes: np.ndarray) -> Solid:
        return solid.with_damage(breaks * np.clip(solid.points.values(nodes), 0, 1), driving)

    for turn in range(most_turns):
        within = max(tolerance, min(FIRST_WITHIN, WITHIN * residuals[-1])) if residuals else FIRST_WITHIN
        u, report = equilibrium(now, fixed=fixed, tolerance=within, start=u, **conditions)
        reports.append(report)
        if not report.converged:
            residuals.append(report.residuals[-1] / (report.size or 1))
            break
        driving = np.maximum(solid.driving, now.energies(u)[1])
        used, nodes = nodes, damage_field(solid, driving, start=nodes, tolerance=max(OF_DAMAGE * enough, 1e-12))
        now = damaged(nodes)
        residuals.append(_apart(now, u, fixed, conditions.get("load")) / (report.size or 1))
        growth = global_max(solid.mesh.comm, float((now.damage - solid.damage).max(initial=0.0)))
        if residuals[-1] <= enough or growth > most_growth:
            break
        past = [*past[-1:], (used, nodes)]
        if turn > 1:
            nodes = _farther_on(solid, past)
            now = damaged(nodes)
    assert isinstance(u, np.ndarray)
    converged = reports[-1].converged and residuals[-1] <= enough and growth <= most_growth
    if converged and residuals[-1] > tolerance:
        u, report = equilibrium(now, fixed=fixed, tolerance=tolerance, start=u, **conditions)
        reports.append(report)
        now = now.with_damage(now.damage, np.maximum(solid.driving, now.energies(u)[1]))
        converged = report.converged
    return Settled(u, nodes, now), DamageReport(converged, len(residuals), residuals, reports, growth)


def _farther_on(solid: Solid, past: Sequence[tuple[np.ndarray, np.ndarray]]) -> np.ndarray:
    """Return nodes' damage for the next turn: the change that the last one led to, times Barzilai and Borwein's step length.

    Collective. The step length is at least 1: turns leave states that are not stable, and shorter steps could hold them there.
    """
    (x, led_x), (y, led_y) = past
    moved, less = y - x, (led_x - x) - (led_y - y)
    squares, products = solid.mesh.comm.allreduce(np.array([moved @ moved, moved @ less]))
    by = min(squares / products, MOST_BEYOND) if products > 0 else MOST_BEYOND
    return np.asarray(y + max(by, 1.0) * (led_y - y))


def _apart(solid: Solid, u: np.ndarray, fixed: ArrayLike, load: ArrayLike | None) -> float:
    """The L2 norm of what is not in equilibrium. Collective."""
    residual = solid.respond(u).force - (0.0 if load is None else np.asarray(load))
    constrained = mask_of(fixed, len(residual), 3, f"({len(residual)}, 3) there")
    return global_norm(solid.mesh.comm, np.where(constrained, 0.0, residual))

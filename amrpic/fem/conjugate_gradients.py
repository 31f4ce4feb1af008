"""Linear systems of operators at points, by conjugate gradients."""

from __future__ import annotations

import time
from dataclasses import dataclass
from operator import index
from typing import Literal, get_args

import numpy as np
from numpy.typing import ArrayLike

from .. import _native
from ..errors import InputError, SolverError
from ..parallel import together
from .operators import Operator, Poisson
from .points import checked_vector, held_of, mask_of, shaped

MOST_ITERATIONS = 2**31 - 1
Preconditioner = Literal["none", "jacobi", "p-multigrid"]  # in the order of the native ones
Coarse = Literal["geometric", "aggregation"]  # two of the last kind
WORSE = 2.0  # by so much than in the solve before: what is kept is made anew


@dataclass(frozen=True, eq=False)
class SolveReport:
    """How a solve went; the same on all ranks, except its time."""

    converged: bool
    iterations: int
    residuals: np.ndarray  # L2 norms over free unknowns, the first one with these at zero
    seconds: float
    reason: str  # why it stopped


class Kept:
    """What a preconditioner keeps for the solves after it, of operators that change little, with the same nodes fixed.

    Its coarser levels are made in the first solve, and again after one that took twice as many iterations for what it gained
    as the one before.
    """

    native: _native.FemMultigrid | None = None
    cost = np.inf  # iterations for each factor e of the residual in the last solve

    def after(self, residuals: np.ndarray, native: _native.FemMultigrid | None) -> None:
        """Note how a solve went, and what it leaves to keep."""
        fall = residuals[0] / residuals[-1] if residuals[-1] > 0 else np.inf
        cost = (len(residuals) - 1) / np.log(max(fall, 1.001))
        self.native, self.cost = None if cost > WORSE * self.cost else native, cost


def solve(
    operator: Operator,
    f: ArrayLike,
    *,
    fixed: ArrayLike | None = None,
    values: ArrayLike | float = 0.0,
    preconditioner: Preconditioner = "p-multigrid",
    coarse: Coarse = "geometric",
    tolerance: float = 1e-10,
    most_iterations: int = 10_000,
    kept: Kept | None = None,
) -> tuple[np.ndarray, SolveReport]:
    """Return the solution u of operator @ u = f, and how it was found. Collective.

    Nodes that are `fixed`, a mask (nodes,) or (nodes, components), have `values`, a number or a vector, in place of their
    equations. The residual comes down to `tolerance` times what it is with all others at zero.

    "p-multigrid" goes from the elements' degree to degree 1 at the same points, and from there to half the elements along each
    axis, and so on; with coarse = "aggregation" by MueLu's smoothed aggregates. What is `kept` of it serves the next solve.

    Raises on all ranks InputError for arrays of other shapes or with values that are not finite, options that do not exist, and
    Poisson's equation without a fixed node whose right-hand side does not add up to zero; and SolverError for free nodes whose
    elements have no points, and for numbers whose squares double precision cannot hold.
    """
    mesh, components = operator.mesh, operator.components
    right, _ = checked_vector(mesh, f, "the right-hand side", components)
    with together(mesh.comm, InputError):
        mask = _mask(operator, fixed)
        constrained = _held(operator, values)
        if preconditioner not in get_args(Preconditioner):
            raise InputError(f'preconditioner is "{preconditioner}"; use {", ".join(get_args(Preconditioner))}')
        if coarse not in get_args(Coarse):
            raise InputError(f'coarse is "{coarse}"; use {" or ".join(get_args(Coarse))}')
        _require_limits(tolerance, most_iterations)
        _require_finite(right[~mask], "the right-hand side of a free node")
        _require_finite(constrained[mask], "the value of a fixed node")
    if isinstance(operator, Poisson):
        _require_balance(operator, right, mask, tolerance)
    start = time.perf_counter()
    try:
        u, residuals, curved_down, native = operator.native.solve(
            right,
            mask,
            constrained,
            _number(preconditioner, coarse),
            tolerance,
            most_iterations,
            kept.native if kept else None,
        )
    except _native.SolverError as refused:
        raise SolverError(str(refused)) from None
    if not np.isfinite(residuals[0]):
        raise SolverError(f"the residual to start from is {residuals[0]}, beyond double precision; use other units")
    if kept:
        kept.after(residuals, native)
    converged = bool(residuals[-1] <= tolerance * residuals[0])
    reason = (
        "the tolerance was met"
        if converged
        else "the operator is not positive along a direction"
        if curved_down
        else "it took the most iterations"
    )
    report = SolveReport(converged, len(residuals) - 1, residuals, time.perf_counter() - start, reason)
    return shaped(u, components), report


def _require_limits(tolerance: float, most_iterations: int) -> None:
    try:
        share, most = float(tolerance), index(most_iterations)
    except (TypeError, ValueError):
        raise InputError(
            f"tolerance is {tolerance!r} and most_iterations {most_iterations!r}; give a number below 1, and a whole one"
        ) from None
    if not 0 < share < 1:
        raise InputError(f"tolerance is {share}; give a number between 0 and 1, for instance 1e-10")
    if not 1 <= most <= MOST_ITERATIONS:
        raise InputError(f"most_iterations is {most}; give 1 to {MOST_ITERATIONS}")


def _require_finite(values: np.ndarray, name: str) -> None:
    if not (good := np.isfinite(values)).all():
        raise InputError(
            f"{name} is {values[np.argmin(good)]}, as {int((~good).sum())} are not finite on a rank; give numbers"
        )


def _require_balance(operator: Poisson, right: np.ndarray, mask: np.ndarray, tolerance: float) -> None:
    """InputError on all ranks for a component of which no node is fixed, and what constants see of the right-hand side, its
    sum over √nodes, is more than the residual may be: no u has a residual without it."""
    components, comm = operator.components, operator.mesh.comm
    f, constrained = right.reshape(-1, components), mask.reshape(-1, components)
    counts = np.stack([constrained.sum(axis=0), f.sum(axis=0), (f**2).sum(axis=0), np.full(components, len(f))])
    fixed, total, squares, nodes = comm.allreduce(counts)
    if not (alone := (fixed == 0) & (np.abs(total) > tolerance * np.sqrt(squares.sum() * nodes))).any():
        return
    at = int(np.argmax(alone))
    raise InputError(
        f"no node is fixed{f' in component {at}' if components > 1 else ''}, and the right-hand side adds up to "
        f"{total[at]:.2e} there, not zero, so that Poisson's equation has no solution; fix a node, or balance f"
    )


def _number(preconditioner: Preconditioner, coarse: Coarse) -> int:
    """The native solver's number of a preconditioner."""
    by_aggregates = preconditioner == "p-multigrid" and coarse == "aggregation"
    return get_args(Preconditioner).index(preconditioner) + int(by_aggregates)


def _mask(operator: Operator, fixed: ArrayLike | None) -> np.ndarray:
    count, components = len(operator.mesh.node_indices), operator.components
    if fixed is None:
        return np.zeros(count * components, dtype=bool)
    return mask_of(fixed, count, components, f"({count},) or ({count}, {components})").reshape(-1)


def _held(operator: Operator, values: ArrayLike | float) -> np.ndarray:
    count, components = len(operator.mesh.node_indices), operator.components
    return np.ascontiguousarray(held_of(values, (count,) if components == 1 else (count, components))).reshape(-1)

"""A problem as the native solver takes it, and what it finds."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np
import scipy
from numpy.typing import ArrayLike

from .. import _native
from ..errors import InputError
from .functionals import Basis, Functional, Native, stacked
from .inputs import finite
from .neighbours import Neighbours
from .samples import Components, Samples
from .spaces import Space
from .targets import Exact, Wanted, names
from .weights import Weight

RESIDUAL_BOUND = 1e-9  # of reproduction, above which a stencil is not used
SPARE = 1.5  # times the entries that are known of, if reaches should grow; untouched, it takes no memory
SUM_BOUND = 1e6  # of Σ|α λ| over the largest |τ|, the same
UNDETERMINED, DEPENDENT, ONE_SIGN, NO_SIGN = 3, 4, 5, 6  # places in PATHS of stencils.py


@dataclass
class SolvedWeights:
    """Weights and their judgements; arrays as in `Stencils` and `Quality`."""

    start: np.ndarray
    index: np.ndarray
    weights: np.ndarray
    exact_weights: np.ndarray
    path: np.ndarray
    judgements: np.ndarray  # (3, n): pivot, residual, sum


def merged(
    parts: Sequence[tuple[np.ndarray, SolvedWeights]], count: int, room: Callable[[int], np.ndarray] | None = None
) -> SolvedWeights:
    """Return the solution of `count` targets from parts, of ascending targets each; later parts replace earlier ones.

    room: gives the (entries, rows) to write weights to, where those of the first part may lie already if no later one of a
    target is shorter.
    """
    if len(parts) == 1:
        return parts[0][1]
    source, place = np.zeros(count, dtype=int), np.zeros(count, dtype=int)
    for number, (targets, _) in enumerate(parts):
        source[targets], place[targets] = number, np.arange(len(targets))
    rows, exact_rows = parts[0][1].weights.shape[1], parts[0][1].exact_weights.shape[1]
    lengths = np.empty(count, dtype=np.int64)
    exact, path, judgements = np.empty((count, exact_rows, rows)), np.empty(count, np.int8), np.empty((3, count))
    for number, (_, part) in enumerate(parts):
        own_targets = source == number
        at = place[own_targets]
        lengths[own_targets] = np.diff(part.start)[at]
        exact[own_targets], path[own_targets], judgements[:, own_targets] = (
            part.exact_weights[at],
            part.path[at],
            part.judgements[:, at],
        )
    start = np.concatenate([[0], lengths.cumsum()])
    index, weights = np.empty(start[-1], np.int32), np.empty((start[-1], rows)) if room is None else room(start[-1])
    runs = pairwise(np.flatnonzero(np.diff(source, prepend=-1, append=-1)))  # of one part side by side
    for first, last in reversed(list(runs)):  # the last ones first, as those of the first part only move up
        of, at = parts[source[first]][1], place[first]
        entries = slice(of.start[at], of.start[at + last - first])
        index[start[first] : start[last]] = of.index[entries]
        weights[start[first] : start[last]] = of.weights[entries]
    return SolvedWeights(start, index, weights, exact, path, judgements)


class Collected:
    """Solutions of runs of targets, one run after the other, in arrays that are written once.

    `room` is where the weights of the next run may be written; memory that nobody writes to is not there yet.
    """

    def __init__(self, near: Neighbours, problem: Problem) -> None:
        count, self.rows = len(near), max(s.stop for s, _ in problem.rows.values())
        entries = int(len(near.index) * problem.per_site * SPARE)
        self._index, self._weights = np.empty(entries, np.int32), np.empty((entries, self.rows))
        self._start = np.zeros(count + 1, np.int64)
        self._exact = np.empty((count, len(problem.exact), self.rows))
        self._path, self._judgements = np.empty(count, np.int8), np.empty((3, count))
        self._targets = 0

    def room(self, entries: int) -> np.ndarray:
        """(entries, rows) of the weights, the next ones."""
        filled = int(self._start[self._targets])
        needed = filled + entries
        if needed > len(self._index):
            old = self._index, self._weights
            self._index, self._weights = (np.empty((int(needed * SPARE), *a.shape[1:]), a.dtype) for a in old)
            self._index[:filled], self._weights[:filled] = old[0][:filled], old[1][:filled]
        return self._weights[filled:needed]

    def add(self, solution: SolvedWeights) -> None:
        """Take the solution of the next targets, whose weights are in the room already or not."""
        room = self.room(len(solution.index))
        if solution.weights.base is not self._weights:
            room[:] = solution.weights
        filled = int(self._start[self._targets])
        self._index[filled : filled + len(solution.index)] = solution.index
        run = slice(self._targets, self._targets + len(solution.path))
        self._start[run.start + 1 : run.stop + 1] = filled + solution.start[1:]
        self._exact[run], self._path[run], self._judgements[:, run] = (
            solution.exact_weights,
            solution.path,
            solution.judgements,
        )
        self._targets = run.stop

    def all(self) -> SolvedWeights:
        """Return the solution of all."""
        index, weights = (a[: int(self._start[-1])] for a in (self._index, self._weights))
        return SolvedWeights(self._start, index, weights, self._exact, self._path, self._judgements)


@dataclass(frozen=True, eq=False)
class Problem:
    """Targets, and functionals as rows of arrays; the neighbours come later, since they may grow."""

    targets: np.ndarray
    space: Space
    components: int
    basis: np.ndarray
    sites: np.ndarray
    per_site: int  # samples for each site
    samples: Native | None
    wanted: Native
    exact: tuple[Native, ...]
    present: np.ndarray  # (n, exact rows) bool
    split: tuple[
        tuple[int, int, int], ...
    ]  # (row of a vector, component, row of a scalar), where components fall apart
    rows: dict[str, tuple[slice, tuple[int, ...]]]
    weight: Weight
    aspect: tuple[float, float, float]
    portable: bool

    def of(self, targets: np.ndarray | slice) -> Problem:
        """Return the problem of some of its targets."""
        return replace(
            self,
            targets=self.targets[targets],
            wanted=_some(self.wanted, targets),
            exact=tuple(_some(e, targets) for e in self.exact),
            present=self.present[targets],
        )

    def solve(self, near: Neighbours, room: np.ndarray | None = None) -> SolvedWeights:
        """Return the stencils; the weights of those that cannot be determined hold anything.

        Weights are written to `room`, (entries, rows), where they are solved for all at once.
        """
        if self.per_site > 1 and not self.split:
            near = Neighbours(*_per_component(near, self.per_site), near.reach)
        if self.present.all():
            solution = self._solve(near, np.ones(len(self.exact), bool), None if self.split else room)
        else:  # targets with the same exact rows together
            kinds, kind = np.unique(self.present, axis=0, return_inverse=True)
            groups = [np.flatnonzero(kind.ravel() == number) for number in range(len(kinds))]
            parts = [
                (g, self.of(g)._solve(near.of(g), kinds_present))
                for g, kinds_present in zip(groups, kinds, strict=True)
            ]
            solution = merged(parts, len(near))
        return self._expanded(solution) if self.split else solution

    def _solve(self, near: Neighbours, kinds_present: np.ndarray, room: np.ndarray | None = None) -> SolvedWeights:
        """Solve with some of the exact rows; weights of the others' data are zero."""
        count, rows = len(self.targets), self.wanted[0]
        out = SolvedWeights(
            near.start,
            near.index,
            np.empty((len(near.index), rows)) if room is None else room,
            np.zeros((count, len(self.exact), rows)),
            np.empty(count, np.int8),
            np.empty((3, count)),
        )
        exact = tuple(e for e, present in zip(self.exact, kinds_present, strict=True) if present)
        exact_weights = np.empty((count, len(exact), rows))
        self._native(near.start, near.index, near.reach, exact).solve(
            RESIDUAL_BOUND, SUM_BOUND, self.portable, out.weights, exact_weights, out.path, out.judgements
        )
        out.exact_weights[:, kinds_present] = exact_weights
        return out

    def equations(self, near: Neighbours) -> Callable[[int], tuple[np.ndarray, np.ndarray, np.ndarray]]:
        """Return what gives the equations of a target: weighted rows (m, n), roots of weights (m,), targets (n, wanted)."""
        return self._native(near.start, near.index, near.reach).equations

    def _native(
        self, start: np.ndarray, index: np.ndarray, reach: np.ndarray, exact: tuple[Native, ...] = ()
    ) -> _native.GmlsProblem:
        return _native.GmlsProblem(
            self.space.order,
            self.components,
            self.basis,
            self.weight.code,
            self.weight.parameters(),
            self.aspect,
            self.targets,
            np.ascontiguousarray(reach, dtype=float),
            np.ascontiguousarray(start, dtype=np.int64),
            np.ascontiguousarray(index, dtype=np.int32),
            self.sites,
            self.samples,
            self.wanted,
            _merged(exact),
        )

    def _expanded(self, solution: SolvedWeights) -> SolvedWeights:
        """Weights of whole vectors, from those of the scalar problem that all components share."""
        d = self.per_site
        weights = np.zeros((len(solution.index), d, 1 + max(row for row, _, _ in self.split)))
        for row, component, scalar in self.split:
            weights[:, component, row] = solution.weights[:, scalar]
        start, index = _per_component(solution, d)
        by_sample = weights.reshape(-1, weights.shape[2])
        exact = np.empty((len(solution.path), 0, weights.shape[2]))  # exact rows exist for scalar spaces alone
        return replace(solution, start=start, index=index, weights=by_sample, exact_weights=exact)

    def require_one_sign(self, solution: SolvedWeights, near_reach: np.ndarray) -> None:
        """Replace weights by some of one sign off the centre; targets that have none are marked, and their weights NaN."""
        native = self._native(solution.start, solution.index, near_reach)
        for t in np.flatnonzero(solution.path < UNDETERMINED):
            entries = slice(solution.start[t], solution.start[t + 1])
            off = (self.sites[solution.index[entries]] != self.targets[t]).any(axis=1)
            alpha = solution.weights[entries, 0]
            if (alpha[off] >= 0).all() or (alpha[off] <= 0).all():
                continue
            rows, root, tau = native.equations(int(t))
            solution.path[t] = NO_SIGN
            for sign in (1.0, -1.0):
                columns = np.hstack([rows.T, -rows[~off].T])
                z, _ = scipy.optimize.nnls(columns, sign * tau[:, 0], maxiter=20 * columns.shape[1])
                missing = np.abs(columns @ z - sign * tau[:, 0]).max()
                if missing <= RESIDUAL_BOUND * np.abs(tau).max():
                    total = z[: len(rows)].copy()
                    total[~off] -= z[len(rows) :]
                    solution.weights[entries, 0] = sign * total * root
                    solution.judgements[1, t] = missing / np.abs(tau).max()
                    solution.path[t] = ONE_SIGN
                    break
            else:
                solution.weights[entries] = np.nan

    def cause(self, solution: SolvedWeights, target: int) -> str:
        """Return why a target has no stencil, and what to do."""
        sites = self.sites[np.unique(solution.index[solution.start[target] : solution.start[target + 1]])]
        sites = np.unique(sites, axis=0)
        count, dimension = len(sites), self.targets.shape[1]
        unknowns = self.space.unknowns(dimension) // (self.per_site if self.split else 1)
        if solution.path[target] == NO_SIGN:
            return "it has no weights of one sign off the centre; take a longer reach, a lower order, or any signs"
        if solution.path[target] == DEPENDENT:
            return "its exact rows depend on each other, so that their data contradict each other; leave one out"
        spread = np.linalg.svd(sites - sites.mean(axis=0), compute_uv=False) if count else np.zeros(1)
        rank = int((spread > 1e-9 * max(spread[0], 1e-300)).sum()) if count else 0
        where = {0: "in one point", 1: "on a line", 2: "in a plane"}
        if count <= 1 or rank < min(dimension, count - 1):
            return f"its {count} sites lie {where[rank]}; give sites that do not"
        if count * self.per_site < unknowns:
            return f"its {count} sites are too few for {unknowns} unknowns of order {self.space.order}; take a longer reach"
        residual, total = solution.judgements[1:, target]
        return (
            f"its {count} sites do not determine order {self.space.order} (residual {residual:.1e}, sum of weights "
            f"{total:.1e}); take a longer reach or a lower order"
        )


def assembled(
    targets: np.ndarray,
    near: Neighbours,
    space: Space,
    samples: Samples,
    wanted: Sequence[Wanted],
    weight: Weight,
    exact: Sequence[Exact],
    aspect: ArrayLike | None,
    portable: bool,
) -> Problem:
    """Return a problem after all checks that need no neighbours' values. InputError for what does not fit together."""
    dimension = targets.shape[1]
    _require_fit(targets, near, space, samples, exact)
    names(wanted)
    basis = Basis(dimension, space.components(dimension))
    rows: dict[str, tuple[slice, tuple[int, ...]]] = {}
    functionals: list[Functional] = []
    for quantity in wanted:
        new, shape = quantity.functionals(basis, targets, space.order)
        rows[quantity.name] = (slice(len(functionals), len(functionals) + len(new)), shape)
        functionals += new
    if not functionals:
        raise InputError("nothing is wanted; name at least one quantity, for instance gmls.VALUE")
    coefficients = space.basis(dimension)
    split: list[tuple[int, int, int]] = []
    per_site, sites, functional = 1, samples.sites, samples.functional
    if samples.whole:
        per_site = dimension
        if not coefficients.size:
            basis = Basis(dimension)
            functionals, split = _of_components(functionals, dimension)
        else:
            sites = np.repeat(sites, dimension, axis=0)
            functional = Components(sites, np.tile(np.eye(dimension), (len(samples), 1))).functional
    values = None
    if functional is not None and len(sites):
        values = stacked([functional(basis)], dimension)
        if len(values[2]) != len(sites):
            raise InputError(
                f"the samples have {len(values[2])} rows for {len(sites)} sites; give a place for each site"
            )
    scale = np.ones(dimension) if aspect is None else finite(aspect, "the aspect", 1)
    if scale.shape != (dimension,) or not (scale > 0).all():
        raise InputError(f"the aspect is {scale}; give {dimension} positive numbers")
    if coefficients.size and (scale != scale[0]).any():
        raise InputError(f"{space} has no meaning in coordinates of different scales; leave the aspect out")
    present = [np.ones(len(targets), bool) if e.present is None else e.present for e in exact]
    for e, is_present in zip(exact, present, strict=True):
        if is_present.shape != (len(targets),):
            raise InputError(
                f'the exact row "{e.name}" is given for {len(is_present)} of {len(targets)} targets; give all'
            )
    return Problem(
        targets,
        space,
        basis.components,
        coefficients,
        np.ascontiguousarray(sites),
        per_site,
        values,
        stacked(functionals, dimension, targets),
        tuple(stacked([e.row(basis, targets)], dimension, targets) for e in exact),
        np.array(present, dtype=bool).reshape(len(exact), len(targets)).T,
        tuple(split),
        rows,
        weight,
        tuple(np.concatenate([scale, np.ones(3 - dimension)])),
        portable,
    )


def _require_fit(targets: np.ndarray, near: Neighbours, space: Space, samples: Samples, exact: Sequence[Exact]) -> None:
    kind = "vector" if space.vector else "scalar"
    if samples.of != kind:
        raise InputError(f"the samples are of a {samples.of}, but {space} holds {kind}s; take another space or samples")
    if samples.sites.shape[1] != targets.shape[1]:
        raise InputError(
            f"the samples have {samples.sites.shape[1]} coordinates and the targets {targets.shape[1]}; give as many"
        )
    if len(near) != len(targets) or len(near.start) != len(targets) + 1:
        raise InputError(f"neighbours are given for {len(near)} of {len(targets)} targets; search with these targets")
    if len(near.index) != near.start[-1] or (np.diff(near.start) < 0).any() or near.start[0] != 0:
        raise InputError(f"neighbours have {len(near.index)} indices, but their starts end at {near.start[-1]}")
    if near.index.size and (near.index.min() < 0 or near.index.max() >= len(samples)):
        at = int(np.argmax((near.index < 0) | (near.index >= len(samples))))
        raise InputError(f"neighbour {at} is sample {near.index[at]}, but there are {len(samples)}; use 0 and up")
    good = np.isfinite(near.reach) & (near.reach > 0)
    if not good.all():
        at = int(np.argmin(good))
        raise InputError(f"target {at} has reach {near.reach[at]}; give a positive one")
    if exact and space.vector:
        raise InputError(f"exact rows are given with {space}; they exist for scalar spaces alone")


def _of_components(rows: Sequence[Functional], components: int) -> tuple[list[Functional], list[tuple[int, int, int]]]:
    """Rows for vectors as rows for scalars, equal ones once: (row, component, row for scalars)."""
    numbers: dict[tuple, int] = {}
    scalars: list[Functional] = []
    split: list[tuple[int, int, int]] = []
    for row, functional in enumerate(rows):
        for component in range(components):
            of_one = functional.of_component(component)
            if not of_one.parts:
                continue
            key = tuple(
                (p.derivative, p.place.shape, p.place.tobytes(), id(p.half), p.coefficient.tobytes())
                for p in of_one.parts
            )
            if key not in numbers:
                numbers[key] = len(scalars)
                scalars.append(of_one)
            split.append((row, component, numbers[key]))
    return scalars, split


def _per_component(near: Neighbours | SolvedWeights, components: int) -> tuple[np.ndarray, np.ndarray]:
    """Neighbours by number of sample, `components` of them for each site."""
    index = (near.index[:, None] * components + np.arange(components)).ravel()
    return near.start * components, index.astype(np.int32)


def _some(rows: Native, numbers: np.ndarray | slice) -> Native:
    count, terms, places, halves, coefficients = rows
    if len(places) == 1:
        return rows
    return count, terms, places[numbers], None if halves is None else halves[numbers], coefficients[numbers]


def _merged(rows: Sequence[Native]) -> Native | None:
    """Rows of one or several functionals as one group."""
    if not rows:
        return None
    count = max(len(r[2]) for r in rows)
    terms, places, row = [], 0, 0
    for r in rows:
        merged_row = r[1].copy()
        merged_row[:, 0] += row
        merged_row[:, 1] += places
        terms.append(merged_row)
        row, places = row + r[0], places + r[2].shape[1]

    def side_by_side(arrays: list[np.ndarray]) -> np.ndarray:
        return np.concatenate([np.broadcast_to(a, (count, *a.shape[1:])) for a in arrays], axis=1)

    halves = None
    if any(r[3] is not None for r in rows):
        halves = side_by_side([np.zeros_like(r[2]) if r[3] is None else r[3] for r in rows])
    return row, np.concatenate(terms), side_by_side([r[2] for r in rows]), halves, side_by_side([r[4] for r in rows])

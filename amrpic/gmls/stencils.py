"""Stencils: the weights of samples that give what is wanted, exactly for all polynomials of a space."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, fields, replace
from typing import Any, Literal

import numpy as np
import scipy
from numpy.typing import ArrayLike

from ..errors import InputError, SolverError
from .inputs import finite, points
from .neighbours import GROWTH, Neighbours
from .problem import DEPENDENT, NO_SIGN, UNDETERMINED, Collected, assembled, merged
from .samples import Samples
from .spaces import Space
from .targets import Exact, Wanted
from .weights import QUADRATIC, Weight

GROWTHS = 5  # at most, of a reach
SOLVED_TOGETHER = 4096  # targets at most, whose reaches grow together
WRITTEN_TOGETHER = 8 << 20  # bytes of their weights at most
TOGETHER = 65_536  # targets whose shared weights are written out at a time
PATHS = (
    "normal equations",
    "normal equations of less rank",
    "orthogonal factors",
    "undetermined",
    "dependent exact rows",
    "one sign",
    "no weights of one sign",
)


@dataclass(frozen=True, eq=False)
class Quality:
    """How each stencil came about and how good it is: arrays of one entry per target."""

    neighbours: np.ndarray  # number of sites within reach
    path: np.ndarray  # numbers of PATHS
    growth: np.ndarray  # how often the reach was made 15 % longer
    pivot: np.ndarray  # least pivot of the normal equations over its diagonal entry
    residual: (
        np.ndarray
    )  # largest error of reproduction, over the larger of |τ| and Σ|α λ|, in coordinates over the reach
    sum: np.ndarray  # Σ|α λ| over the largest |τ|, of the worst row wanted: of values at points Σ|α|

    @property
    def failed(self) -> np.ndarray:
        """Targets without usable weights."""
        return np.flatnonzero((self.path == UNDETERMINED) | (self.path == DEPENDENT) | (self.path == NO_SIGN))


@dataclass(frozen=True, eq=False)
class Stencils:
    """Weights for n targets; those of target t stand in rows start[t]:start[t + 1] of `weights`."""

    start: np.ndarray  # (n + 1,)
    index: np.ndarray  # of samples
    solved: np.ndarray  # weights (entries, rows wanted): of all targets, or of those that others share
    exact_weights: np.ndarray  # (n, exact rows, rows wanted); zero where an exact row is not there
    quality: Quality
    samples: int  # numbers that the samples are in all
    rows: Mapping[str, tuple[slice, tuple[int, ...]]] = field(repr=False)  # of each quantity wanted, and its shape
    exact: tuple[str, ...] = ()
    first: np.ndarray | None = field(default=None, repr=False)  # (n,): where in `solved` a target's weights begin

    @property
    def weights(self) -> np.ndarray:
        """(entries, rows wanted); written out for each target, where targets share them."""
        return self._weights(slice(None))

    def _weights(self, rows: slice | int, targets: slice = slice(None)) -> np.ndarray:
        """Return some rows of the weights of some targets."""
        first, last, _ = targets.indices(len(self))
        if self.first is None:
            return self.solved[self.start[first] : self.start[last], rows]
        start = self.start[first : last + 1]
        shift = np.repeat(self.first[targets] - start[:-1], np.diff(start))
        return self.solved[shift + np.arange(start[0], start[-1]), rows]

    def __len__(self) -> int:
        return len(self.start) - 1

    def matrix(self, name: str) -> scipy.sparse.csr_array:
        """Return the matrix of a quantity, (n * its numbers per target, samples): a row per target if it is one number.

        Whole vectors are numbered site by site. Data of exact rows are not in it: `exact_weights`.
        """
        rows, shape = self._rows(name)
        count = rows.stop - rows.start
        if count == 1:
            return scipy.sparse.csr_array(
                (self._weights(rows.start), self.index, self.start), (len(self), self.samples)
            )
        of_target = [
            scipy.sparse.csr_array((self._weights(r), self.index, self.start), (len(self), self.samples))
            for r in range(rows.start, rows.stop)
        ]
        lengths = np.repeat(np.diff(self.start)[:, None], count, axis=1).ravel()
        start = np.concatenate([[0], lengths.cumsum()])
        order = np.argsort(
            np.concatenate([np.repeat(np.arange(len(self)) * count + r, np.diff(self.start)) for r in range(count)]),
            kind="stable",
        )
        data = np.concatenate([part.data for part in of_target])[order]
        index = np.concatenate([part.indices for part in of_target])[order]
        return scipy.sparse.csr_array((data, index, start), (len(self) * count, self.samples))

    def apply(self, values: ArrayLike, exact: Mapping[str, ArrayLike] | None = None) -> dict[str, np.ndarray]:
        """Return each quantity, (n, *shape), from values (m,), or (n, *shape, columns) from (m, columns).

        Whole vectors: values (m, dimension), or (m, dimension, columns). `exact`: the data of each exact row, (n,) or
        (n, columns), by name; those of targets without the row are not read.
        """
        array = np.asarray(values, dtype=float)
        if array.ndim > 1 and len(array) != self.samples and array.shape[0] * array.shape[1] == self.samples:
            array = array.reshape(self.samples, *array.shape[2:])
        if array.ndim not in (1, 2) or len(array) != self.samples:
            raise InputError(f"values have shape {np.shape(values)} for {self.samples} samples; give one row for each")
        data = dict(exact or {})
        if set(data) != set(self.exact):
            raise InputError(f"exact data are given for {sorted(data)}; these stencils need {sorted(self.exact)}")
        columns = array.shape[1:]
        sums = np.empty((len(self), self.solved.shape[1], *columns))
        for first in range(0, len(self), TOGETHER):
            chunk = slice(first, min(first + TOGETHER, len(self)))
            start = self.start[chunk.start : chunk.stop + 1]
            index, weights = self.index[start[0] : start[-1]], self._weights(slice(None), chunk)
            for row in range(self.solved.shape[1]):
                matrix = scipy.sparse.csr_array(
                    (weights[:, row], index, start - start[0]), (len(start) - 1, self.samples)
                )
                sums[chunk, row] = matrix @ array
        for number, name in enumerate(self.exact):
            datum = np.asarray(data[name], dtype=float)
            if datum.shape != (len(self), *columns):
                raise InputError(f'the data "{name}" have shape {datum.shape}; give {(len(self), *columns)}')
            weight = self.exact_weights[:, number]
            has_weight = weight.any(axis=1)
            extra = np.einsum("tr,t...->tr...", weight[has_weight], datum[has_weight])
            sums[has_weight] += extra
        return {name: sums[:, rows].reshape(len(self), *shape, *columns) for name, (rows, shape) in self.rows.items()}

    def _rows(self, name: str) -> tuple[slice, tuple[int, ...]]:
        if name not in self.rows:
            raise InputError(f'these stencils have no "{name}"; they have {", ".join(self.rows)}')
        return self.rows[name]


def stencils(
    targets: ArrayLike,
    near: Neighbours,
    *,
    space: Space,
    samples: Samples,
    wanted: Sequence[Wanted],
    weight: Weight = QUADRATIC,
    exact: Sequence[Exact] = (),
    aspect: ArrayLike | None = None,
    lattice: ArrayLike | None = None,
    one_sign: bool = False,
    failed: Literal["raise", "mark"] = "raise",
    portable: bool = False,
) -> Stencils:
    """Return the stencils of targets (n, dimension), in m, from the samples that `near` lists for each.

    Moving least squares (Wendland, Scattered Data Approximation, chapter 4): of all weights that reproduce the space,
    and the exact rows, those of least Σ α²/w. A reach that does not determine a target grows by 15 %, at most five times.

    aspect: the reach along each axis over the reach, (dimension,); default 1. lattice: (dimension,) in m, where sites lie
    whole multiples of it from targets, and the samples at equal places are equal, such as the cells of a mesh and half of
    the finest width: targets with equal surroundings then share one solution, whose reach does not grow.
    one_sign: weights off the centre, the sample at the target, of one sign for a single scalar quantity, by a non-negative
    least-squares problem for each target (some tenths of a millisecond). portable: target by target, slower.

    Raises InputError for what does not fit together, and SolverError with index and cause for a target that cannot be
    determined, unless failed is "mark": then its weights are NaN and `quality.failed` lists it. Not collective.
    """
    places = points(targets, "the targets")
    if lattice is not None:
        return _shared(
            places,
            near,
            samples,
            finite(lattice, "the lattice", 1),
            wanted,
            exact,
            space=space,
            weight=weight,
            aspect=aspect,
            one_sign=one_sign,
            failed=failed,
            portable=portable,
        )
    problem = assembled(places, near, space, samples, wanted, weight, exact, aspect, portable)
    if one_sign and (problem.wanted[0] != 1 or exact or space.vector):
        raise InputError(
            f"weights of one sign are wanted of {problem.wanted[0]} numbers; ask for one of a scalar, without exact rows"
        )
    growth = np.zeros(len(places), dtype=np.int8)
    collected = Collected(near, problem)
    for run in near.runs(SOLVED_TOGETHER, WRITTEN_TOGETHER // (8 * collected.rows)):
        of_run = problem.of(run)
        room = collected.room(problem.per_site * int(near.start[run.stop] - near.start[run.start]))
        parts = [(np.arange(run.stop - run.start), of_run.solve(near.run(run), room))]
        for times in range(1, GROWTHS + 1):
            members, latest = parts[-1]
            again = members[latest.path == UNDETERMINED]
            larger = near.grown(run.start + again, GROWTH**times) if again.size else None
            if larger is None:
                break
            parts.append((again, of_run.of(again).solve(larger)))
            growth[run][again] = times
        collected.add(merged(parts, run.stop - run.start, collected.room))
    solution = collected.all()
    if one_sign:
        problem.require_one_sign(solution, near.reach * GROWTH**growth)
    quality = Quality(np.diff(solution.start) // problem.per_site, solution.path, growth, *solution.judgements)
    bad = quality.failed
    if bad.size and failed == "raise":
        raise SolverError(f"target {bad[0]} at {places[bad[0]]}: {problem.cause(solution, int(bad[0]))}")
    for target in bad:
        solution.weights[solution.start[target] : solution.start[target + 1]] = np.nan
    solution.exact_weights[bad] = np.nan
    return Stencils(
        solution.start,
        solution.index,
        solution.weights,
        solution.exact_weights,
        quality,
        len(samples) * problem.per_site,
        problem.rows,
        tuple(e.name for e in exact),
    )


def _shared(
    targets: np.ndarray,
    near: Neighbours,
    samples: Samples,
    unit: np.ndarray,
    functionals: Sequence[Wanted],
    exact: Sequence[Exact],
    **options: Any,
) -> Stencils:
    """Return stencils of which those with equal surroundings were solved once."""
    if exact or samples.whole or any(w.varies for w in functionals):
        raise InputError(
            "with a lattice all targets want the same; leave out the lattice, or exact rows, vectors and places"
        )
    ordered, representative, kind = near.equal_surroundings(targets, samples.sites, unit)
    few = ordered.of(representative)  # without growth, which would change surroundings
    solved = stencils(targets[representative], few, samples=samples, wanted=functionals, **options)
    quality = Quality(*(getattr(solved.quality, f.name)[kind] for f in fields(Quality)))
    return replace(
        solved,
        start=ordered.start,
        index=ordered.index,
        first=solved.start[:-1][kind],
        exact_weights=np.empty((len(targets), 0, solved.solved.shape[1])),
        quality=quality,
    )

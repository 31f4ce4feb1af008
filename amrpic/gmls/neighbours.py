"""Which samples a target's stencil is made of."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from itertools import chain
from typing import Protocol

import numpy as np
import scipy
from numpy.typing import ArrayLike

from .. import _native
from ..errors import InputError
from .inputs import finite, points
from .spaces import Scalar

SEARCHED_TOGETHER = 256  # targets, whose neighbours are Python's lists for a while
LEAF = 40  # sites of the leaves of a search tree, for which stencils are found fastest
GROWTH = 1.15  # how much longer the reach of a target becomes that its sites do not determine
EQUAL = 1 + 1e-9  # distances that rounding alone tells apart


class BoxMesh(Protocol):
    """Levels of boxes, as an `amrpic.Hierarchy` has them."""

    native: _native.Hierarchy

    @property
    def levels(self) -> int: ...

    @property
    def lower(self) -> np.ndarray: ...

    def boxes(self, level: int) -> np.ndarray: ...

    def cells(self, level: int) -> int: ...

    def spacing(self, level: int) -> np.ndarray: ...


@dataclass(frozen=True, eq=False)
class Neighbours:
    """The neighbours of target t are samples index[start[t]:start[t + 1]]."""

    start: np.ndarray  # (n + 1,) int64
    index: np.ndarray  # int32
    reach: np.ndarray  # (n,): where weights vanish, in m
    search: Callable[[np.ndarray, np.ndarray], Neighbours] | None = field(default=None, repr=False)
    kind: np.ndarray | None = field(default=None, repr=False)  # (n,) of targets with equal surroundings, in equal order
    representative: np.ndarray | None = field(default=None, repr=False)  # a target of each kind

    def __len__(self) -> int:
        return len(self.reach)

    def grown(self, which: np.ndarray, factor: float) -> Neighbours | None:
        """Return neighbours of some of the targets within a longer reach; none if they were given and cannot grow."""
        return None if self.search is None else self.search(which, self.reach[which] * factor)

    def runs(self, targets: int, entries: int) -> Iterator[slice]:
        """Runs of so many targets at most, and of so many neighbours if it is not one; one run, of none, for no targets."""
        first = 0
        while first < len(self) or first == 0:
            last = int(np.searchsorted(self.start, self.start[first] + entries, side="right")) - 1
            last = min(max(last, first + 1), first + targets, len(self))
            yield slice(first, last)
            first = max(last, 1)

    def run(self, targets: slice) -> Neighbours:
        """Return the neighbours of a run of targets, which do not grow."""
        start = self.start[targets.start : targets.stop + 1]
        return Neighbours(start - start[0], self.index[start[0] : start[-1]], self.reach[targets])

    def of(self, which: np.ndarray) -> Neighbours:
        """Return the neighbours of some targets, which do not grow."""
        lengths = np.diff(self.start)[which]
        start = np.concatenate([[0], lengths.cumsum()])
        place = np.repeat(self.start[which] - start[:-1], lengths) + np.arange(start[-1])
        return Neighbours(start, self.index[place], self.reach[which])

    def equal_surroundings(
        self, targets: np.ndarray, sites: np.ndarray, unit: np.ndarray
    ) -> tuple[Neighbours, np.ndarray, np.ndarray]:
        """Return these neighbours in an order of their offsets, a target for each kind of surroundings, and kinds (n,).

        Offsets are whole multiples of `unit` (dimension,). InputError for those that are not.
        """
        if self.kind is not None and self.representative is not None:
            return self, self.representative, self.kind
        lengths = np.diff(self.start)
        of = np.repeat(np.arange(len(self)), lengths)
        steps = (sites[self.index] - targets[of]) / unit
        whole = np.rint(steps).astype(np.int64)
        off = np.abs(steps - whole).max(axis=1, initial=0) > 1e-3
        if off.any():
            raise InputError(f"target {of[int(np.argmax(off))]} has a site that is not on the lattice; leave it out")
        key = np.zeros(len(of), dtype=np.uint64)
        for d in range(whole.shape[1]):  # 21 bits each
            key = (key << np.uint64(21)) | (whole[:, d] + (1 << 20)).astype(np.uint64)
        order = np.lexsort((key, of))
        key = key[order]
        mixed = (key ^ (key >> np.uint64(31))) * np.uint64(0x9E3779B97F4A7C15)
        mixed = (mixed ^ (mixed >> np.uint64(29))) * np.uint64(0xBF58476D1CE4E5B9)
        total = np.concatenate([np.zeros(1, np.uint64), np.cumsum(mixed ^ (mixed >> np.uint64(32)))])
        sums = np.stack([total[self.start[1:]] - total[self.start[:-1]], lengths.astype(np.uint64)], axis=1)
        sums = np.column_stack([sums, np.rint(self.reach / unit.min() * 1e6).astype(np.uint64)])
        _, representative, kind = np.unique(sums, axis=0, return_index=True, return_inverse=True)
        kind = kind.ravel()
        twin = np.repeat(self.start[:-1][representative[kind]] - self.start[:-1], lengths) + np.arange(len(of))
        assert np.array_equal(key, key[twin])  # sums of 64 bits that agree by chance
        return Neighbours(self.start, self.index[order], self.reach), representative, kind


def cells(hierarchy: BoxMesh) -> tuple[np.ndarray, np.ndarray]:
    """Return centres and widths, (m, 3) each in m, of the cells of all levels, box by box, x fastest; covered ones too.

    They are numbered as `cells_around` numbers them, and as a field on one rank holds them, level after level.
    """
    centres, widths = [], []
    for level in range(hierarchy.levels):
        h = hierarchy.spacing(level)
        for box in hierarchy.boxes(level):
            k, j, i = np.meshgrid(*[np.arange(box[d], box[d + 3] + 1) for d in (2, 1, 0)], indexing="ij")
            centres.append(hierarchy.lower + (np.stack([i, j, k], axis=-1).reshape(-1, 3) + 0.5) * h)
        widths.append(np.broadcast_to(h, (hierarchy.cells(level), 3)))
    return np.concatenate(centres), np.concatenate(widths)


@contextmanager
def _refused_as_input() -> Iterator[None]:
    """Raise InputError for what the native side refuses."""
    try:
        yield
    except _native.HierarchyError as failure:
        raise InputError(str(failure)) from None


def cells_around(hierarchy: BoxMesh, points: ArrayLike, radius: ArrayLike) -> Neighbours:
    """Return the uncovered cells of all levels whose centres lie within a radius of points (n, 3), by index; in m.

    Cells are numbered as by `cells`. Neighbours end at the faces of the domain, periodic ones too. Not collective: boxes are
    known on all ranks. Raises InputError for more cells of a hierarchy than 32 bits number.
    """
    places = finite(points, "the points", 2)
    if places.shape[1] != 3:
        raise InputError(f"the points have {places.shape[1]} coordinates; give 3")
    distances = np.broadcast_to(finite(radius, "the radius"), len(places)).copy()
    if not (distances > 0).all():
        raise InputError(f"point {int(np.argmin(distances))} has radius {distances.min()}; give a positive one")

    def search(numbers: np.ndarray, lengths: np.ndarray) -> Neighbours:
        with _refused_as_input():
            start, index = hierarchy.native.cells_around(np.ascontiguousarray(places[numbers]), lengths)
        return Neighbours(start, index, lengths)

    return replace(search(np.arange(len(places)), distances), search=search)


def leaves_around(hierarchy: BoxMesh, reach: float) -> tuple[np.ndarray, Neighbours]:
    """Return the uncovered cells of all levels (n,), and for each those within `reach` times its own longest edge.

    Cells are numbered as by `cells`. Neighbours end at the faces of the domain, periodic ones too. Cells with equal
    surroundings are known at once, for `stencils` with a lattice of half the finest widths. Not collective: boxes are known
    on all ranks. Raises InputError for a reach below 1 or of too many finest cells to count, and as `cells_around`.
    """
    if not 1 <= reach < np.inf:
        raise InputError(f"reach is {reach}; it is a number of cells, at least 1, for instance 2.1")
    with _refused_as_input():
        leaf, radius, start, index, kind, representative = hierarchy.native.leaves_around(float(reach))
    return leaf, Neighbours(start, index, radius, None, kind, representative)


def nearby(
    sites: ArrayLike,
    targets: ArrayLike,
    *,
    order: int | None = None,
    reach: float = 1.6,
    radius: ArrayLike | None = None,
) -> Neighbours:
    """Return for each target the sites within `radius`, or within `reach` times the distance of the n-th nearest one.

    n is the number of scalar polynomials of an order. Sites at equal distance are taken together. By SciPy's cKDTree, on
    this rank alone.

    sites (m, dimension), targets (n, dimension), radius one number or (n,), in m. Raises InputError for what does not fit.
    """
    where, places = points(sites, "the sites"), points(targets, "the targets")
    if where.shape[1] != places.shape[1]:
        raise InputError(f"sites have {where.shape[1]} coordinates and targets {places.shape[1]}; give as many")
    if (order is None) == (radius is None):
        raise InputError("neighbours need either an order or a radius; give one of them")
    tree = scipy.spatial.cKDTree(where, leafsize=LEAF)
    tied = np.zeros(len(places), dtype=bool)
    if radius is not None:
        distances = np.broadcast_to(finite(radius, "the radius"), len(places)).copy()
    else:
        nearest = Scalar(order).unknowns(places.shape[1])  # type: ignore[arg-type]
        if len(where) < nearest:
            raise InputError(f"there are {len(where)} sites for {nearest} unknowns of order {order}; give more sites")
        if not reach > 0:
            raise InputError(f"reach is {reach}; it is a factor above 0, for instance 1.6")
        second, third, last, next_one = tree.query(places, k=[2, 3, nearest, nearest + 1])[0].T
        distances, tied = reach * last, (third <= second * EQUAL) | (next_one <= last * EQUAL)
    if not (distances > 0).all():
        row = int(np.argmin(distances))
        raise InputError(f"target {row} has reach {distances[row]}; give a longer one, or no sites in one place")

    def search(numbers: np.ndarray, lengths: np.ndarray) -> Neighbours:
        counts, members = [], []
        for first in range(0, len(numbers), SEARCHED_TOGETHER):
            chunk = slice(first, first + SEARCHED_TOGETHER)
            lists = tree.query_ball_point(places[numbers[chunk]], lengths[chunk] * EQUAL, return_sorted=False)
            counts.append(np.fromiter(map(len, lists), dtype=np.int64, count=len(lists)))
            members.append(np.fromiter(chain.from_iterable(lists), dtype=np.int32, count=int(counts[-1].sum())))
        start = np.concatenate([[0], *counts]).cumsum()
        return Neighbours(start, np.concatenate([np.empty(0, np.int32), *members]), lengths)

    # Ties are the mark of lattices, where reaches often have to grow: their sites are searched for once.
    all_places = np.arange(len(places))
    neighbours = search(all_places, np.where(tied, GROWTH, 1.0) * distances)

    def grown(numbers: np.ndarray, lengths: np.ndarray) -> Neighbours:
        if tied[numbers].all() and (lengths <= GROWTH * EQUAL * distances[numbers]).all():
            return replace(neighbours.of(numbers), reach=lengths)
        return search(numbers, lengths)

    of = np.repeat(all_places, np.diff(neighbours.start))
    inside = ((where[neighbours.index] - places[of]) ** 2).sum(axis=1) <= (distances[of] * EQUAL) ** 2
    start = np.concatenate([[0], np.bincount(of[inside], minlength=len(places)).cumsum()])
    return Neighbours(start, neighbours.index[inside], distances, grown)

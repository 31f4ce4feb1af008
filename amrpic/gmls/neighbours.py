"""Which samples a target's stencil is made of."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from itertools import chain

import numpy as np
from numpy.typing import ArrayLike
from scipy.spatial import cKDTree

from ..errors import InputError
from .checks import finite, points
from .spaces import Scalar

SEARCHED_TOGETHER = 4096  # targets, whose neighbours are Python's lists for a while
EQUAL = 1 + 1e-9  # distances that rounding alone tells apart


@dataclass(frozen=True, eq=False)
class Neighbours:
    """The neighbours of target t are samples index[start[t]:start[t + 1]]."""

    start: np.ndarray  # (n + 1,) int64
    index: np.ndarray  # int32
    reach: np.ndarray  # (n,): where weights vanish, in m
    search: Callable[[np.ndarray, np.ndarray], Neighbours] | None = field(default=None, repr=False)

    def __len__(self) -> int:
        return len(self.reach)

    def grown(self, which: np.ndarray, factor: float) -> Neighbours | None:
        """Return neighbours of some of the targets within a longer reach; none if they were given and cannot grow."""
        return None if self.search is None else self.search(which, self.reach[which] * factor)


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
    tree = cKDTree(where)
    if radius is not None:
        distances = np.broadcast_to(finite(radius, "the radius"), len(places)).copy()
    else:
        nearest = Scalar(order).unknowns(places.shape[1])  # type: ignore[arg-type]
        if len(where) < nearest:
            raise InputError(f"there are {len(where)} sites for {nearest} unknowns of order {order}; give more sites")
        if not reach > 0:
            raise InputError(f"reach is {reach}; it is a factor above 0, for instance 1.6")
        distances = reach * tree.query(places, k=[nearest])[0][:, 0]
    if not (distances > 0).all():
        row = int(np.argmin(distances))
        raise InputError(f"target {row} has reach {distances[row]}; give a longer one, or no sites in one place")

    def search(which: np.ndarray, lengths: np.ndarray) -> Neighbours:
        counts, found = [], []
        for first in range(0, len(which), SEARCHED_TOGETHER):
            some = slice(first, first + SEARCHED_TOGETHER)
            lists = tree.query_ball_point(places[which[some]], lengths[some] * EQUAL, return_sorted=True)
            counts.append(np.fromiter(map(len, lists), dtype=np.int64, count=len(lists)))
            found.append(np.fromiter(chain.from_iterable(lists), dtype=np.int32, count=int(counts[-1].sum())))
        start = np.concatenate([[0], *counts]).cumsum()
        return Neighbours(start, np.concatenate([np.empty(0, np.int32), *found]), lengths)

    return replace(search(np.arange(len(places)), distances), search=search)

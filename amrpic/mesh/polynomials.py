"""Polynomials in cells: fits to the means of the cells around, by least squares, that keep the cell's own mean.

Coordinates are those from the cell's centre in its own widths, so long cells are treated as cubes. Cells with equal
surroundings share their weights. Where a level ends, coarser cells take part; finer ones by the mean that their parent holds.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from .. import _native, gmls
from ..errors import InputError
from .surroundings import WALL, Surroundings

Array = NDArray[Any]

WIDTH = {1: 1, 2: 2, 3: 3, 4: 4}  # cells on all sides that a fit may use: at walls all of them lie on one side
REACH = {1: 1.8, 2: 2.3, 3: 2.8, 4: 3.3}  # in cell widths, where that is enough
GROWTH = 1.15
FAR = 8.0  # beyond all of these cells, in widths
MOST_GROWTH = 60.0  # of errors of the data, at corners of the cell; order 4 in a corner of two walls has 30 to 45


def exponents(order: int) -> Array:
    """Return the exponents of the monomials of a fit, (n, 3), without the constant one."""
    return gmls.spaces.exponents(3, order)[1:]


@dataclass
class Fits:
    """The weights of each kind of surroundings that was met so far."""

    order: int
    number: dict[bytes, int] = field(default_factory=dict)  # of each kind
    first: Array = field(default_factory=lambda: np.zeros(1, dtype=np.int64))  # entry of each kind
    offset: Array = field(
        default_factory=lambda: np.zeros((0, 3), dtype=np.int32)
    )  # a place of each cell, from the middle

    def __post_init__(self) -> None:
        self.weight = np.zeros((0, len(exponents(self.order))))  # (entries, monomials)

    @property
    def width(self) -> int:
        """How far around a cell its surroundings matter."""
        return WIDTH[self.order]

    def prepare(self, cells: Iterable[tuple[Surroundings, Array]]) -> None:
        """Find the fits of all cells (bool (nx, ny, nz) of each box) whose surroundings are new."""
        new: dict[bytes, Sites] = {}
        for surroundings, chosen in cells:
            where = np.argwhere(chosen)
            names, first, _ = _kinds(surroundings, where)
            for name, n in zip(names, first, strict=True):
                if name not in self.number and name not in new:
                    new[name] = _sites(surroundings, where[n])
        for name in new:
            self.number[name] = len(self.number)
        self._solve(list(new.values()))

    def coefficients(self, surroundings: Surroundings, chosen: Array, values: Array) -> Array:
        """Return the coefficients of the monomials in cells of a box, (monomials, nx, ny, nz), zero where they are not wanted.

        wanted: bool (nx, ny, nz), cells for which fits were prepared; values: the dense array of the surroundings.
        """
        cells = np.argwhere(chosen)
        names, _, of = _kinds(surroundings, cells)
        kinds = np.array([self.number[name] for name in names], dtype=np.int64)[of]
        place = (cells + self.width) @ np.cumprod([1, *values.shape[:2]])
        coefficients = _native.stencil_sums(values, place, kinds, self.first, self.offset, self.weight)
        out = np.zeros((coefficients.shape[1], *chosen.shape))
        out[(slice(None), *cells.T)] = coefficients.T
        return out

    def _solve(self, kinds: list[Sites]) -> None:
        """Append the weights of new kinds: of the largest order, and within the shortest reach, that they determine."""
        weights: list[Fit | None] = [None] * len(kinds)
        for order in range(self.order, 0, -1):
            reaches = [REACH[self.order] * GROWTH**n for n in range(5)] + [FAR]
            for reach in reaches:
                left = [n for n, weight in enumerate(weights) if weight is None]
                for n, weight in zip(left, _fits([kinds[n] for n in left], order, reach), strict=True):
                    weights[n] = weight
        used = [
            kind.place[:0] if fit is None else kind.place[fit.used] for kind, fit in zip(kinds, weights, strict=True)
        ]
        whole = [np.zeros((len(places), self.weight.shape[1])) for places in used]
        for to, fit in zip(whole, weights, strict=True):
            if fit is not None:
                to[:, : fit.weight.shape[1]] = fit.weight  # monomials of lower orders come first
        self.first = np.concatenate([self.first, self.first[-1] + np.cumsum([len(to) for to in whole], dtype=np.int64)])
        self.offset, self.weight = np.concatenate([self.offset, *used]), np.concatenate([self.weight, *whole])


@dataclass(frozen=True)
class Sites:
    """The cells around one."""

    offset: Array  # (m, 3) of their centres, in its widths
    width: Array  # (m,) in its widths
    place: Array  # (m, 3) int32: one of the places that each fills, from its own


@dataclass(frozen=True)
class Fit:
    """Weights (m, monomials) of some of the cells around one."""

    used: Array  # (m,)
    weight: Array


def _fits(kinds: list[Sites], order: int, reach: float) -> list[Fit | None]:
    """Return the fit of each kind, none where the cells within a reach do not determine it."""
    near = [np.flatnonzero((sites.offset**2).sum(axis=1) < reach**2 * (1 - 1e-12)) for sites in kinds]
    if not kinds:
        return []
    start = np.cumsum([0, *map(len, near)])
    offset = np.concatenate([sites.offset[n] for sites, n in zip(kinds, near, strict=True)])
    width = np.concatenate([sites.width[n] for sites, n in zip(kinds, near, strict=True)])
    origin = np.zeros((len(kinds), 3))
    stencils = gmls.stencils(
        origin,
        gmls.Neighbours(start, np.arange(len(offset), dtype=np.int32), np.full(len(kinds), reach)),
        space=gmls.Scalar(order),
        samples=gmls.Means(gmls.boxes(offset, width[:, None] * np.ones(3))),
        wanted=[gmls.COEFFICIENTS],
        exact=[gmls.ExactMean(gmls.boxes(origin, 1.0))],
        failed="mark",
    )
    at_corner = 0.5 ** exponents(order).sum(axis=1)
    growth = np.add.reduceat(np.abs(stencils.solved[:, 1:]) @ at_corner, start[:-1])
    good = growth <= MOST_GROWTH  # not where weights are NaN
    return [Fit(used, stencils.solved[start[n] : start[n + 1], 1:]) if good[n] else None for n, used in enumerate(near)]


@lru_cache
def _multipliers(count: int) -> Array:
    """Odd numbers of 64 bits: sums of small numbers times these differ between surroundings, except in two of 2^64 pairs."""
    return np.random.default_rng(0).integers(0, 2**63, count, dtype=np.uint64) * np.uint64(2) + np.uint64(1)


@lru_cache
def _window(width: int) -> Array:
    """Offsets within so many cells, (n, 3), x fastest."""
    steps = np.arange(-width, width + 1)
    z, y, x = np.meshgrid(steps, steps, steps, indexing="ij")
    return np.stack([x, y, z], axis=-1).reshape(-1, 3)


def _kinds(surroundings: Surroundings, cells: Array) -> tuple[list[bytes], Array, Array]:
    """Return names of the kinds of surroundings of cells (n, 3) of a box, a cell of each, and which of these each cell has."""
    unique, first, of = np.unique(_keys(surroundings, cells), return_index=True, return_inverse=True)
    return [key.tobytes() for key in unique], first, of.ravel()


def _keys(surroundings: Surroundings, cells: Array) -> Array:
    """Return a number that identifies the surroundings of each cell, (n,), zero where all cells around are of its level."""
    keys = np.zeros(len(cells), dtype=np.uint64)
    irregular = np.flatnonzero(surroundings.irregular()[tuple(cells.T)])
    chosen, window = cells[irregular], _window(surroundings.width)
    strides = np.cumprod([1, *surroundings.depth.shape[:2]])
    depth, place = surroundings.depth.ravel(order="F").astype(np.uint64), (chosen + surroundings.width) @ strides
    multipliers = _multipliers(len(window) + 4)
    total = np.ones(len(chosen), dtype=np.uint64)
    for step, multiplier in zip(window @ strides, multipliers, strict=False):
        total += depth[place + step] * multiplier
    # where coarser cells are near, it matters which of a coarser cell's places the cell has
    deepest = surroundings.largest_depth()[tuple(chosen.T)].astype(np.int64)
    places = (chosen + surroundings.box[:3]) & ((1 << deepest) - 1)[:, None]
    for number, multiplier in zip([*places.T, deepest], multipliers[len(window) :], strict=True):
        total += number.astype(np.uint64) * multiplier
    keys[irregular] = total
    return keys


def _sites(surroundings: Surroundings, cell: Array) -> Sites:
    """Return the cells around one, those of its own level first, then coarser ones."""
    window = _window(surroundings.width)
    depth = surroundings.depth[tuple((cell + surroundings.width + window).T)].astype(np.int64)
    own = window[(depth == 0) & window.any(axis=1)]
    offsets, widths, places = [own.astype(float)], [np.ones(len(own))], [own]
    for coarser in range(1, int(depth.max(initial=0)) + 1):
        coarse_cells = window[depth == coarser]
        index = (cell + surroundings.box[:3] + coarse_cells) >> coarser
        _, first = np.unique((index - index.min(axis=0)) @ [1, 1 << 10, 1 << 20], return_index=True)
        offsets.append((index[first] + 0.5) * 2**coarser - 0.5 - (cell + surroundings.box[:3]))
        widths.append(np.full(len(first), 2.0**coarser))
        places.append(coarse_cells[first])
    return Sites(np.concatenate(offsets), np.concatenate(widths), np.concatenate(places).astype(np.int32))


def neighbour_bounds(surroundings: Surroundings, values: Array) -> tuple[Array, Array]:
    """Return the least and the largest value of each cell of a box and the cells that touch it, (nx, ny, nz) each."""
    low = np.where(surroundings.depth == WALL, np.inf, values)
    high = np.where(surroundings.depth == WALL, -np.inf, values)
    first, last = np.full(3, surroundings.width), surroundings.width + surroundings.size
    least, most = np.full(surroundings.size, np.inf), np.full(surroundings.size, -np.inf)
    for step in _window(1):
        part = tuple(slice(int(a), int(b)) for a, b in zip(first + step, last + step, strict=True))
        least, most = np.minimum(least, low[part]), np.maximum(most, high[part])
    return least, most


def require_order(order: object, orders: Sequence[int], name: str) -> None:
    """Raise InputError unless an order, said to be that of `name`, is a whole number among these. Local."""
    if isinstance(order, bool) or not isinstance(order, int | np.integer) or order not in orders:
        *first, last = map(str, orders)
        raise InputError(f"the order of {name} is {order!r:.60}; use {', '.join(first)} or {last}")

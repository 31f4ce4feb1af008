"""Numbers for pictures: planes, projections and lines through fields on levels, always from the finest cells.

Cell values are taken as they are, constant in each cell: what a picture shows is what was computed. Ranks that share a fields
draw the boxes that each of them holds, and their sum is the picture: all here is collective over `fields.comm`.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from .boxes import rows_of
from .composite import Composite
from .periods import middle, nearest, wrapped

Array = NDArray[Any]

MOST_PIXELS = 1600  # along the longer side; a raster has a pixel per finest cell if that is less


@dataclass(frozen=True)
class Raster:
    """Values at the centres of a regular grid of pixels in the plane normal to `axis`."""

    values: Array  # (pixels along the first axis of the plane, along the second)
    axis: int
    axes: tuple[int, int]  # of the plane, the longer side of the domain first
    position: float | None  # m along `axis`; None: the whole depth was summed up
    lower: Array  # (2,) m
    upper: Array

    @property
    def centres(self) -> tuple[Array, Array]:
        """Coordinates in m of the pixels along both `axes`, each (pixels,)."""
        edges = zip(self.lower, self.upper, self.values.shape, strict=True)
        first, second = (lower + (np.arange(n) + 0.5) * (upper - lower) / n for lower, upper, n in edges)
        return first, second


def others(axis: int) -> tuple[int, int]:
    """Return the two axes normal to `axis`, in ascending order."""
    first, second = (d for d in range(3) if d != axis)
    return first, second


def slice_through(fields: Composite, name: str, axis: int, position: float, level: int | None = None) -> Raster:
    """Return a scalar in the plane normal to `axis` at `position` (m): from the finest cells, or those of one level.

    A plane between two cells shows the upper ones. Where a level has no cells, the raster holds nan.
    """

    def cut(cells: Array, number: int, box: int) -> Array:
        return cells.take(cell_at(fields, number, axis, position) - fields.levels[number].boxes[box, axis], axis=axis)

    return _raster(fields, name, axis, position, level, lambda number: cut_by(fields, number, axis, position), cut)


def projection(fields: Composite, name: str, axis: int, level: int | None = None) -> Raster:
    """Return the integral of a scalar along `axis`: each place once, on its finest level, or all cells of one level.

    Where a level has no cells, the raster holds nan.
    """

    def summed(cells: Array, number: int, box: int) -> Array:
        return cells.sum(axis=axis) * fields.levels[number].spacing[axis]

    return _raster(fields, name, axis, None, level, lambda number: np.arange(len(fields.levels[number].boxes)), summed)


def _raster(
    fields: Composite,
    name: str,
    axis: int,
    position: float | None,
    level: int | None,
    boxes: Callable[[int], Array],
    flat: Callable[[Array, int, int], Array],
) -> Raster:
    """Return the sum of what `flat(cells, level, box)` makes of some boxes of each level, cells under a finer level zero."""
    grid = _Pixels(fields, axis, level)
    values, filled = np.zeros(grid.shape), np.zeros(grid.shape, dtype=bool)
    for number in range(len(fields.levels)) if level is None else [level]:
        for box in np.intersect1d(boxes(number), fields.here(number)):
            cells = fields.values(name, number, box)
            if level is None:
                cells = np.where(fields.covered(number, box), 0.0, cells)
            pixels, inside = grid.locate(number, box)
            values[pixels] += flat(cells, number, box)[inside]
            filled[pixels] = True
    values = np.where(fields.any(filled), fields.total(values), np.nan)
    return Raster(grid.shown(values), axis, grid.axes, position, *grid.corners)


def cut_by(fields: Composite, level: int, axis: int, position: float) -> Array:
    """Return the numbers of the boxes of a level that a plane cuts."""
    boxes, index = fields.levels[level].boxes, cell_at(fields, level, axis, position)
    return np.flatnonzero((boxes[:, axis] <= index) & (index <= boxes[:, 3 + axis]))


def cell_at(fields: Composite, level: int, axis: int, position: float) -> int:
    """Return the index of the cells of a level at a place along an axis; those at the wall for places outside."""
    spacing = fields.levels[level].spacing[axis]
    last = round((fields.upper[axis] - fields.lower[axis]) / spacing) - 1
    return int(np.clip(np.floor((position - fields.lower[axis]) / spacing), 0, last))


class _Pixels:
    """The pixels of the plane normal to an axis, over the whole domain. Each shows the finest cell at its centre."""

    def __init__(self, fields: Composite, axis: int, level: int | None) -> None:
        self._fields = fields
        self._axes = list(others(axis))
        self._finest = len(fields.levels) - 1 if level is None else level
        extent = (fields.upper - fields.lower)[self._axes]
        self.axes = others(axis) if extent[0] >= extent[1] else others(axis)[::-1]
        cells = np.rint(extent / fields.levels[self._finest].spacing[self._axes]).astype(np.int64)
        self.shape = pixels_of(cells)
        # A pixel on the face between two cells shows the upper one, on all levels.
        self._cells = [(2 * np.arange(p) + 1) * n // (2 * p) for n, p in zip(cells, self.shape, strict=True)]

    def shown(self, values: Array) -> Array:
        """Return the values with the longer side of the domain first."""
        return values if list(self.axes) == self._axes else values.T

    @property
    def corners(self) -> tuple[Array, Array]:
        """Lower and upper corner of the plane in m, in the order of `axes`."""
        return self._fields.lower[list(self.axes)], self._fields.upper[list(self.axes)]

    def locate(self, level: int, box: int) -> tuple[tuple[slice, ...], tuple[Array, ...]]:
        """Return the slices of pixels whose centres lie in a box, and for them the cells of the box to index."""
        corners = self._fields.levels[level].boxes[box]
        pixels_of_box, inside = [], []
        for axis, finest in zip(self._axes, self._cells, strict=True):
            cells = finest >> (self._finest - level)
            start, stop = np.searchsorted(cells, [corners[axis], corners[3 + axis] + 1])
            pixels_of_box.append(slice(start, stop))
            inside.append(cells[start:stop] - corners[axis])
        return tuple(pixels_of_box), np.ix_(*inside)


def pixels_of(cells: Array) -> tuple[int, ...]:
    """Return the numbers of pixels along the sides of a plane of so many finest cells."""
    return tuple(np.maximum(cells * min(1.0, MOST_PIXELS / cells.max()), 1).astype(int).tolist())


@dataclass(frozen=True)
class Line:
    """A straight line through the domain and where to sample it."""

    centre: Array  # (3,) m
    direction: Array  # (3,), of length one
    along: Array  # (n,) m from the centre

    @property
    def points(self) -> Array:
        """The sampled places, (n, 3) m."""
        return self.centre + self.along[:, None] * self.direction


def line_values(fields: Composite, name: str, line: Line, level: int | None = None) -> Array:
    """Return a field along a line, in the finest cells or those of one level: (n,), or (n, 3) of a vector; else nan."""
    points = wrapped(line.points, fields.lower, fields.upper, fields.periodic)
    filled = np.zeros(len(points), dtype=bool)
    out = np.zeros((len(points), 3) if fields.is_vector(name) else len(points))
    for number in range(len(fields.levels)) if level is None else [level]:
        description = fields.levels[number]
        shape = np.rint((fields.upper - fields.lower) / description.spacing).astype(np.int64)
        index = np.clip(np.floor((points - fields.lower) / description.spacing).astype(np.int64), 0, shape - 1)
        holding = description.table.find(rows_of(index))
        for box in np.intersect1d(holding[holding >= 0], fields.here(number)):
            inside = np.flatnonzero(holding == box)
            cells = tuple((index[inside] - description.boxes[box, :3]).T)
            if level is None:
                visible = ~fields.covered(number, box)[cells]
                inside, cells = inside[visible], tuple(of_axis[visible] for of_axis in cells)
            out[inside] = fields.values(name, number, box)[cells]
            filled[inside] = True
    out, filled = fields.total(out), fields.any(filled)
    out[~filled] = np.nan
    return out


@dataclass(frozen=True)
class ChargeSpread:
    """Where the charge lies: total magnitude (C), centre (m) and covariance (m²), by the magnitude of the density."""

    charge: float
    centre: Array
    covariance: Array


def spread_of(fields: Composite, name: str = "rho") -> ChargeSpread:
    """Return where a density is, the middle of the domain if it is zero. Images nearest to its circular mean count."""
    middle_of_it, repeats = _middle(fields, name)
    charge, first, second = np.zeros(1), np.zeros(3), np.zeros((3, 3))
    for cells, centres in _charges(fields, name):
        axes = [nearest(centres[d] - middle_of_it[d], repeats[d]) for d in range(3)]
        charge += cells.sum()
        sums = [cells.sum(axis=others(d)) for d in range(3)]
        first += [sums[d] @ axes[d] for d in range(3)]
        second += np.diag([sums[d] @ axes[d] ** 2 for d in range(3)])
        for a, b in ((0, 1), (0, 2), (1, 2)):
            mixed = axes[a] @ cells.sum(axis=3 - a - b) @ axes[b]
            second[a, b] += mixed
            second[b, a] += mixed
    total, *moments = fields.total(np.concatenate([charge, first, second.ravel()]))
    if total == 0.0:
        return ChargeSpread(0.0, middle_of_it, np.zeros((3, 3)))
    mean, square = np.array(moments[:3]) / total, np.reshape(moments[3:], (3, 3)) / total
    (centre,) = wrapped((middle_of_it + mean)[None], fields.lower, fields.upper, fields.periodic)
    return ChargeSpread(float(total), centre, square - np.outer(mean, mean))


def _charges(fields: Composite, name: str) -> Iterator[tuple[Array, list[Array]]]:
    """Yield charges of uncovered cells of each box that is here, (nx, ny, nz) C without sign, and their centres per axis, m."""
    for level, description in enumerate(fields.levels):
        volume = float(np.prod(description.spacing))
        for box in fields.here(level):
            corners = description.boxes[box]
            cells = np.where(fields.covered(level, box), 0.0, np.abs(fields.values(name, level, box)) * volume)
            yield (
                cells,
                [
                    fields.lower[d] + (np.arange(corners[d], corners[3 + d] + 1) + 0.5) * description.spacing[d]
                    for d in range(3)
                ],
            )


def _middle(fields: Composite, name: str) -> tuple[Array, Array]:
    """Return the middle of the domain, or along periodic axes of a density that has one, and the period about it, (3,) in m.

    The period is infinite where the middle is that of the domain.
    """
    out, repeats = (fields.lower + fields.upper) / 2, np.full(3, np.inf)
    if not any(fields.periodic):
        return out, repeats
    sums, length = np.zeros(7), fields.upper - fields.lower
    for cells, centres in _charges(fields, name):
        sums[0] += cells.sum()
        for d in np.flatnonzero(fields.periodic).tolist():
            angle = 2 * np.pi * (centres[d] - fields.lower[d]) / length[d]
            of_axis = cells.sum(axis=others(d))
            sums[1 + 2 * d : 3 + 2 * d] += of_axis @ np.cos(angle), of_axis @ np.sin(angle)
    total, *sums_of_axes = fields.total(sums).tolist()
    for d in np.flatnonzero(fields.periodic).tolist() if total > 0 else []:
        place, _ = middle(sums_of_axes[2 * d] / total, sums_of_axes[2 * d + 1] / total, np.inf)
        if np.isfinite(place):
            out[d], repeats[d] = fields.lower[d] + place * length[d], length[d]
    return out, repeats


LONG = 3.0  # variance along a train over that across it, from which on its own direction is taken


def line_through(fields: Composite, spread: ChargeSpread, axis: int | None = None) -> Line:
    """Return the line through the middle of the charge: along an axis, or along a train of bunches, or else along x."""
    direction = direction_of(spread) if axis is None else np.eye(3)[axis]
    with np.errstate(divide="ignore"):
        walls = np.stack([fields.lower - spread.centre, fields.upper - spread.centre]) / direction
    walls = np.where(direction == 0, [[-np.inf], [np.inf]], np.sort(walls, axis=0))
    start, stop = walls[0].max(), walls[1].min()
    step = 0.5 * float(fields.levels[-1].spacing.min())
    count = int(np.clip((stop - start) / step, 2, 20_000))
    return Line(spread.centre, direction, start + (np.arange(count) + 0.5) * (stop - start) / count)


def direction_of(spread: ChargeSpread) -> Array:
    """Return the direction of a train of bunches, or x."""
    sizes, directions = np.linalg.eigh(spread.covariance)
    direction = np.array([1.0, 0.0, 0.0])
    if sizes[2] > LONG * max(sizes[1], 0.0) and sizes[2] > 0:
        direction = directions[:, 2] * np.sign(directions[np.argmax(np.abs(directions[:, 2])), 2])
        direction[np.abs(direction) < 1e-3] = 0.0  # bunches of particles are never quite straight
        direction /= np.linalg.norm(direction)
    return direction

"""Values and gradients of fields at any points, by least squares across levels.

A polynomial is fitted to the cells around each point that no finer level covers, in coordinates from the point in cell widths
of the finest level there; so long cells are treated as cubes. Fits end at walls and go on across periodic faces.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from .. import gmls
from ..errors import InputError
from ..parallel import share
from .boxes import cells_of, each_cell, rows_of
from .composite import Composite
from .periods import wrapped
from .polynomials import require_order

Array = NDArray[Any]

REACH = {1: 1.8, 2: 2.3, 3: 2.6, 4: 3.1}  # in cell widths of the finest level at the point
GROWTH, GROWTHS = 1.15, 8  # of reaches that do not determine a fit, and most of them
# What a fit must keep to be used: Σ|α| of a value, 2 where all cells are there, and the least pivot of the normal equations.
# Corners of walls want long reaches to keep the first bounds; where even these do not, the second ones do.
WANTED, ENOUGH = (10.0, 5e-4), (40.0, 1e-6)
TOGETHER = 2048  # points
CANDIDATES = 1 << 20  # cells that are looked up together
FINER = 2  # levels above that of a point; of the cells of still finer ones a fit takes one in each cell of that level
QUANTITIES = ("value", "gradient")


@dataclass(frozen=True)
class Request:
    """What is wanted of a field. InputError for what makes no sense."""

    order: int = 3  # of the polynomials, 1 to 4
    what: str = "value"  # or "gradient"
    kappa: float = 0.0  # a cell holds the value at its centre plus kappa times its width² times the second derivatives
    level: int | None = None  # whose cells alone are taken; none: those of all levels that no finer one covers

    def __post_init__(self) -> None:
        require_order(self.order, tuple(REACH), "a sample")
        if self.what not in QUANTITIES:
            raise InputError(f'{self.what!r} cannot be sampled; use "value" or "gradient"')
        if not (isinstance(self.kappa, int | float) and np.isfinite(self.kappa)) or isinstance(self.kappa, bool):
            raise InputError(f"kappa is {self.kappa!r}; give a number, such as 1/24 for means over cells")


def fitted_values(fields: Composite, name: str, points: Array, request: Request) -> Array:
    """Return a field at points (n, 3) in m, the same on all ranks: (n, *components), of gradients (n, *components, 3).

    Points beyond periodic faces have the values of their images. nan outside the domain and, with a level, where that has no
    cells. Collective over `fields.comm`; all ranks pass the same points. InputError where too few cells lie around a point for
    the order.
    """
    shape = ((3,) if fields.is_vector(name) else ()) + ((3,) if request.what == "gradient" else ())
    out = np.full((len(points), *shape), np.nan)
    for first in range(0, len(points), TOGETHER):
        chunk = slice(first, first + TOGETHER)
        out[chunk] = _Sampler(fields, name, request, points[chunk]).values(shape)
    return out


@dataclass(frozen=True)
class _Cells:
    """Cells around points, those of each point side by side in an order that the mesh settles."""

    point: Array  # (m,) which point, ascending
    offset: Array  # (m, 3) from it, in its widths
    width: Array  # (m,) in its widths
    level: Array  # (m,)
    box: Array  # (m,) of the level
    index: Array  # (m, 3) in the domain


# the columns of no cells
NOTHING = np.zeros(0, int), np.zeros((0, 3)), np.zeros(0), np.zeros(0, int), np.zeros(0, int), np.zeros((0, 3), int)


class _Sampler:
    """Points, with the finest level at each."""

    def __init__(self, fields: Composite, name: str, request: Request, points: Array) -> None:
        self.fields, self.name, self.request = fields, name, request
        self.levels = range(len(fields.levels)) if request.level is None else [request.level]
        self.points = wrapped(points, fields.lower, fields.upper, fields.periodic)
        self.home = self._homes()

    def values(self, shape: tuple[int, ...]) -> Array:
        """Return what is wanted at the points, nan outside. Collective."""
        out = np.full((len(self.points), *shape), np.nan)
        left, reach = np.flatnonzero(self.home >= 0), REACH[self.request.order]
        for n in range(GROWTHS):
            if left.size == 0:
                break
            values, good = self._fitted(left, reach, shape, WANTED if n < GROWTHS // 2 else ENOUGH)
            out[left[good]] = values[good]
            left, reach = left[~good], reach * GROWTH
        if left.size:
            raise InputError(
                f"too few cells lie around the point {self.points[left[0]].tolist()} m for order {self.request.order}; "
                "use a lower one"
            )
        return out

    def _extent(self, level: int) -> Array:
        return np.rint((self.fields.upper - self.fields.lower) / self.fields.levels[level].spacing).astype(np.int64)

    def _places(self, level: int) -> Array:
        """Return the points in cell widths of a level, from the lower corner of the domain."""
        return (self.points - self.fields.lower) / self.fields.levels[level].spacing

    def _homes(self) -> Array:
        """Return the finest level at each point, -1 outside."""
        inside = ((self.points >= self.fields.lower) & (self.points <= self.fields.upper)).all(axis=1)
        out = np.full(len(self.points), -1)
        for level in self.levels:
            index = np.minimum(np.floor(self._places(level)[inside]).astype(np.int64), self._extent(level) - 1)
            has_home = np.zeros(len(self.points), dtype=bool)
            has_home[inside] = self.fields.levels[level].table.find(rows_of(index)) >= 0
            out[has_home] = level
        return out

    # ---- the cells around ----

    def _around(self, points: Array, reach: float) -> _Cells:
        """Return the cells whose centres lie within a reach of some points."""
        parts = []
        for home in np.unique(self.home[points]):
            at = np.flatnonzero(self.home[points] == home)
            places = self._places(home)[points[at]]
            parts += [cells for level in self.levels for cells in self._of_level(at, places, home, level, reach)]
        parts.append(NOTHING)
        point, offset, width, level, box, index = (np.concatenate(column) for column in zip(*parts, strict=True))
        order = np.argsort(point, kind="stable")
        return _Cells(*(column[order] for column in (point, offset, width, level, box, index)))

    def _of_level(self, at: Array, places: Array, home: int, level: int, reach: float) -> Iterator[tuple[Array, ...]]:
        """Yield columns of `_Cells` for the cells of a level around points `at`, of some points at a time."""
        width = 2.0 ** (int(home) - level)
        stride = 2 ** max(level - int(home) - FINER, 0)  # one cell is taken of so many along each axis
        block, chosen = width * stride, stride // 2
        within = (chosen + 0.5) / stride  # of its block
        lowest = np.ceil((places - reach) / block - within).astype(np.int64)
        highest = lowest + int(2 * reach / block)
        of_level, extent = self.fields.levels[level], self._extent(level) // stride
        crossing = (((lowest < 0) | (highest >= extent)) & np.array(self.fields.periodic)).any(axis=1)
        # Else they end where the level does: the reach from a point beside many levels is far wider than the finest of them.
        least, most = of_level.bounds
        ends = np.maximum(lowest * stride, least), np.minimum((highest + 1) * stride - 1, most)
        windows = np.where(crossing[:, None], np.hstack([lowest, highest]), np.hstack(ends) // stride)
        near = np.flatnonzero(crossing | of_level.table.meets(rows_of(np.hstack(ends))).astype(bool))
        groups = np.cumsum(cells_of(windows[near])) // CANDIDATES
        for group in np.split(near, np.flatnonzero(np.diff(groups)) + 1):
            row, blocks = each_cell(windows[group])
            point = group[row]
            offset = (blocks + within) * block - places[point]
            inside = np.flatnonzero((offset**2).sum(axis=1) < reach**2)
            index, box = self._looked_up(level, blocks[inside] * stride + chosen)
            in_box = box >= 0
            inside = inside[in_box]
            sizes = np.full(len(inside), width), np.full(len(inside), level)
            yield at[point[inside]], offset[inside], *sizes, box[in_box], index[in_box]

    def _looked_up(self, level: int, cells: Array) -> tuple[Array, Array]:
        """Return indices of cells (n, 3) in the domain, and their boxes, -1 for those that are not there or do not count."""
        extent, levels = self._extent(level), self.fields.levels
        index = np.where(np.array(self.fields.periodic), cells % extent, cells)
        box = levels[level].table.find(rows_of(index))  # behind walls there are none
        if self.request.level is None and level + 1 < len(levels):
            in_box = np.flatnonzero(box >= 0)
            box[in_box[levels[level + 1].table.find(rows_of(2 * index[in_box])) >= 0]] = -1
        return index, box

    def _held(self, cells: _Cells) -> Array:
        """Return what cells hold, (m,) or (m, 3). Collective."""
        out = np.zeros((len(cells.point), 3) if self.fields.is_vector(self.name) else len(cells.point))
        for level in np.unique(cells.level):
            of_level = np.flatnonzero(cells.level == level)
            for box in np.intersect1d(cells.box[of_level], self.fields.here(level)):
                rows = of_level[cells.box[of_level] == box]
                place = (cells.index[rows] - self.fields.levels[level].boxes[box, :3]).T
                out[rows] = self.fields.values(self.name, int(level), box)[tuple(place)]
        return self.fields.total(out)

    # ---- the fit ----

    def _fitted(
        self, points: Array, reach: float, shape: tuple[int, ...], bounds: tuple[float, float]
    ) -> tuple[Array, Array]:
        """Return what is wanted at some points, from the cells within a reach, and where these determine it. Collective.

        Each rank finds the weights for its share of the points.
        """
        cells = self._around(points, reach)
        values_of_cells = self._held(cells)
        first, last = share(self.fields.comm, len(points))
        start = np.searchsorted(cells.point, np.arange(first, last + 1))
        out, good = np.zeros((len(points), *shape)), np.zeros(len(points))
        if last > first:
            entries = slice(start[0], start[-1])
            stencils = self._stencils(cells.offset[entries], cells.width[entries], start - start[0], reach)
            growth = np.add.reduceat(np.abs(stencils.weights[:, 0]), stencils.start[:-1])
            good[first:last] = (growth <= bounds[0]) & (stencils.quality.pivot >= bounds[1])
            fitted = stencils.apply(values_of_cells[entries])[self.request.what]
            if self.request.what == "gradient":  # (n, 3, *components)
                widths = np.array([level.spacing for level in self.fields.levels])[self.home[points[first:last]]]
                fitted = np.moveaxis(fitted / widths.reshape(-1, 3, *[1] * (fitted.ndim - 2)), 1, -1)
            out[first:last] = np.where(good[first:last].reshape(-1, *[1] * (fitted.ndim - 1)) > 0, fitted, 0.0)
        return self.fields.total(out), self.fields.total(good) > 0

    def _stencils(self, offset: Array, width: Array, start: Array, reach: float) -> gmls.Stencils:
        """Return the weights of the cells around points, in coordinates from each point; of the value first."""
        request, count = self.request, len(start) - 1
        samples = gmls.Points(offset)
        if request.kappa != 0:
            samples = gmls.WithLaplacian(offset, width[:, None], request.kappa)
        return gmls.stencils(
            np.zeros((count, 3)),
            gmls.Neighbours(start, np.arange(len(offset), dtype=np.int32), np.full(count, reach)),
            space=gmls.Scalar(request.order),
            samples=samples,
            wanted=[gmls.VALUE, *([gmls.GRADIENT] if request.what == "gradient" else [])],
            failed="mark",
        )

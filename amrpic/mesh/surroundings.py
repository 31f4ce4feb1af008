"""The cells of a level around each of some of its cells, on one dense array: of its own level, and coarser where it ends."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
import scipy
from numpy.typing import NDArray

from .. import _native
from .boxes import table_of
from .hierarchy import Hierarchy

Array = NDArray[Any]

WALL = -1  # behind one there are no cells
UNKNOWN = -2


@dataclass(frozen=True)
class CellLattice:
    """The levels of a hierarchy as lattices, with look-ups of their boxes."""

    hierarchy: Hierarchy

    @cached_property
    def tables(self) -> list[_native.BoxTable]:
        """A look-up of each level's boxes by cells."""
        return [table_of(self.hierarchy.boxes(level)) for level in range(self.hierarchy.levels)]

    @cached_property
    def boxes(self) -> list[Array]:
        """The boxes of each level."""
        return [self.hierarchy.boxes(level).astype(np.int64) for level in range(self.hierarchy.levels)]

    def extent(self, level: int) -> Array:
        """Cells of the domain along each axis, were it all of one level."""
        return np.array(self.hierarchy.domain.cells, dtype=np.int64) << level

    def images(self, level: int, lower: Array, upper: Array) -> Iterator[Array]:
        """Yield the shifts by whole periods under which the domain meets a region."""
        cells, periodic = self.extent(level), self.hierarchy.domain.periodic
        spans = [range(lower[d] // cells[d], upper[d] // cells[d] + 1) if periodic[d] else range(1) for d in range(3)]
        for z in spans[2]:
            for y in spans[1]:
                for x in spans[0]:
                    yield np.array([x, y, z]) * cells

    def meeting(self, level: int, lower: Array, upper: Array) -> Iterator[tuple[int, Array, Array, Array]]:
        """Yield a box, the common part's corners in the region's indices, and their shift from the domain; for each image."""
        for shift in self.images(level, lower, upper):
            for box in self.tables[level].meeting((lower - shift).tolist(), (upper - shift).tolist()):
                corners = self.boxes[level][box]
                yield int(box), np.maximum(corners[:3] + shift, lower), np.minimum(corners[3:] + shift, upper), shift

    def held(self, level: int, lower: Array, upper: Array) -> Array:
        """Return where a level has cells in a region, bool (nx, ny, nz)."""
        out = np.zeros(upper - lower + 1, dtype=bool, order="F")
        if level < self.hierarchy.levels:
            for _, first, last, _ in self.meeting(level, lower, upper):
                out[block(first - lower, last - lower)] = True
        return out

    def leaves(self, level: int, lower: Array, upper: Array) -> Array:
        """Return where a level has cells in a region that no finer one covers, bool (nx, ny, nz)."""
        out = self.held(level, lower, upper)
        if level + 1 < self.hierarchy.levels and out.any():
            out &= ~self.held(level + 1, 2 * lower, 2 * upper + 1)[::2, ::2, ::2]
        return out


def block(first: Array, last: Array) -> tuple[Any, ...]:
    """Return the slices of a block of cells, corners inclusive."""
    return tuple(slice(int(a), int(b) + 1) for a, b in zip(first, last, strict=True))


@dataclass(frozen=True)
class Piece:
    """Cells of a box of some level that fill a block of the dense array."""

    level: int
    box: int
    here: tuple[slice, ...]  # in the dense array
    index: tuple[Array, ...]  # which of the cells there fills each place along each axis


@dataclass(frozen=True)
class Surroundings:
    """A box of a level, grown by `width` cells on all sides."""

    level: int
    box: Array  # its corners
    width: int
    depth: Array  # int8 (nx, ny, nz): how many levels coarser the cell is that holds a place, or WALL
    pieces: list[Piece]  # coarse to fine

    @classmethod
    def of_box(cls, lattice: CellLattice, level: int, box: int, width: int) -> Surroundings:
        """Return what lies in and around a box."""
        corners = lattice.boxes[level][box]
        lower, upper = corners[:3] - width, corners[3:] + width
        depth = np.full(upper - lower + 1, UNKNOWN, dtype=np.int8, order="F")
        for d, periodic in enumerate(lattice.hierarchy.domain.periodic):
            outside = np.arange(lower[d], upper[d] + 1)
            outside = (outside < 0) | (outside >= lattice.extent(level)[d])
            if not periodic:
                depth[(slice(None),) * d + (outside,)] = WALL
        pieces: list[Piece] = []
        for coarser in range(level + 1):
            if not (depth == UNKNOWN).any():
                break
            pieces += _painted(lattice, level, coarser, lower, upper, depth)
        return cls(level, corners, width, depth, pieces[::-1])

    @property
    def needed(self) -> set[tuple[int, int]]:
        """The boxes whose values fill it: level and number."""
        return {(piece.level, piece.box) for piece in self.pieces}

    def values(self, of_box: Callable[[int, int], Array]) -> Array:
        """Return the dense array of the values that `of_box(level, box)` gives, zero behind walls."""
        out = np.zeros(self.depth.shape, order="F")
        for piece in self.pieces:
            out[piece.here] = of_box(piece.level, piece.box)[np.ix_(*piece.index)]
        return out

    @property
    def size(self) -> Array:
        """Cells of the box along each axis."""
        return self.box[3:] - self.box[:3] + 1

    def largest_depth(self) -> Array:
        """Return the largest depth within `width` of each cell of the box."""
        most = scipy.ndimage.maximum_filter(np.maximum(self.depth, 0), 2 * self.width + 1, mode="constant")
        return most[block(np.full(3, self.width), self.width + self.size - 1)]

    def irregular(self) -> Array:
        """Return which cells of the box have walls or coarser cells within `width`."""
        deeper = scipy.ndimage.maximum_filter((self.depth != 0).astype(np.int8), 2 * self.width + 1, mode="constant")
        return deeper[block(np.full(3, self.width), self.width + self.size - 1)].astype(bool)


def _painted(
    lattice: CellLattice, level: int, coarser: int, lower: Array, upper: Array, depth: Array
) -> Iterator[Piece]:
    """Fill places that are unknown so far with cells so many levels coarser, and yield the pieces that do."""
    painted = depth != UNKNOWN
    for box, first, last, shift in lattice.meeting(level - coarser, lower >> coarser, upper >> coarser):
        low = np.maximum(first << coarser, lower)
        high = np.minimum(((last + 1) << coarser) - 1, upper)
        region = block(low - lower, high - lower)
        if painted[region].all():
            continue
        depth[region] = np.where(painted[region], depth[region], coarser)
        origin = lattice.boxes[level - coarser][box][:3] + shift
        index = tuple((np.arange(low[d], high[d] + 1) >> coarser) - origin[d] for d in range(3))
        yield Piece(level - coarser, box, region, index)

"""The layer of cells at a wall that emits: the field at the wall, and within the first two cells.

A mesh knows the mean charge of a cell, but where particles start at rest most of it lies close to the wall. There the field
along the normal follows from Gauss's law within the cell: from the flux at its face, and the part of its charge that is below.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from mpi4py import MPI

from ..mesh.field import Field
from ..mesh.hierarchy import Hierarchy
from ..particles.clouds import Shape
from ..particles.particles import Particles

CELLS = 2  # in which the field follows from Gauss's law
READ = CELLS + 2  # of a column, whose values are read
BINS = (
    16  # of each of these two cells, in which charge is summed: cubic in the first one, where particles start at rest
)
EDGES = np.array([(np.arange(BINS + 1) / BINS) ** 3, np.arange(BINS + 1) / BINS])
Function = Callable[[np.ndarray, np.ndarray, np.ndarray], np.ndarray | float]


class Columns:
    """The columns of cells behind a face of the domain, each of the finest level there; the same on all ranks.

    They are sorted by level, and by place across: whatever boxes the cells are in.
    """

    def __init__(self, hierarchy: Hierarchy, face: int) -> None:
        self.hierarchy = hierarchy
        self.axis, self.side = divmod(face, 2)
        self.across = [axis for axis in range(3) if axis != self.axis]
        touching = [self._keys(level, 0) for level in range(hierarchy.levels)]
        covered = [self._parents(level, keys) for level, keys in enumerate(touching[1:])]
        empty = np.zeros(0, dtype=np.int64)
        self._sorted = [np.setdiff1d(keys, below) for keys, below in zip(touching, [*covered, empty], strict=True)]
        counts = [len(keys) for keys in self._sorted]
        self._first = np.concatenate([[0], np.cumsum(counts)])
        self.level = np.repeat(np.arange(hierarchy.levels), counts)  # (n,) of each column
        self.width = np.array([hierarchy.spacing(level) for level in range(hierarchy.levels)])[self.level]  # (n, 3) m
        # whether a cell of a column's own level is in each place of it
        self._has = np.stack([self._filled(layer) for layer in range(READ)], axis=1)

    def __len__(self) -> int:
        return len(self.level)

    @cached_property
    def corner(self) -> np.ndarray:
        """(n, 3) m: the lower corner of the face of each column, on the wall."""
        out = np.empty((len(self), 3))
        out[:, self.axis] = (self.hierarchy.domain.lower, self.hierarchy.domain.upper)[self.side][self.axis]
        rows = np.array([self._cells(level)[1] for level in range(self.hierarchy.levels)])[self.level]
        index = np.stack(np.divmod(np.concatenate(self._sorted), rows), axis=1)
        out[:, self.across] = self.hierarchy.lower[self.across] + index * self.width[:, self.across]
        return out

    @cached_property
    def area(self) -> np.ndarray:
        """(n,) m², of the face of each column."""
        return self.width[:, self.across].prod(axis=1)

    @cached_property
    def centre(self) -> np.ndarray:
        """(n, 3) m: the middle of the face of each column."""
        out = self.corner.copy()
        out[:, self.across] += self.width[:, self.across] / 2
        return out

    @property
    def inwards(self) -> int:
        """1 if the normal into the domain points up the axis, else -1."""
        return 1 - 2 * self.side

    def find(self, position: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return the column (m,) of places (m, 3) in the domain, and their distance from the wall in cells of it (m,)."""
        column = np.full(len(position), -1)
        for level in reversed(range(self.hierarchy.levels)):
            if len(self._sorted[level]) == 0:
                continue
            cells, spacing = self._cells(level), self.hierarchy.spacing(level)[self.across]
            index = np.floor((position[:, self.across] - self.hierarchy.lower[self.across]) / spacing).astype(np.int64)
            key = np.clip(index, 0, cells - 1) @ [cells[1], 1]
            place = np.minimum(np.searchsorted(self._sorted[level], key), len(self._sorted[level]) - 1)
            holds = (column < 0) & (self._sorted[level][place] == key)
            column[holds] = self._first[level] + place[holds]
        wall = (self.hierarchy.domain.lower, self.hierarchy.domain.upper)[self.side][self.axis]
        return column, self.inwards * (position[:, self.axis] - wall) / self.width[column, self.axis]

    def read(self, field: Field) -> np.ndarray:
        """Return the values of a field in the first cells of each column, from the wall on, (n, READ). Collective.

        What another level holds is taken to be the value before it.
        """
        out = np.zeros((len(self), READ))
        for patch in field.patches:
            for layer in range(READ):
                cell = self._layer(patch.level, layer)
                if not patch.lower[self.axis] <= cell <= patch.upper[self.axis]:
                    continue
                keys = self._key_table(patch.level, np.array([*patch.lower, *patch.upper]))
                values = np.take(patch.data, cell - patch.lower[self.axis], axis=self.axis)
                place, chosen = self._places(patch.level, keys.ravel())
                out[place, layer] = values.ravel()[chosen]
        self.hierarchy.comm.Allreduce(MPI.IN_PLACE, out)
        for layer in range(1, READ):
            out[:, layer] = np.where(self._has[:, layer], out[:, layer], out[:, layer - 1])
        return out

    def _cells(self, level: int) -> np.ndarray:
        """Return the number of cells across on a level, (2,)."""
        return np.array(self.hierarchy.domain.cells)[self.across] * 2**level

    def _layer(self, level: int, layer: int) -> int:
        """Return the index along the normal of the cells in a place from the wall."""
        return layer if self.side == 0 else self.hierarchy.domain.cells[self.axis] * 2**level - 1 - layer

    def _key_table(self, level: int, box: np.ndarray) -> np.ndarray:
        """Return the keys of a box's cells across, as a table along both axes."""
        first, second = (np.arange(box[axis], box[axis + 3] + 1, dtype=np.int64) for axis in self.across)
        return first[:, None] * self._cells(level)[1] + second

    def _keys(self, level: int, layer: int) -> np.ndarray:
        """Return the keys, ascending, of all cells of a level in a place from the wall."""
        boxes, cell = self.hierarchy.boxes(level), self._layer(level, layer)
        holding = boxes[(boxes[:, self.axis] <= cell) & (cell <= boxes[:, self.axis + 3])]
        return np.unique(np.concatenate([np.zeros(0, np.int64), *(self._key_table(level, b).ravel() for b in holding)]))

    def _parents(self, level: int, keys: np.ndarray) -> np.ndarray:
        """Return the keys on a level of the parents of cells of the next one."""
        first, second = np.divmod(keys, self._cells(level + 1)[1])
        return np.unique(first // 2 * self._cells(level)[1] + second // 2)

    def _places(self, level: int, keys: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return the columns of those keys on a level that have one, and which these are."""
        own = self._sorted[level]
        if len(own) == 0:
            return np.zeros(0, np.int64), np.zeros(len(keys), bool)
        place = np.minimum(np.searchsorted(own, keys), len(own) - 1)
        chosen = own[place] == keys
        return self._first[level] + place[chosen], chosen

    def _filled(self, layer: int) -> np.ndarray:
        """Return whether the cell in a place from the wall is of the column's level, (n,)."""
        out = np.zeros(len(self), dtype=bool)
        for level in range(self.hierarchy.levels):
            out[self._places(level, self._keys(level, layer))[0]] = True
        return out


@dataclass(frozen=True, eq=False)
class NormalField:
    """The field along the normal into the domain in the first cells of columns, V/m."""

    faces: np.ndarray  # (n, READ): at the wall and the faces behind it
    centres: np.ndarray  # (n, READ - 1): as the mesh has it in the cells between these

    def with_exact(self, exact: NormalField) -> NormalField:
        """Return this field of all charge with the faces of a part of it as they are known exactly.

        What is left at the faces is that of the rest: linear between centres, and up to the wall.
        """
        return NormalField(self.faces + exact.faces - _linear(exact.centres), self.centres)


def of_potential(columns: Columns, phi: Field, at_wall: Function | None) -> NormalField:
    """Return the normal field of a potential of second order that has given values at the wall, 0 V by default. Collective.

    At the wall it is the flux of the discrete equation there, so that the first cells keep Gauss's law exactly.
    """
    values, faces = columns.read(phi), np.empty((len(columns), READ))
    wall = 0.0 if at_wall is None else at_wall(*columns.centre.T)
    faces[:, 0] = (8 / 3) * wall - 3 * values[:, 0] + values[:, 1] / 3
    faces[:, 1:] = values[:, :-1] - values[:, 1:]
    faces /= columns.width[:, [columns.axis]]
    return NormalField(faces, (faces[:, :-1] + faces[:, 1:]) / 2)


def of_component(columns: Columns, component: Field) -> NormalField:
    """Return the normal field of which the component along the axis is known in cells; linear up to the wall. Collective."""
    centres = columns.inwards * columns.read(component)[:, :-1]
    return NormalField(_linear(centres), centres)


def _linear(centres: np.ndarray) -> np.ndarray:
    """Return values at faces (n, k + 1) from those in cells (n, k): the means, and beyond the ends what goes on linearly."""
    first, last = (1.5 * centres[:, end] - 0.5 * centres[:, next] for end, next in ((0, 1), (-1, -2)))
    return np.column_stack([first, (centres[:, :-1] + centres[:, 1:]) / 2, last])


@dataclass(frozen=True, eq=False)
class WallLayer:
    """The field in the first cells at a wall, and how the charge of particles lies in them."""

    columns: Columns
    field: NormalField
    below: np.ndarray  # (n, CELLS, BINS + 1): part of the charge of a cell that is below the edges of its bins

    @classmethod
    def of(cls, columns: Columns, field: NormalField, particles: Particles) -> WallLayer:
        """Return the layer with these particles in it. Collective."""
        near = _Near(columns, particles.position)
        charge = np.abs(particles.weight * particles.charge)[near.chosen]
        sums = np.bincount(near.place, charge, len(columns) * CELLS * BINS).reshape(-1, CELLS, BINS)
        columns.hierarchy.comm.Allreduce(MPI.IN_PLACE, sums)
        total = np.cumsum(sums, axis=2)
        evenly = np.broadcast_to(np.diff(EDGES), sums.shape).cumsum(axis=2)
        below = np.divide(total, total[:, :, -1:], out=evenly, where=total[:, :, -1:] > 0)
        return cls(columns, field, np.concatenate([np.zeros((*sums.shape[:2], 1)), below], axis=2))

    @property
    def at_wall(self) -> np.ndarray:
        """(n,) V/m, along the normal into the domain."""
        return self.field.faces[:, 0]

    def correct(self, electric: np.ndarray, particles: Particles, shape: Shape) -> None:
        """Add to fields at particles (n, 3), V/m, what Gauss's law within cells has beyond the mesh's field along the normal.

        In the column of a particle alone, so what differs across columns stays as it is gathered.
        """
        near = _Near(self.columns, particles.position)
        column, cell, bin, part = near.column, near.cell, near.bin, near.part
        low, high = (EDGES[cell, bin + up] for up in (0, 1))
        below, above = (self.below[column, cell, bin + up] for up in (0, 1))
        share = below + (above - below) * (part - low) / (high - low)
        faces = self.field.faces
        within = faces[column, cell] + (faces[column, cell + 1] - faces[column, cell]) * share
        gathered = gathered_from(self.field.centres, column, cell, part, shape)
        electric[near.chosen, self.columns.axis] += self.columns.inwards * (within - gathered)


def gathered_from(
    centres: np.ndarray, column: np.ndarray, cell: np.ndarray, part: np.ndarray, shape: Shape
) -> np.ndarray:
    """Return what clouds of a shape gather along columns of values in cells, at parts of these; beyond the wall the first."""
    if shape == "nearest-grid-point":
        return centres[column, cell]
    low, high = centres[column, np.maximum(cell - 1, 0)], centres[column, cell + 1]
    way = part - 0.5
    if shape == "triangular-shaped-cloud":
        return 0.5 * (0.5 - way) ** 2 * low + (0.75 - way**2) * centres[column, cell] + 0.5 * (0.5 + way) ** 2 * high
    return centres[column, cell] * (1 - np.abs(way)) + np.where(way < 0, low, high) * np.abs(way)


class _Near:
    """Which particles are in the first cells at a wall, and where there."""

    def __init__(self, columns: Columns, position: np.ndarray) -> None:
        lower, upper = (
            corner[columns.axis] for corner in (columns.hierarchy.domain.lower, columns.hierarchy.domain.upper)
        )
        along, reach = position[:, columns.axis], CELLS * columns.hierarchy.spacing(0)[columns.axis]
        close = np.flatnonzero(along < lower + reach if columns.side == 0 else along > upper - reach)
        column, distance = columns.find(position[close])
        inside = np.flatnonzero((column >= 0) & (distance < CELLS))
        distance = np.maximum(distance[inside], 0.0)
        self.chosen, self.column = close[inside], column[inside]
        self.cell = distance.astype(np.int64)
        self.part = distance - self.cell  # of the cell, from the wall
        scaled = np.where(self.cell == 0, np.cbrt(self.part), self.part)
        self.bin = np.minimum((scaled * BINS).astype(np.int64), BINS - 1)
        self.place = (self.column * CELLS + self.cell) * BINS + self.bin

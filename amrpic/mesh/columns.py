"""The columns of cells behind a face of the domain: what lies at a wall, whatever boxes hold it."""

from __future__ import annotations

from functools import cached_property

import numpy as np

from ..mpi import MPI
from .field import Field
from .hierarchy import Hierarchy

READ = 4  # cells of a column from the wall on whose values are read


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

    def places_on(self, level: int) -> np.ndarray:
        """Return the indices across (2, n) of the cells of a level in which the middles of columns lie."""
        spacing = self.hierarchy.spacing(level)[self.across]
        index = np.floor((self.centre[:, self.across] - self.hierarchy.lower[self.across]) / spacing).astype(np.int64)
        return np.clip(index, 0, self._cells(level) - 1).T

    def beside(self, column: np.ndarray, step: tuple[int, int]) -> np.ndarray:
        """Return the columns (m,) that are so many widths of columns (m,) away across; at the end of a wall the last ones."""
        domain, place = self.hierarchy.domain, self.centre[column]
        place[:, self.across] += np.array(step) * self.width[column][:, self.across]
        for axis in self.across:
            if domain.periodic[axis]:
                length = domain.upper[axis] - domain.lower[axis]
                place[:, axis] = domain.lower[axis] + (place[:, axis] - domain.lower[axis]) % length
        return self.find(place)[0]

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

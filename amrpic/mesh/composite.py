"""Values on levels of boxes, of which the finest cell counts at each place: those of fields, or of a file that holds some."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from .. import _native
from ..errors import InputError
from ..mpi import MPI
from .boxes import cells_of, table_of
from .domain import AXES
from .hierarchy import Hierarchy

Array = NDArray[Any]


@dataclass(frozen=True)
class Level:
    """The boxes of a level."""

    spacing: Array  # (3,) m
    boxes: Array  # (n, 6): lower x, y, z, upper x, y, z, inclusive
    starts: Array  # (n,): row of the first cell of each box

    @cached_property
    def table(self) -> _native.BoxTable:
        """A look-up of the boxes by their cells."""
        return table_of(self.boxes)

    @cached_property
    def bounds(self) -> tuple[Array, Array]:
        """The lowest and the highest index of a cell along each axis, (3,) each."""
        return self.boxes[:, :3].min(axis=0), self.boxes[:, 3:].max(axis=0)


class Composite(ABC):
    """Scalars and vectors by name on levels of boxes. Ranks of `comm` may share one: each has the boxes that are `here`."""

    comm: MPI.Comm = MPI.COMM_SELF
    lower: Array  # (3,) m
    upper: Array
    levels: list[Level]  # coarse to fine
    units: dict[str, str]  # of what it holds, by name

    @property
    @abstractmethod
    def periodic(self) -> tuple[bool, bool, bool]:
        """Whether space repeats along each axis."""

    @property
    @abstractmethod
    def label(self) -> str:
        """What messages call it."""

    @abstractmethod
    def is_vector(self, name: str) -> bool:
        """Whether `values` gives vectors."""

    @abstractmethod
    def _values(self, name: str, level: int, box: int | np.integer[Any]) -> Array:
        """Return what it holds in a box: (nx, ny, nz), or (nx, ny, nz, 3) of a vector."""

    @property
    def reach(self) -> float:
        """The largest coordinate in m, which settles the prefix of lengths."""
        return float(np.abs([self.lower, self.upper]).max())

    def values(self, name: str, level: int, box: int | np.integer[Any]) -> Array:
        """Return a field in a box of a level: (nx, ny, nz), or (nx, ny, nz, 3) of a vector.

        Of a vector field "E" there are also its length "|E|" and its components "Ex", "Ey" and "Ez".
        """
        vector, component = self._vector_of(name)
        if vector is None:
            return self._values(name, level, box)
        values = self._values(vector, level, box)
        return np.sqrt(np.sum(values**2, axis=-1)) if component is None else values[..., component]

    def unit(self, name: str) -> str:
        """Return the unit of what `values` gives. Raises InputError if it is not there."""
        vector, _ = self._vector_of(name)
        field = vector or name
        if field not in self.units:
            raise InputError(f"{self.label} holds no {name}; choose among {', '.join(self.units)}")
        return self.units[field]

    def _vector_of(self, name: str) -> tuple[str | None, int | None]:
        """The vector field that a name refers to, and which component; None: its length. None, None for other names."""
        if name.startswith("|") and name.endswith("|"):
            return name[1:-1], None
        if name not in self.units and name[-1:] in AXES and name[:-1] in self.units:
            return name[:-1], AXES.index(name[-1])
        return None, None

    def _size(self, level: int, box: int | np.integer[Any]) -> tuple[int, ...]:
        corners = self.levels[level].boxes[box]
        return tuple(int(n) for n in corners[3:] - corners[:3] + 1)

    def here(self, level: int) -> Array:
        """Return the numbers of those boxes of a level whose values this rank has."""
        return np.arange(len(self.levels[level].boxes))

    def total(self, values: Array) -> Array:
        """Return the sum of arrays over the ranks that share it, on all of them; it takes their memory. Collective."""
        if self.comm.size > 1:
            self.comm.Allreduce(MPI.IN_PLACE, values)
        return values

    def any(self, flags: Array) -> Array:
        """Return where any rank holds True, on all of them. Collective."""
        if self.comm.size > 1:
            self.comm.Allreduce(MPI.IN_PLACE, flags, MPI.LOR)
        return flags

    def covered(self, level: int, box: int) -> Array:
        """Return where a finer level covers the cells of a box, bool (nx, ny, nz)."""
        lower, upper = self.levels[level].boxes[box, :3], self.levels[level].boxes[box, 3:]
        out = np.zeros(upper - lower + 1, dtype=bool)
        if level + 1 == len(self.levels):
            return out
        finer = self.levels[level + 1]
        for corners in finer.boxes[finer.table.meeting((2 * lower).tolist(), (2 * upper + 1).tolist())]:
            first, last = np.maximum(corners[:3] // 2, lower) - lower, np.minimum(corners[3:] // 2, upper) - lower
            x, y, z = (slice(i, j + 1) for i, j in zip(first, last, strict=True))
            out[x, y, z] = True
        return out


class Component(Protocol):
    """A scalar on a hierarchy, such as a `Field`."""

    @property
    def unit(self) -> str: ...

    def array(self, level: int) -> np.ndarray: ...


class LiveFields(Composite):
    """Scalars, and vectors of three of them, on a hierarchy, shared by its ranks."""

    def __init__(self, hierarchy: Hierarchy, fields: Mapping[str, Sequence[Component]]) -> None:
        self.comm = hierarchy.comm
        self._hierarchy, self._fields = hierarchy, fields
        self.lower, self.upper = np.array(hierarchy.domain.lower), np.array(hierarchy.domain.upper)
        self.units = {name: parts[0].unit for name, parts in fields.items()}
        self.levels = [self._level(level) for level in range(hierarchy.levels)]

    @property
    def periodic(self) -> tuple[bool, bool, bool]:
        return self._hierarchy.domain.periodic

    @property
    def label(self) -> str:
        return "the field"

    def _level(self, level: int) -> Level:
        """Return a level; rows are those of its own boxes on each rank."""
        boxes = self._hierarchy.boxes(level).astype(np.int64)
        cells = cells_of(boxes)
        ends, first = np.cumsum(cells), self._hierarchy.local_boxes(level).start
        return Level(
            np.array(self._hierarchy.spacing(level)), boxes, ends - cells - (ends - cells)[first : first + 1].sum()
        )

    def is_vector(self, name: str) -> bool:
        return len(self._fields.get(name, ())) > 1

    def here(self, level: int) -> Array:
        return np.array(self._hierarchy.local_boxes(level), dtype=np.int64)

    def covered(self, level: int, box: int) -> Array:
        return self._hierarchy.native.covered(level, box).astype(bool)

    def _values(self, name: str, level: int, box: int | np.integer[Any]) -> Array:
        cells, start = self._size(level, box), int(self.levels[level].starts[box])
        flat = [
            part.array(level)[start : start + int(np.prod(cells))].reshape(cells, order="F")
            for part in self._fields[name]
        ]
        return np.stack(flat, axis=-1) if len(flat) > 1 else flat[0]

"""Cell values on a hierarchy; NumPy arrays share their memory."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from mpi4py import MPI
from numpy.typing import ArrayLike

from .. import _native
from ..errors import HierarchyError, InputError
from ..parallel import global_max
from .hierarchy import Hierarchy

Function = Callable[[np.ndarray, np.ndarray, np.ndarray], np.ndarray | float]


@dataclass(frozen=True)
class Patch:
    """The values of one field in one box of this rank."""

    level: int
    box: int  # its number among the level's boxes
    lower: tuple[int, int, int]  # inclusive global indices of its level
    upper: tuple[int, int, int]
    data: np.ndarray  # (nx, ny, nz), x fastest in memory; writable unless the field is locked
    hierarchy: Hierarchy

    def centres(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Cell centres in m as three arrays that broadcast to (nx, ny, nz)."""
        h = self.hierarchy.spacing(self.level)
        axes = [
            self.hierarchy.domain.lower[d] + (np.arange(self.lower[d], self.upper[d] + 1) + 0.5) * h[d]
            for d in range(3)
        ]
        return axes[0][:, None, None], axes[1][None, :, None], axes[2][None, None, :]

    @cached_property
    def covered(self) -> np.ndarray:
        """Where a finer level covers the cell, bool (nx, ny, nz)."""
        return self.hierarchy.native.covered(self.level, self.box).astype(bool)


class Field:
    """One number per cell, on every level of a hierarchy; starts at zero.

    Each rank holds the cells of its own boxes. Cells that a finer level covers hold the mean of their children in every
    field that the package returns, except the electric field of matched clouds.
    """

    def __init__(self, hierarchy: Hierarchy, unit: str = "") -> None:
        self._hold(_native.Field(hierarchy.native), hierarchy, unit)

    @classmethod
    def unset(cls, hierarchy: Hierarchy, unit: str = "") -> Field:
        """A field of whatever memory holds, for a caller that writes all of its cells."""
        out = cls.__new__(cls)
        out._hold(_native.Field(hierarchy.native, zero=False), hierarchy, unit)
        return out

    def _hold(self, native: _native.Field, hierarchy: Hierarchy, unit: str) -> None:
        self.native = native
        self.hierarchy = hierarchy
        self.unit = unit
        self.locked = False

    @property
    def comm(self) -> MPI.Comm:
        return self.hierarchy.comm

    @cached_property
    def patches(self) -> list[Patch]:
        """This rank's boxes, coarse to fine, in box order; their data share the field's memory."""
        out = []
        for level in range(self.hierarchy.levels):
            values, start = self.array(level), 0
            boxes = self.hierarchy.boxes(level)
            for box in self.hierarchy.local_boxes(level):
                lower, upper = boxes[box, :3], boxes[box, 3:]
                shape = tuple(int(n) for n in upper - lower + 1)
                size = shape[0] * shape[1] * shape[2]
                data = values[start : start + size].reshape(shape, order="F")
                corners = tuple(int(i) for i in lower), tuple(int(i) for i in upper)
                out.append(Patch(level, box, corners[0], corners[1], data, self.hierarchy))  # type: ignore[arg-type]
                start += size
        return out

    def array(self, level: int) -> np.ndarray:
        """This rank's cells of a level, 1-D: its boxes one after the other, x fastest in each; writable unless locked."""
        values = self.native.level(self.hierarchy._checked(level))
        if self.locked:
            values.flags.writeable = False
        return values

    def lock(self) -> None:
        """Hand out read-only arrays from now on: something else follows from these values. A copy can be written to."""
        self.locked = True
        vars(self).pop("patches", None)

    def fill(self, function: Function) -> Field:
        """Set every cell of every level to `function(x, y, z)` at its centre (m, broadcastable arrays); return self."""
        self._require_unlocked()
        for patch in self.patches:
            patch.data[...] = function(*patch.centres())
        return self

    def copy(self) -> Field:
        """A field with the same values and memory of its own."""
        out = Field.unset(self.hierarchy, self.unit)
        for level in range(self.hierarchy.levels):
            out.array(level)[:] = self.array(level)
        return out

    def average_down(self) -> Field:
        """Set covered cells to the mean of their children, fine to coarse; return self. Collective."""
        self._require_unlocked()
        self.native.average_down()
        return self

    def _require_unlocked(self) -> None:
        if self.locked:
            raise InputError(
                "the field is locked, because another one follows from its values; write to a copy() of it"
            )

    def integral(self, times: Field | None = None) -> float:
        """Volume integral over uncovered cells; with another field of the hierarchy, that of the product. Collective.

        Raises HierarchyError if the other field lives on another hierarchy.
        """
        if times is None:
            return self.native.integral()
        if times.hierarchy is not self.hierarchy:
            raise HierarchyError(
                "the fields of a product live on two hierarchies; carry one of them over to the other's"
            )
        return self.native.integral_with(times.native)

    def max_abs(self) -> float:
        """Largest magnitude over uncovered cells; nan if one of them is. Collective."""
        here = [np.abs(p.data).max(where=~p.covered, initial=0.0) for p in self.patches]
        return global_max(self.comm, np.max(here, initial=0.0))

    def sample(self, points: ArrayLike) -> np.ndarray:
        """Values at points (n, 3) in m, (n,) on every rank: trilinear in the finest cells there. Collective.

        All ranks pass the same points. Beside a coarse-fine face the cells that the finer level lacks take the coarser
        one's value; beyond a wall that of the wall cell is held. Points outside the domain give nan.
        """
        points = np.ascontiguousarray(points, dtype=np.float64).reshape(-1, 3)
        return self.native.sample(points)


class VectorField:
    """Three fields, the components along x, y and z, or a field of which they are made when they are first asked for.

    Raises HierarchyError if the components live on several hierarchies.
    """

    def __init__(self, x: Field, y: Field, z: Field) -> None:
        if not x.hierarchy is y.hierarchy is z.hierarchy:
            raise HierarchyError(
                "the components of a vector field live on several hierarchies; make all of them on one"
            )
        self.hierarchy, self.unit = x.hierarchy, x.unit
        self._deferred: _native.ElectricField | None = None
        self.components = x, y, z

    @classmethod
    def deferred(cls, native: _native.ElectricField, hierarchy: Hierarchy, unit: str) -> VectorField:
        """A field whose components the native module can write; it keeps those that were asked for, read-only."""
        out = cls.__new__(cls)
        out.hierarchy, out.unit = hierarchy, unit
        out._deferred = native
        return out

    @property
    def native(self) -> _native.ElectricField:
        """The field as native kernels read it; made anew from components, which may have been written to."""
        if self._deferred is not None:
            return self._deferred
        return _native.ElectricField(*(c.native for c in self.components))

    @cached_property
    def components(self) -> tuple[Field, Field, Field]:
        made = self.with_components().components
        for component in made:
            component.lock()  # kernels would not see what is written there
        return made

    @property
    def x(self) -> Field:
        return self.components[0]

    @property
    def y(self) -> Field:
        return self.components[1]

    @property
    def z(self) -> Field:
        return self.components[2]

    def with_components(self) -> VectorField:
        """The same field made of components, which this one does not keep if it is deferred."""
        if self._deferred is None:
            return self
        x, y, z = (Field.unset(self.hierarchy, self.unit) for _ in range(3))
        self._deferred.write(x.native, y.native, z.native)
        return VectorField(x, y, z)

    def integral_of_square(self) -> float:
        """Volume integral of the square over uncovered cells. Collective."""
        return self.native.integral_of_square()

    def sample(self, points: ArrayLike) -> np.ndarray:
        """Values at points (n, 3) in m, (n, 3) on every rank. Collective."""
        return np.stack([c.sample(points) for c in self.components], axis=1)

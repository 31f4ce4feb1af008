"""Cell values on a hierarchy; NumPy arrays share their memory."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np
from mpi4py import MPI
from numpy.typing import ArrayLike

from .. import _native
from ..errors import HierarchyError, InputError
from ..parallel import global_max, global_sum
from . import exports
from .domain import AXES
from .hierarchy import Hierarchy

if TYPE_CHECKING:
    import pyvista
    import xarray

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
        """The ranks that hold the field together."""
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

    def fill(self, function: Function | float) -> Field:
        """Set every cell to a number, or to `function(x, y, z)` at its centre (m, broadcastable arrays); return self."""
        self._require_unlocked()
        for patch in self.patches:
            patch.data[...] = function(*patch.centres()) if callable(function) else function
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
        return global_sum(self.comm, self.own_integral(times))

    def own_integral(self, times: Field | None = None) -> float:
        """Part of this rank's cells in `integral`."""
        if times is None:
            return self.native.own_integral()
        if times.hierarchy is not self.hierarchy:
            raise HierarchyError(
                "the fields of a product live on two hierarchies; carry one of them over to the other's"
            )
        return self.native.own_integral_with(times.native)

    def max_abs(self) -> float:
        """Largest magnitude over uncovered cells; nan if one of them is. Collective."""
        here = [np.abs(p.data).max(where=~p.covered, initial=0.0) for p in self.patches]
        return global_max(self.comm, np.max(here, initial=0.0))

    def min(self) -> float:
        """Smallest value over uncovered cells; nan if one of them is. Collective."""
        return -(-self).max()

    def max(self) -> float:
        """Largest value over uncovered cells; nan if one of them is. Collective."""
        here = [p.data.max(where=~p.covered, initial=-np.inf) for p in self.patches]
        return global_max(self.comm, np.max(here, initial=-np.inf))

    def sum(self) -> float:
        """Sum over uncovered cells. Collective."""
        return global_sum(self.comm, float(sum(p.data.sum(where=~p.covered) for p in self.patches)))

    def norm(self, kind: str = "l2") -> float:
        """Return the norm over uncovered cells: "max", or "l1" or "l2" weighted by volume. Collective; InputError."""
        if kind == "max":
            return self.max_abs()
        if kind == "l1":
            return abs(self).integral()
        if kind == "l2":
            return float(np.sqrt(self.integral(self)))
        raise InputError(f"{kind!r} is no norm; use l1, l2 or max")

    # ---- for other packages, which are to be installed; InputError if they are not ----

    def _gathered(self) -> exports.Gathered:
        """The field with the boxes of all ranks. Collective."""
        mine = [(p.level, p.box, exports.Part(p.level, p.lower, np.array(p.data), p.covered)) for p in self.patches]
        everyones = [one for rank in self.comm.allgather(mine) for one in rank]
        parts = [part for _, _, part in sorted(everyones, key=lambda one: one[:2])]
        return exports.Gathered(self.hierarchy, self.unit, parts)

    def to_xarray(self, level: int = 0, name: str = "field") -> xarray.DataArray:
        """Return a level as an array (x, y, z) with coordinates in m, whole on every rank; nan where it has no cells.

        Collective. Raises HierarchyError if there is no such level.
        """
        return exports.to_xarray(self._gathered(), level, name)

    def to_yt(self, name: str = "field") -> Any:
        """Return the field as a data set of yt, whole on every rank, for its slices and projections. Collective."""
        return exports.to_yt({name: self._gathered()})

    def to_pyvista(self, name: str = "field") -> pyvista.MultiBlock:
        """Return the field as one PyVista image per box, covered cells hidden, whole on every rank. Collective."""
        return exports.to_pyvista({name: self._gathered()})

    # ---- arithmetic, cell by cell; with numbers, and with fields of the same hierarchy ----

    def _combined(self, other: Field | float, operation: Callable[..., np.ndarray], unit: str) -> Field:
        if isinstance(other, Field) and other.hierarchy is not self.hierarchy:
            raise HierarchyError("the two fields live on two hierarchies; carry one of them over to the other's")
        out = Field.unset(self.hierarchy, unit)
        for level in range(self.hierarchy.levels):
            second = other.array(level) if isinstance(other, Field) else other
            operation(self.array(level), second, out=out.array(level))
        return out

    def _same_unit(self, other: Field | float) -> str:
        if isinstance(other, Field) and other.unit != self.unit and self.unit and other.unit:
            raise InputError(f"a field in {self.unit} and one in {other.unit} cannot be added; convert one of them")
        return self.unit or (other.unit if isinstance(other, Field) else "")

    def __add__(self, other: Field | float) -> Field:
        return self._combined(other, np.add, self._same_unit(other)) if _fits(other) else NotImplemented

    def __sub__(self, other: Field | float) -> Field:
        return self._combined(other, np.subtract, self._same_unit(other)) if _fits(other) else NotImplemented

    def __mul__(self, other: Field | float) -> Field:
        unit = " ".join(filter(None, (self.unit, getattr(other, "unit", ""))))
        return self._combined(other, np.multiply, unit) if _fits(other) else NotImplemented

    def __truediv__(self, other: Field | float) -> Field:
        below = getattr(other, "unit", "")
        unit = f"{self.unit}/({below})" if below and below != self.unit else "" if below else self.unit
        return self._combined(other, np.divide, unit) if _fits(other) else NotImplemented

    __radd__, __rmul__ = __add__, __mul__

    def __rsub__(self, other: float) -> Field:
        return -self + other

    def __neg__(self) -> Field:
        return -1.0 * self

    def __abs__(self) -> Field:
        return self._combined(0.0, lambda values, _, out: np.abs(values, out=out), self.unit)

    def _root(self, unit: str) -> Field:
        return self._combined(0.0, lambda values, _, out: np.sqrt(values, out=out), unit)

    def __repr__(self) -> str:
        cells = " + ".join(str(self.hierarchy.cells(level)) for level in range(self.hierarchy.levels))
        here = [
            (p.data.min(where=~p.covered, initial=np.inf), p.data.max(where=~p.covered, initial=-np.inf))
            for p in self.patches
        ]
        low, high = np.min([one[0] for one in here], initial=np.inf), np.max([one[1] for one in here], initial=-np.inf)
        range_ = (
            f"{low:.4g} to {high:.4g}{' ' * bool(self.unit)}{self.unit}" if low <= high else "none of its cells here"
        )
        where = f" on rank {self.comm.rank}" if self.comm.size > 1 else ""
        return f"Field({range_}{where}; {cells} cells on {self.hierarchy.levels} levels)"

    def sample(self, points: ArrayLike) -> np.ndarray:
        """Values at points (n, 3) in m, (n,) on every rank: trilinear in the finest cells there. Collective.

        All ranks pass the same points. Beside a coarse-fine face the cells that the finer level lacks take the coarser
        one's value; beyond a wall that of the wall cell is held. Points outside the domain give nan.
        """
        points = np.ascontiguousarray(points, dtype=np.float64).reshape(-1, 3)
        return self.native.sample(points)


def _fits(other: object) -> bool:
    """Whether a field can be added to it, or multiplied by it."""
    return isinstance(other, Field | int | float | np.integer | np.floating)


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
        """The component along x."""
        return self.components[0]

    @property
    def y(self) -> Field:
        """The component along y."""
        return self.components[1]

    @property
    def z(self) -> Field:
        """The component along z."""
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
        return global_sum(self.hierarchy.comm, self.own_integral_of_square())

    def own_integral_of_square(self) -> float:
        """Part of this rank's cells in `integral_of_square`."""
        return self.native.own_integral_of_square()

    def magnitude(self) -> Field:
        """Its length in each cell."""
        x, y, z = self.components
        return (x * x + y * y + z * z)._root(self.unit)

    def to_yt(self, name: str = "E") -> Any:
        """Return the components, as `name`_x and so on, as a data set of yt, whole on every rank. Collective."""
        return exports.to_yt(
            {f"{name}_{axis}": one._gathered() for axis, one in zip(AXES, self.components, strict=True)}
        )

    def to_pyvista(self, name: str = "E") -> pyvista.MultiBlock:
        """Return the components as one PyVista image per box, whole on every rank. Collective."""
        return exports.to_pyvista(
            {f"{name}_{axis}": one._gathered() for axis, one in zip(AXES, self.components, strict=True)}
        )

    def sample(self, points: ArrayLike) -> np.ndarray:
        """Values at points (n, 3) in m, (n, 3) on every rank. Collective."""
        return np.stack([c.sample(points) for c in self.components], axis=1)

"""Cell values on a hierarchy; NumPy arrays share their memory."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, Any, Literal

import numpy as np
from numpy.typing import ArrayLike

from .. import _native, tables
from ..errors import HierarchyError, InputError
from ..parallel import global_max, global_sum
from . import exports
from .domain import AXES
from .field_views import FieldViews, points_of
from .hierarchy import Hierarchy
from .patch import Patch
from .remap import Bounds, remap
from .sampling import Request, fitted_values

if TYPE_CHECKING:
    import pyvista

Holds = Literal["points", "means"]
KAPPA = {"points": 0.0, "means": 1 / 24}  # what a cell holds less the value at its centre, over h² Δ
Function = Callable[[np.ndarray, np.ndarray, np.ndarray], np.ndarray | float]


class Field(FieldViews):
    """One number per cell, on every level of a hierarchy; starts at zero.

    Each rank holds the cells of its own boxes. Cells that a finer level covers hold the mean of their children in every
    field that the package returns, except the electric field of matched clouds, and values at centres made of means.

    `holds` says what a number stands for: "points", the value at the cell's centre, as `fill` sets it, or "means", the mean
    over the cell. They differ by h²/24 Δ, which matters in fourth order; `as_means` and `as_points` lead from one to the
    other.
    """

    holds: Holds = "points"

    def __init__(self, hierarchy: Hierarchy, unit: str = "") -> None:
        if not isinstance(hierarchy, Hierarchy):
            raise InputError(f"a field was given {hierarchy!r:.60} to live on; give an amrpic.Hierarchy")
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
        """Set every cell to a number, or to `function(x, y, z)` at its centre (m, broadcastable arrays); return self.

        Raises InputError for what is neither, and for a function that gives something else than a number for each cell.
        """
        self._require_unlocked()
        for patch in self.patches:
            values = function(*patch.centres()) if callable(function) else function
            try:
                patch.data[...] = values
            except (TypeError, ValueError):
                raise InputError(_no_values(function, values, patch)) from None
        return self

    @property
    def parts(self) -> tuple[Field, ...]:
        """The field itself, as what a vector field would have as components."""
        return (self,)

    def copy(self) -> Field:
        """A field with the same values and memory of its own."""
        out = Field.unset(self.hierarchy, self.unit)
        out.holds = self.holds
        for level in range(self.hierarchy.levels):
            out.array(level)[:] = self.array(level)
        return out

    def as_means(self) -> Field:
        """Return the means over cells of a field of points, to fourth order; itself if it holds means. Collective.

        Values in covered cells are not read; the means of the children stand there. Where a level ends or a finer one begins
        single cells have an error of third order.
        """
        return self if self.holds == "means" else self._converted("means")

    def as_points(self) -> Field:
        """Return the values at centres of a field of means, to fourth order; itself if it holds points. Collective.

        Those at the centres of covered cells follow from the means there, which are to be those of the children.
        """
        return self if self.holds == "points" else self._converted("points")

    def _converted(self, holds: Holds) -> Field:
        out = Field.unset(self.hierarchy, self.unit)
        out.holds = holds
        means = _native.Means(self.hierarchy.native)
        (means.to_means if holds == "means" else means.to_points)(self.native, out.native)
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

    def own_energy_integral(self, times: Field, compensation: Compensation) -> float:
        """Part of this rank's cells in the integral of the field times `times` + κ field."""
        return self.native.own_integral_with_itself(times.native, list(compensation.strength))

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
        largest = [np.abs(p.data).max(where=~p.covered, initial=0.0) for p in self.patches]
        return global_max(self.comm, np.max(largest, initial=0.0))

    def min(self) -> float:
        """Smallest value over uncovered cells; nan if one of them is. Collective."""
        return -(-self).max()

    def max(self) -> float:
        """Largest value over uncovered cells; nan if one of them is. Collective."""
        largest = [p.data.max(where=~p.covered, initial=-np.inf) for p in self.patches]
        return global_max(self.comm, np.max(largest, initial=-np.inf))

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

    # ---- arithmetic, cell by cell; with numbers, and with fields of the same hierarchy ----

    def _combined(self, other: Field | float, operation: Callable[..., np.ndarray], unit: str) -> Field:
        if isinstance(other, Field) and other.hierarchy is not self.hierarchy:
            raise HierarchyError("the two fields live on two hierarchies; carry one of them over to the other's")
        if isinstance(other, Field) and other.holds != self.holds:
            raise InputError(
                f"one field holds {self.holds}, the other {other.holds}; convert one of them, as_{self.holds}()"
            )
        out = Field.unset(self.hierarchy, unit)
        out.holds = self.holds
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

    def remap(self, hierarchy: Hierarchy, order: int = 2, bounds: Bounds = None) -> Field:
        """Return the field, as means over cells, on another mesh of the same cuboid, whose base may be another. Collective.

        In each cell a polynomial of `order` 1 to 4 is fitted by least squares to the means of the cells around; it has the
        cell's own mean, and is averaged over what cells of the two meshes have in common. So the integral is kept, and
        smooth fields have an error of h^(order + 1), up to walls; where too few cells lie across the domain the order is
        lower. Cells that both have are copied, covered ones are the means of their children.

        With `bounds` no value is outside of (least, most), or, "neighbours", of what the cells of the source have that it is
        made of, and those that touch these: parts of a cell are clipped, and share what was cut off by the room they have.

        Raises HierarchyError for another cuboid or number of ranks, InputError for orders and bounds that make no sense, and
        for values outside of the bounds.
        """
        out = Field(hierarchy, self.unit)
        out.holds = self.holds
        remap(self, out, order, bounds)
        return out.average_down()

    def sample(self, points: ArrayLike, order: int = 1, what: str = "value", kappa: float | None = None) -> np.ndarray:
        """Values at points (n, 3) in m, (n,) on every rank; what="gradient": (n, 3), per m. Collective.

        All ranks pass the same points. Those beyond periodic faces have the values of their images, others outside the domain
        give nan.

        At order 1 values are trilinear in the finest cells there. Beside a coarse-fine face the cells that the finer level
        lacks take the coarser one's value; beyond a wall that of the wall cell is held.

        Orders 2 to 4, and gradients of any order, fit a polynomial of that order by least squares to the uncovered cells of all
        levels around each point, up to walls and across periodic faces: errors of values are of order + 1, of gradients of
        order. What a cell holds stands for the value at its centre plus `kappa` h² times the sum of second derivatives: by
        default 0 for fields that hold points, 1/24 for those that hold means; 1/30 for a potential solved
        from charge that was deposited by clouds-in-cells, -1/120 from one of cell means.

        Raises InputError for what are no points, orders, quantities or kappa, and for points with too few cells around.
        """
        at = points_of(points)
        request = Request(order, what, KAPPA[self.holds] if kappa is None else kappa)
        if order == 1 and what == "value":
            if kappa is not None:
                raise InputError(
                    "kappa has no effect on trilinear values; leave it out, or choose an order from 2 to 4"
                )
            return self.native.sample(at)
        return fitted_values(self._composite, "field", at, request)


def _no_values(function: object, values: object, patch: Patch) -> str:
    """Return why a field cannot be filled."""
    if not callable(function):
        return f"a field cannot be filled with {function!r:.60}; give a number, or a function of x, y and z in m"
    text = f"an array of shape {values.shape}" if isinstance(values, np.ndarray) else f"{values!r:.60}"
    return (
        f"the function gives {text} for a box of {patch.data.shape} cells; let it compute with the arrays it is given"
    )


def _fits(other: object) -> bool:
    """Whether a field can be added to it, or multiplied by it."""
    return isinstance(other, Field | int | float | np.integer | np.floating)


@dataclass(frozen=True)
class Compensation:
    """What particles feel beside a field, to make up for what their clouds smooth: E_d − κ s_d⁻² ∂ρ/∂x_d."""

    density: Field  # ρ, C/m³
    strength: tuple[float, ...]  # κ of each level, V m³/C
    stretch: tuple[float, float, float] = (1.0, 1.0, 1.0)  # s of the equation

    @property
    def factors(self) -> list[tuple[float, float, float]]:
        """Per level and axis, of the density in the cell below less that in the cell above."""
        widths = [self.density.hierarchy.spacing(level) for level in range(self.density.hierarchy.levels)]
        return [
            tuple((kappa / np.square(self.stretch) / (2 * width)).tolist())
            for kappa, width in zip(self.strength, widths, strict=True)
        ]


class VectorField:
    """Three fields, the components along x, y and z, or a field of which they are made when they are first asked for.

    Raises HierarchyError if the components live on several hierarchies.
    """

    compensation: Compensation | None = None  # what gather and push add; components are without it

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
        native = _native.ElectricField(*(c.native for c in self.components))
        if self.compensation is not None:
            native.compensate(self.compensation.density.native, self.compensation.factors)
        return native

    def compensate(self, compensation: Compensation) -> None:
        """Let gather and push add this; the density must not change from now on, so it is locked."""
        compensation.density.lock()
        self.compensation = compensation
        if self._deferred is not None:
            self._deferred.compensate(compensation.density.native, compensation.factors)

    @cached_property
    def components(self) -> tuple[Field, Field, Field]:
        components = self.with_components().components
        for component in components:
            component.lock()  # kernels would not see what is written there
        return components

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

    def remap(self, hierarchy: Hierarchy, order: int = 2, bounds: Bounds = None) -> VectorField:
        """Return the field on another mesh, each component by itself: see `Field.remap`. Collective."""
        x, y, z = (component.remap(hierarchy, order, bounds) for component in self.components)
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
            {f"{name}_{axis}": component._gathered() for axis, component in zip(AXES, self.components, strict=True)}
        )

    def to_pyvista(self, name: str = "E") -> pyvista.MultiBlock:
        """Return the components as one PyVista image per box, whole on every rank. Collective."""
        return exports.to_pyvista(
            {f"{name}_{axis}": component._gathered() for axis, component in zip(AXES, self.components, strict=True)}
        )

    def __repr__(self) -> str:
        return f"VectorField(in {self.unit or 'no unit'}, on {self.hierarchy.levels} levels; components x, y, z)"

    def _repr_html_(self) -> str:
        rows = []
        for axis, component in zip(AXES, self.components, strict=True):
            low, high = component._range_here()
            rows.append([axis, f"{low:.4g}", f"{high:.4g}"])
        caption = f"VectorField{' in ' * bool(self.unit)}{self.unit}{self.x._on_rank}"
        return tables.html(("component", "least", "largest"), rows, caption)

    @property
    def parts(self) -> tuple[Field, ...]:
        """Its components."""
        return self.components

    def sample(self, points: ArrayLike, order: int = 1, what: str = "value", kappa: float | None = None) -> np.ndarray:
        """Values at points (n, 3) in m, (n, 3) on every rank; what="gradient": (n, 3, 3), that of each component. Collective.

        As `Field.sample`.
        """
        return np.stack([c.sample(points, order, what, kappa) for c in self.components], axis=1)

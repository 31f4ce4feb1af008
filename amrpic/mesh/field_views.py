"""How a field is looked at: planes, lines and pictures of it, and what other packages make of it."""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike

from .. import tables
from ..errors import InputError
from ..mpi import MPI
from ..units import quantity
from . import exports
from .composite import LiveFields
from .domain import AXES
from .hierarchy import Hierarchy
from .patch import Patch
from .periods import wrapped_along
from .raster import Line, Raster, line_values, slice_through

if TYPE_CHECKING:
    import pyvista
    import xarray

    from .pictures import Picture


@dataclass(frozen=True)
class Profile:
    """The values of a field along a straight line."""

    points: np.ndarray  # (n, 3) m
    distance: np.ndarray  # (n,) m, from the start
    values: np.ndarray  # (n,), of the finest cells there
    unit: str

    def plot(self) -> Picture:
        """Return the values by the distance, as a figure of matplotlib that a notebook shows. Serial."""
        from .pictures import curve

        start, end = (", ".join(quantity(x, "m", np.abs(self.points).max()) for x in self.points[k]) for k in (0, -1))
        return curve(self.distance, self.values, "value", self.unit, f"from ({start}) to ({end})")


class FieldViews(ABC):
    """What a field offers to look at it. Planes, lines and pictures show the finest cell at each place, as it is."""

    hierarchy: Hierarchy
    unit: str

    @property
    def comm(self) -> MPI.Comm:
        """The ranks that hold the field together."""
        return self.hierarchy.comm

    @property
    @abstractmethod
    def patches(self) -> list[Patch]:
        """This rank's boxes with their values, coarse to fine."""

    @abstractmethod
    def array(self, level: int) -> np.ndarray:
        """Return this rank's values of a level, 1-D, its boxes one after the other."""

    def slice(self, axis: int | str = "z", place: float | None = None, level: int | None = None) -> Raster:
        """Return the values in the plane normal to an axis at a place (m), by default through the middle of the domain.

        Pixels are those of the finest level, at most 1600 along a side; each shows the finest cell at its centre, or that of
        one `level`, nan where that has no cells. A plane between two cells shows the upper ones. Collective; raises InputError
        on all ranks for a place outside the domain, except along periodic axes, where its image is shown.
        """
        normal, domain = axis_number(axis), self.hierarchy.domain
        lower, upper = domain.lower[normal], domain.upper[normal]
        place = (lower + upper) / 2 if place is None else place
        place = wrapped_along(normal, place, domain.lower, domain.upper, domain.periodic)  # type: ignore[arg-type]
        if not lower <= place <= upper:
            raise InputError(
                f"the plane at {AXES[normal]} = {place:g} m lies outside the domain, which reaches from {lower:g} to "
                f"{upper:g} m; choose a place inside"
            )
        level = None if level is None else self.hierarchy._checked(level)
        return slice_through(self._composite, "field", normal, place, level)

    def line(self, start: ArrayLike, end: ArrayLike, count: int | None = None) -> Profile:
        """Return the values on the straight line between two points (x, y, z) in m, by default two for each finest cell width.

        Points outside the domain take the value of the wall cell, those behind periodic faces that of their images. Collective;
        raises InputError on all ranks for ends that are no points, or one point.
        """
        first, last = points_of(start)[0], points_of(end)[0]
        length = float(np.linalg.norm(last - first))
        if not 0 < length < np.inf:
            raise InputError(
                f"the line from {first.tolist()} to {last.tolist()} has no direction; give two points in m"
            )
        if count is None:
            finest = self.hierarchy.spacing(self.hierarchy.levels - 1)
            count = int(np.clip(2 * length / finest.min(), 2, 20_000))
        line = Line(first, (last - first) / length, np.linspace(0.0, length, count))
        return Profile(line.points, line.along, line_values(self._composite, "field", line), self.unit)

    def plot(
        self,
        axis: int | str = "z",
        place: float | None = None,
        level: int | None = None,
        boxes: bool = True,
        scale: str = "auto",
        name: str = "field",
    ) -> Picture:
        """Return a picture of `slice`, a figure of matplotlib that a notebook shows; `savefig` writes it.

        With `boxes` those of each level that the plane cuts are outlined. `scale` of the colours is "linear", "symmetric" about
        zero or "log"; auto: linear. `name` is what labels call the field. Collective; the same on all ranks. Raises InputError.
        """
        from .pictures import plane  # matplotlib takes long to import

        raster = self.slice(axis, place, level)
        if not np.isfinite(raster.values).any():
            of = "the field" if level is None else f"level {level} of the field"
            raise InputError(f"{of} holds no finite value in this plane; choose another place or look at its cells")
        where = f"{AXES[raster.axis]} = {quantity(raster.position or 0.0, 'm', self._composite.reach)}"
        title = f"{name} at {where}" + ("" if level is None else f", level {level}")
        return plane(self._composite, raster, name, self.unit, title, scale, boxes, level)

    @property
    def _composite(self) -> LiveFields:
        return LiveFields(self.hierarchy, {"field": [self]})

    # ---- for other packages, which are to be installed; InputError if they are not ----

    def _gathered(self) -> exports.Gathered:
        """The field with the boxes of all ranks. Collective."""
        own_parts = [
            (p.level, p.box, exports.ExportedPart(p.level, p.lower, np.array(p.data), p.covered)) for p in self.patches
        ]
        everyones = [exported for rank in self.comm.allgather(own_parts) for exported in rank]
        parts = [part for _, _, part in sorted(everyones, key=lambda exported: exported[:2])]
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

    # ---- as text ----

    def _range_here(self, level: int | None = None) -> tuple[float, float]:
        """Least and largest value of this rank's uncovered cells, of one level or all; inf and -inf without any."""
        patches = [p for p in self.patches if level in (None, p.level)]
        low = [p.data.min(where=~p.covered, initial=np.inf) for p in patches]
        high = [p.data.max(where=~p.covered, initial=-np.inf) for p in patches]
        return float(np.min(low, initial=np.inf)), float(np.max(high, initial=-np.inf))

    @property
    def _on_rank(self) -> str:
        return f" on rank {self.comm.rank}" if self.comm.size > 1 else ""

    def __repr__(self) -> str:
        cells = " + ".join(str(self.hierarchy.cells(level)) for level in range(self.hierarchy.levels))
        low, high = self._range_here()
        range_ = (
            f"{low:.4g} to {high:.4g}{' ' * bool(self.unit)}{self.unit}" if low <= high else "none of its cells here"
        )
        return f"Field({range_}{self._on_rank}; {cells} cells on {self.hierarchy.levels} levels)"

    def _repr_html_(self) -> str:
        rows = []
        for level in range(self.hierarchy.levels):
            low, high = self._range_here(level)
            values = [f"{low:.4g}", f"{high:.4g}"] if low <= high else ["none", "none"]
            rows.append([level, self.hierarchy.cells(level), *values])
        caption = (
            f"Field{' in ' * bool(self.unit)}{self.unit}; least and largest value of uncovered cells{self._on_rank}"
        )
        return tables.html(("level", "cells", "least", "largest"), rows, caption)


def axis_number(axis: int | str) -> int:
    """Return 0, 1 or 2 for an axis given so, or as "x", "y" or "z". Raises InputError."""
    for number, name in enumerate(AXES):
        if isinstance(axis, str | int | np.integer) and axis in (number, name):
            return number
    raise InputError(f"{axis!r} is no axis; use one of {', '.join(AXES)}")


def points_of(values: ArrayLike) -> np.ndarray:
    """Return points as an array (n, 3) in m; a single one may be given as (3,). Raises InputError."""
    try:
        points = np.array(values, dtype=np.float64)
    except (TypeError, ValueError):
        raise InputError(f"{values!r:.60} are no points; give an array of (x, y, z) in m") from None
    if points.shape == (3,):
        return points[None]
    if points.ndim == 2 and points.shape[1] == 3:
        return points
    if points.size == 0:
        return np.empty((0, 3))
    raise InputError(f"points have shape {points.shape}; give an array of (x, y, z) in m, of shape (n, 3)")

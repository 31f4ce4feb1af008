"""What pictures of a dump show: slices, projections and profiles along a line, as numbers that the ranks make together."""

from __future__ import annotations

import json
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass, fields, replace
from typing import Any

from numpy.typing import NDArray

from ..errors import InputError
from ..io.field_reader import Dump
from ..mesh.domain import AXES
from ..mesh.periods import wrapped_along
from ..mesh.raster import ChargeSpread, Line, Raster, line_through, line_values, projection, slice_through
from ..mesh.sampling import Request, fitted_values

Array = NDArray[Any]


@dataclass(frozen=True)
class View:
    """What a picture shows of a dump."""

    quantity: str  # a field of the dump, or "|E|", "Ex", "Ey", "Ez"; profiles may be of several, with blanks between
    kind: str = "slice"  # in a plane; or "projection": the integral along the axis; or "line": the profile along it
    axis: int | None = None  # normal of slices, direction of the rest; None: z, and lines follow the charge
    position: float | None = None  # of a slice along the axis, m; None: through the middle of the charge
    level: int | None = None  # None: everywhere the finest cells
    scale: str = "auto"  # or one of SCALES
    boxes: bool = True  # whether they are outlined

    @property
    def normal(self) -> int:
        return AXES.index("z") if self.axis is None else self.axis

    @property
    def name(self) -> str:
        """A name for its file."""
        axis, quantity = AXES[self.normal], self.quantity.strip("|").replace(" ", "_")
        along = "" if self.axis is None else f"_along_{axis}"
        names = {
            "slice": f"{quantity}_{axis}",
            "projection": f"{quantity}_along_{axis}",
            "line": f"{quantity}_line{along}",
        }
        return names[self.kind] + ("" if self.level is None else f"_level{self.level}")


OPTIONS = {  # of each kind of picture
    "slice": ("axis", "position", "level", "scale", "boxes"),
    "projection": ("axis", "level", "scale", "boxes"),
    "line": ("axis", "level"),
}
OVERVIEW = (View("phi"), View("|E|"), View("rho", "projection"), View("phi E rho", "line"))
WITH_ELECTRODES = (*OVERVIEW, View("phi", axis=1))

OF_POINTS = (View("material", axis=1), View("damage", axis=1), View("pressure", axis=1), View("mises", axis=1))


def of_points(dump: Dump) -> bool:
    """Return whether a dump has means over elements of material points, and no charge."""
    return "filled" in dump.units


def overview_of(dump: Dump) -> tuple[View, ...]:
    """Return the views that show a dump if no others are asked for."""
    if of_points(dump):
        return OF_POINTS
    return WITH_ELECTRODES if json.loads(dump.scene_text).get("electrodes") else OVERVIEW


def kinds_of(dump: Dump, view: View) -> list[str]:
    """Return what the values of a view are the numbers of, from 0 on: the materials of points; nothing if they are values."""
    if not of_points(dump) or (view.quantity, view.kind, view.scale) != ("material", "slice", "auto"):
        return []
    return list(json.loads(dump.scene_text)["materials"])


def density_of(dump: Dump) -> str:
    """Return the name of the density in a dump, through the middle of which views go."""
    return "filled" if of_points(dump) else "rho"


def with_options(views: Sequence[View], **options: Any) -> list[View]:
    """Return the views with those of the options that apply to them. Raises InputError for one that applies to none."""
    for name in options:
        if not any(name in OPTIONS[view.kind] for view in views):
            raise _not_an_option(name, views[0])
    return [
        replace(view, **{name: value for name, value in options.items() if name in OPTIONS[view.kind]})
        for view in views
    ]


def require(dump: Dump, view: View) -> None:
    """Raise InputError if a dump does not hold what a view shall show, or has no such view."""
    for name in view.quantity.split():
        dump.unit(name)
    _require_level(dump, view.level)
    for option in fields(View)[2:]:
        if option.name not in OPTIONS[view.kind] and getattr(view, option.name) != option.default:
            raise _not_an_option(option.name, view)


def numbers(dump: Dump, spread: ChargeSpread, view: View) -> Raster | list[Array]:
    """Return what a view shows: a raster, or a profile for each quantity. Collective over the ranks that share the dump."""
    if view.kind == "line":
        line = line_through(dump, spread, view.axis)
        return [_profile(dump, name, line, view.level) for name in view.quantity.split()]
    if view.kind == "projection":
        return projection(dump, view.quantity, view.normal, view.level)
    return slice_through(dump, view.quantity, view.normal, _position(dump, spread, view), view.level)


def _profile(dump: Dump, name: str, line: Line, level: int | None) -> Array:
    """Return a field along a line by fits of order 3, or lower where too few cells lie across the domain. Collective."""
    for order in (3, 2, 1):
        with suppress(InputError):
            return fitted_values(dump, name, line.points, Request(order, level=level))
    return line_values(dump, name, line, level)


def _not_an_option(name: str, view: View) -> InputError:
    return InputError(f"{name} has no effect on a {view.kind}; leave it out, or choose another kind of picture")


def _require_level(dump: Dump, level: int | None) -> None:
    if level is not None and not 0 <= level < len(dump.levels):
        raise InputError(f"level {level} does not exist in {dump.path}; it has levels 0 to {len(dump.levels) - 1}")


def _position(dump: Dump, spread: ChargeSpread, view: View) -> float:
    """Return where a slice is along its axis, m. Raises InputError if that is outside the domain."""
    axis = view.normal
    position = float(spread.centre[axis]) if view.position is None else view.position
    position = wrapped_along(axis, position, dump.lower, dump.upper, dump.periodic)
    lower, upper = dump.lower[axis], dump.upper[axis]
    if not lower <= position <= upper:
        raise InputError(
            f"position {position:g} m lies outside the domain of {dump.path}, {lower:g} to {upper:g} m along {AXES[axis]}; "
            "choose one inside"
        )
    return position

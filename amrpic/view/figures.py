"""Figures of what pictures show, with the boxes drawn. Serial: for one rank."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.figure import Figure
from numpy.typing import NDArray

from ..errors import InputError, OutputError
from ..io.atomic_files import publish, temporary
from ..io.field_reader import Dump
from ..io.writer_ranks import one_line
from ..mesh.domain import AXES
from ..mesh.pictures import draw_curve, plane, png
from ..mesh.raster import ChargeSpread, Line, Raster, line_through
from ..units import prefix_of, quantity
from .metal_plots import metal_in
from .views import View, kinds_of, of_points

Array = NDArray[Any]

SYMBOLS = {"phi": "φ", "rho": "ρ"}
INTEGRALS = {"C/m^3": "C/m^2", "V/m": "V"}  # units of integrals along a line
LINES = {"phi": "C0", "E": "C3", "rho": "C2"}  # colours of profiles
ROUNDING = 1e-12  # of the mean charge per area


def figure(dump: Dump, spread: ChargeSpread, view: View, values: Raster | list[Array]) -> Figure:
    """Return the picture of what a view shows. Raises InputError if that is nothing."""
    if isinstance(values, list):
        line = line_through(dump, spread, view.axis)
        return profiles(dump, line, dict(zip(view.quantity.split(), values, strict=True)), view.level)
    return _projection(dump, spread, view, values) if view.kind == "projection" else _slice(dump, view, values)


def _slice(dump: Dump, view: View, raster: Raster) -> Figure:
    """Return the picture of a field in a plane."""
    axis, position = raster.axis, raster.position
    assert position is not None
    if np.isnan(raster.values).all():
        raise InputError(
            f"level {view.level} of {dump.path} has no cells at {AXES[axis]} = {position:g} m; choose another position"
        )
    symbol = SYMBOLS.get(view.quantity, view.quantity)
    title = f"{symbol} at {AXES[axis]} = {quantity(position, 'm', dump.reach)}"
    return _plane(dump, raster, symbol, dump.unit(view.quantity), view, title)


def _projection(dump: Dump, spread: ChargeSpread, view: View, raster: Raster) -> Figure:
    """Return the picture of the integral of a field along an axis."""
    axis = raster.axis
    symbol = f"∫{SYMBOLS.get(view.quantity, view.quantity)} d{AXES[axis]}"
    unit = INTEGRALS.get(dump.unit(view.quantity), f"{dump.unit(view.quantity)} m")
    if view.quantity != "rho":
        return _plane(dump, raster, symbol, unit, view, symbol)
    # Opposite charges that cancel along the line of sight leave rounding, which is not to be shown.
    mean = spread.charge / float(np.prod(raster.upper - raster.lower))
    values = np.where(np.abs(raster.values) <= ROUNDING * mean, 0.0, raster.values)
    view = replace(view, scale="log") if view.scale == "auto" else view
    if np.nanmax(values) <= 0 > np.nanmin(values):
        values, symbol = -values, f"−{symbol}"
    return _plane(dump, replace(raster, values=values), symbol, unit, view, f"charge per area along {AXES[axis]}")


def _plane(dump: Dump, raster: Raster, symbol: str, unit: str, view: View, title: str) -> Figure:
    level = "" if view.level is None else f", level {view.level}"
    title = f"{title}{level}, {_when(dump)}"
    metal, kinds = metal_in(dump, raster), kinds_of(dump, view)
    return plane(dump, raster, symbol, unit, title, view.scale, view.boxes, view.level, kinds, metal)


def _when(dump: Dump) -> str:
    when = f"{100 * dump.time:.4g} % of the load" if of_points(dump) else f"t = {quantity(dump.time, 's')}"
    return f"step {dump.step}, {when}"


def profiles(dump: Dump, line: Line, curves: Mapping[str, Array], level: int | None = None) -> Figure:
    """Return the profiles of fields along a line, given by the values of each; of a vector, what points along it."""
    length, length_prefix = prefix_of(float(np.abs(line.along).max()))
    figure = Figure(figsize=(8, 2.5 * len(curves) if len(curves) > 1 else 3.6), layout="constrained")
    panels = figure.subplots(len(curves), 1, sharex=True, squeeze=False)[:, 0]
    for panel, (name, values) in zip(panels, curves.items(), strict=True):
        symbol = SYMBOLS.get(name, name)
        if values.ndim > 1:
            values, symbol = values @ line.direction, f"{symbol} along the line"
        if np.isnan(values).all():
            raise InputError(f"the line meets no cells of level {level} of {dump.path}; choose another axis or level")
        draw_curve(panel, line.along / length, values, symbol, dump.unit(name), LINES.get(name, "C0"), steps=False)
    panels[-1].set_xlabel(f"distance from the centre of charge / {length_prefix}m")
    centre = ", ".join(quantity(x, "m", dump.reach) for x in line.centre)
    direction = ", ".join(f"{x:.3g}" for x in line.direction)
    of = "" if level is None else f", level {level}"
    panels[0].set_title(
        f"through ({centre}) along ({direction}){of}, {_when(dump)}".replace("-", "−"),
        fontsize="medium",
    )
    return figure


def save(figure: Figure, path: Path) -> Path:
    """Write a picture and clear it; return its path. Raises OutputError."""
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        temporary(path).write_bytes(png(figure))
        figure.clear()  # figures are cycles of references, which live on otherwise
        publish(path)
    except OSError as error:
        raise OutputError(f"cannot write picture {path}: {one_line(error)}; choose another output folder") from None
    return path

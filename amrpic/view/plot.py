"""Figures of what pictures show, with the boxes drawn. Serial: for one rank."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib import colormaps
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection
from matplotlib.colors import Colormap, LinearSegmentedColormap, LogNorm, Normalize, SymLogNorm
from matplotlib.figure import Figure
from numpy.typing import NDArray

from ..errors import InputError, OutputError
from ..io.atomic_files import publish, temporary
from ..io.field_reader import Dump
from ..io.writer_ranks import one_line
from ..mesh.domain import AXES
from ..units import prefix_of, quantity
from .raster import Line, Raster, Spread, cut_by, line_through
from .views import View

Array = NDArray[Any]
Colouring = tuple[Normalize, Colormap]

SYMBOLS = {"phi": "φ", "rho": "ρ"}
INTEGRALS = {"C/m^3": "C/m^2", "V/m": "V"}  # units of integrals along a line
LINES = {"phi": "C0", "E": "C3", "rho": "C2"}  # colours of profiles
LEVEL_COLOURS = ("#9a9a9a", "#ffffff", "#7fe3ff", "#ffb3de", "#b7f58f", "#ffe08a")  # light: they lie on dark data
ONE_SIGN = colormaps["inferno"]
BOTH_SIGNS = LinearSegmentedColormap.from_list("both signs", ["#b9e3ff", "#3d8bc9", "#0b0b14", "#c9553d", "#ffd0b9"])
DECADES = 5  # of the charge that its projection shows
ROUNDING = 1e-12  # of the mean charge per area
DPI = 150


def figure(dump: Dump, spread: Spread, view: View, shown: Raster | list[Array]) -> Figure:
    """Return the picture of what a view shows. Raises InputError if that is nothing."""
    if isinstance(shown, list):
        line = line_through(dump, spread, view.axis)
        return profiles(dump, line, dict(zip(view.quantity.split(), shown, strict=True)), view.level)
    return _projection(dump, spread, view, shown) if view.kind == "projection" else _slice(dump, view, shown)


def _slice(dump: Dump, view: View, raster: Raster) -> Figure:
    """Return the picture of a field in a plane."""
    axis, position = raster.axis, raster.position
    assert position is not None
    if np.isnan(raster.values).all():
        raise InputError(
            f"level {view.level} of {dump.path} has no cells at {AXES[axis]} = {position:g} m; choose another position"
        )
    symbol = SYMBOLS.get(view.quantity, view.quantity)
    title = f"{symbol} at {AXES[axis]} = {quantity(position, 'm', reach(dump))}"
    return _picture(dump, raster, symbol, dump.unit(view.quantity), view, title)


def _projection(dump: Dump, spread: Spread, view: View, raster: Raster) -> Figure:
    """Return the picture of the integral of a field along an axis."""
    axis = raster.axis
    symbol = f"∫{SYMBOLS.get(view.quantity, view.quantity)} d{AXES[axis]}"
    unit = INTEGRALS.get(dump.unit(view.quantity), f"{dump.unit(view.quantity)} m")
    if view.quantity != "rho":
        return _picture(dump, raster, symbol, unit, view, symbol)
    # Opposite charges that cancel along the line of sight leave rounding, which is not to be shown.
    mean = spread.charge / float(np.prod(raster.upper - raster.lower))
    values = np.where(np.abs(raster.values) <= ROUNDING * mean, 0.0, raster.values)
    view = replace(view, scale="log") if view.scale == "auto" else view
    if np.nanmax(values) <= 0 > np.nanmin(values):
        values, symbol = -values, f"−{symbol}"
    return _picture(dump, replace(raster, values=values), symbol, unit, view, f"charge per area along {AXES[axis]}")


def linear_colours(values: Array) -> Colouring:
    """Return norm and colour map: from zero for values of one sign, symmetric about zero for both."""
    low, high = min(float(np.nanmin(values)), 0.0), max(float(np.nanmax(values)), 0.0)
    most = max(-low, high) or 1.0
    if min(-low, high) > 0.02 * most:
        return symmetric_colours(values)
    return (Normalize(0, most), ONE_SIGN) if high >= -low else (Normalize(-most, 0), ONE_SIGN.reversed())


def symmetric_colours(values: Array) -> Colouring:
    """Return norm and colour map symmetric about zero, which is dark."""
    most = float(np.nanmax(np.abs(values))) or 1.0
    return Normalize(-most, most), BOTH_SIGNS


def logarithmic_colours(values: Array) -> Colouring:
    """Return norm and colour map of the largest decades; linear about zero below them if values have both signs."""
    most = float(np.nanmax(np.abs(values)))
    least = 10.0**-DECADES * most
    if most == 0:
        return linear_colours(values)
    if np.nanmin(values) < -least:
        return SymLogNorm(least, vmin=-most, vmax=most), BOTH_SIGNS
    return LogNorm(least, most, clip=True), ONE_SIGN


def _decades(least: float, most: float) -> list[float]:
    """Return zero and the decades on both sides of it, except those too close to it."""
    decades = 10.0 ** np.arange(np.ceil(np.log10(least)) + 1, np.floor(np.log10(most)) + 1)
    return [*-decades[::-1], 0.0, *decades]


SCALES: dict[str, Callable[[Array], Colouring]] = {
    "linear": linear_colours,
    "symmetric": symmetric_colours,
    "log": logarithmic_colours,
}


def _picture(dump: Dump, raster: Raster, symbol: str, unit: str, view: View, title: str) -> Figure:
    """Return a picture of a raster, of the part of it that holds values, with the boxes over it if they are wanted."""
    length, length_prefix = prefix_of(reach(dump))
    scale, prefix = prefix_of(float(np.nanmax(np.abs(raster.values))))
    norm, colour_map = SCALES.get(view.scale, linear_colours)(raster.values / scale)
    corners = np.stack([raster.lower, raster.upper], axis=1) / length
    extent = _extent(raster) / length
    figure, panel, bar = _canvas(extent)
    image = panel.imshow(
        (raster.values / scale).T,
        origin="lower",
        extent=(corners[0, 0], corners[0, 1], corners[1, 0], corners[1, 1]),
        norm=norm,
        cmap=colour_map,
        interpolation="nearest",
        aspect="equal" if _moderate(extent) else "auto",
    )
    panel.set_facecolor("#808080")  # where a level has no cells
    if view.boxes:
        _draw_boxes(panel, dump, raster, length, view.level)
    panel.set(
        xlabel=f"{AXES[raster.axes[0]]} / {length_prefix}m",
        ylabel=f"{AXES[raster.axes[1]]} / {length_prefix}m",
        xlim=extent[0],
        ylim=extent[1],
    )
    level = "" if view.level is None else f", level {view.level}"
    panel.set_title(f"{title}{level}, step {dump.step}, t = {quantity(dump.time, 's')}", fontsize="medium")
    colours = figure.colorbar(image, cax=bar, label=f"{symbol} / {_in(prefix, unit)}")
    if isinstance(norm, SymLogNorm):
        colours.set_ticks(_decades(norm.linthresh, float(norm.vmax or 1)))
    if view.boxes:
        # Outside: every place in the panel may hold a bunch. On dark ground, as the light lines need it.
        figure.legend(
            loc="lower center",
            ncols=8,
            fontsize="x-small",
            labelcolor="white",
            facecolor="black",
            framealpha=1,
        )
    return figure


def _extent(raster: Raster) -> Array:
    """Return the corners (2, 2) in m of what a raster shows, the first axis first."""
    held = np.isfinite(raster.values)
    out = []
    for d in range(2):
        pixels = np.flatnonzero(held.any(axis=1 - d))
        edges = np.array([pixels[0], pixels[-1] + 1]) / held.shape[d]
        out.append(raster.lower[d] + edges * (raster.upper[d] - raster.lower[d]))
    return np.array(out)


def _draw_boxes(panel: Axes, dump: Dump, raster: Raster, length: float, only: int | None) -> None:
    """Outline the boxes that a plane cuts, or all of them, in a light colour per level."""
    axes = list(raster.axes)
    for level, description in enumerate(dump.levels):
        if only not in (None, level):
            continue
        boxes = description.boxes
        if raster.position is not None:
            boxes = boxes[cut_by(dump, level, raster.axis, raster.position)]
        flat = np.unique(boxes[:, [*axes, axes[0] + 3, axes[1] + 3]], axis=0)
        lower = (dump.lower[axes] + flat[:, :2] * description.spacing[axes]) / length
        upper = (dump.lower[axes] + (flat[:, 2:] + 1) * description.spacing[axes]) / length
        x, y = (np.stack([lower[:, k], upper[:, k]]) for k in range(2))
        outlines = np.stack([x[[0, 1, 1, 0, 0]], y[[0, 0, 1, 1, 0]]], axis=-1).transpose(1, 0, 2)
        colour = LEVEL_COLOURS[level % len(LEVEL_COLOURS)]
        panel.add_collection(LineCollection(list(outlines), colors=colour, linewidths=0.5, alpha=0.7))
        panel.plot([], [], color=colour, label=f"level {level}")


def profiles(dump: Dump, line: Line, shown: Mapping[str, Array], level: int | None = None) -> Figure:
    """Return the profiles of fields along a line, given by `line_values` of each; of a vector, what points along it."""
    length, length_prefix = prefix_of(float(np.abs(line.along).max()))
    figure = Figure(figsize=(8, 2.5 * len(shown) if len(shown) > 1 else 3.6), layout="constrained")
    panels = figure.subplots(len(shown), 1, sharex=True, squeeze=False)[:, 0]
    for panel, (name, values) in zip(panels, shown.items(), strict=True):
        symbol = SYMBOLS.get(name, name)
        if values.ndim > 1:
            values, symbol = values @ line.direction, f"{symbol} along the line"
        if np.isnan(values).all():
            raise InputError(f"the line meets no cells of level {level} of {dump.path}; choose another axis or level")
        scale, prefix = prefix_of(float(np.nanmax(np.abs(values))))
        panel.plot(
            line.along / length, values / scale, color=LINES.get(name, "C0"), linewidth=1.0, drawstyle="steps-mid"
        )
        panel.set_ylabel(f"{symbol} / {_in(prefix, dump.unit(name))}")
        panel.grid(alpha=0.3)
        panel.margins(x=0)
    panels[-1].set_xlabel(f"distance from the centre of charge / {length_prefix}m")
    centre = ", ".join(quantity(x, "m", reach(dump)) for x in line.centre)
    direction = ", ".join(f"{x:.3g}" for x in line.direction).replace("-", "−")
    of = "" if level is None else f", level {level}"
    panels[0].set_title(
        f"through ({centre}) along ({direction}){of}, step {dump.step}, t = {quantity(dump.time, 's')}",
        fontsize="medium",
    )
    return figure


def _in(prefix: str, unit: str) -> str:
    """Return the unit as what a number is divided by."""
    pretty = unit.replace("^2", "²").replace("^3", "³")
    return f"({prefix}{pretty})" if "/" in pretty else f"{prefix}{pretty}"


def reach(dump: Dump) -> float:
    """Return the largest coordinate in m, which settles the prefix of lengths."""
    return float(np.abs([dump.lower, dump.upper]).max())


def _moderate(corners: Array) -> bool:
    """Whether a plane, which is wider than high, can be drawn to scale."""
    width, height = corners[:, 1] - corners[:, 0]
    return bool(width <= 5 * height)


def _canvas(corners: Array) -> tuple[Figure, Axes, Axes]:
    """Return a figure, a panel of the shape of a plane that is wider than high, and the axes of its colour bar.

    Placed by hand: automatic layouts do not converge on a panel of fixed shape with a colour bar of its height.
    """
    width, height = corners[:, 1] - corners[:, 0]
    panel = (5.6, 5.6 * (float(height / width) if _moderate(corners) else 0.6))  # inches
    left, bottom, right, top = 0.8, 0.8, 1.1, 0.4
    size = left + panel[0] + right, bottom + panel[1] + top
    figure = Figure(figsize=size)
    axes = figure.add_axes((left / size[0], bottom / size[1], panel[0] / size[0], panel[1] / size[1]))
    bar_left = (left + panel[0] + 0.15) / size[0]
    return figure, axes, figure.add_axes((bar_left, bottom / size[1], 0.2 / size[0], panel[1] / size[1]))


def save(figure: Figure, path: Path) -> Path:
    """Write a picture; return its path. Raises OutputError."""
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        figure.savefig(temporary(path), format="png", dpi=DPI, bbox_inches="tight")
        publish(path)
    except OSError as error:
        raise OutputError(f"cannot write picture {path}: {one_line(error)}; choose another output folder") from None
    return path

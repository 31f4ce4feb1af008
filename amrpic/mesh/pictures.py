"""Pictures of planes and lines through fields, by matplotlib, which takes long to import. Serial: for one rank."""

from __future__ import annotations

import io
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
from matplotlib import colormaps
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.collections import LineCollection
from matplotlib.colors import (
    BoundaryNorm,
    Colormap,
    LinearSegmentedColormap,
    ListedColormap,
    LogNorm,
    Normalize,
    SymLogNorm,
)
from matplotlib.figure import Figure
from numpy.typing import NDArray

from ..errors import InputError
from ..units import prefix_of
from .composite import Composite
from .domain import AXES
from .raster import Raster, cut_by

Array = NDArray[Any]
Colouring = tuple[Normalize, Colormap]

LEVEL_COLOURS = ("#9a9a9a", "#ffffff", "#7fe3ff", "#ffb3de", "#b7f58f", "#ffe08a")  # light: they lie on dark data
ONE_SIGN = colormaps["inferno"]
BOTH_SIGNS = LinearSegmentedColormap.from_list("both signs", ["#b9e3ff", "#3d8bc9", "#0b0b14", "#c9553d", "#ffd0b9"])
OF_KINDS, OF_NONE = colormaps["tab10"], "#808080"  # of what has a number; repeated where there are more
METAL, OUTLINE = (0.55, 0.58, 0.62, 1.0), (1.0, 1.0, 1.0, 1.0)  # of electrodes and of their surfaces
DECADES = 5  # that a logarithmic scale shows
DPI = 150


class Picture(Figure):
    """A figure that a notebook shows by itself, whether pyplot is in use or not."""

    def _repr_png_(self) -> bytes:
        return png(self)


def png(figure: Figure, dpi: float = DPI) -> bytes:
    """Return a figure as a PNG file."""
    out = io.BytesIO()
    if figure.get_layout_engine() is None:
        figure.savefig(out, format="png", dpi=dpi, bbox_inches="tight")
    else:  # no margins are left to be cut off: it is laid out while it is drawn, where savefig draws it twice
        own = figure.dpi
        figure.set_dpi(dpi)
        FigureCanvasAgg(figure).print_png(out)
        figure.set_dpi(own)
    return out.getvalue()


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


def colours_of_kinds(values: Array, count: int) -> Colouring:
    """Return norm and colour map of the numbers of so many kinds, and of -1, which is none of them, where there is that."""
    numbers = range(-1 if np.nanmin(values) < 0 else 0, count)
    colours = [OF_NONE if number < 0 else OF_KINDS(number % OF_KINDS.N) for number in numbers]
    return BoundaryNorm(np.arange(numbers.start, count + 1) - 0.5, len(colours)), ListedColormap(colours)


def _decades(least: float, most: float) -> list[float]:
    """Return zero and the decades on both sides of it, except those too close to it."""
    decades = 10.0 ** np.arange(np.ceil(np.log10(least)) + 1, np.floor(np.log10(most)) + 1)
    return [*-decades[::-1], 0.0, *decades]


SCALES: dict[str, Callable[[Array], Colouring]] = {
    "auto": linear_colours,
    "linear": linear_colours,
    "symmetric": symmetric_colours,
    "log": logarithmic_colours,
}


def plane(
    fields: Composite,
    raster: Raster,
    symbol: str,
    unit: str,
    title: str,
    scale: str = "auto",
    boxes: bool = True,
    level: int | None = None,
    kinds: Sequence[str] = (),
    metal: tuple[Array, Array] | None = None,
) -> Picture:
    """Return a picture of a raster of fields, of the part of it that holds values, with the boxes over it if they are wanted.

    `level` is the only one that the raster shows, None: all. `kinds`, if there are any, are what values are the numbers of; -1
    is none of them. `metal`: which pixels, as many as there may be, lie in electrodes, and through which their surfaces go.
    Raises InputError for a scale that does not exist.
    """
    if scale not in SCALES:
        raise InputError(f"{scale!r} is no scale of colours; use one of {', '.join(SCALES)}")
    length, length_prefix = prefix_of(fields.reach)
    factor, label = _scaled(symbol, unit, raster.values)
    values = raster.values / factor
    norm, colour_map = colours_of_kinds(values, len(kinds)) if kinds else SCALES[scale](values)
    corners = np.stack([raster.lower, raster.upper], axis=1) / length
    extent = _extent(raster) / length
    figure, panel, bar = _canvas(extent)
    image = panel.imshow(
        values.T,
        origin="lower",
        extent=(corners[0, 0], corners[0, 1], corners[1, 0], corners[1, 1]),
        norm=norm,
        cmap=colour_map,
        interpolation="nearest",
        aspect="equal" if _moderate(extent) else "auto",
    )
    if metal is not None:
        _draw_metal(panel, metal, corners)
    panel.set_facecolor("#808080")  # where a level has no cells
    if boxes:
        _draw_boxes(panel, fields, raster, length, level)
    panel.set(
        xlabel=f"{AXES[raster.axes[0]]} / {length_prefix}m",
        ylabel=f"{AXES[raster.axes[1]]} / {length_prefix}m",
        xlim=extent[0],
        ylim=extent[1],
    )
    panel.set_title(title.replace("-", "−"), fontsize="medium")
    colours = figure.colorbar(image, cax=bar, label="" if kinds else label)
    if isinstance(norm, SymLogNorm):
        colours.set_ticks(_decades(norm.linthresh, float(norm.vmax or 1)))
    if isinstance(norm, BoundaryNorm):
        numbers = (norm.boundaries[:-1] + 0.5).astype(int)
        colours.set_ticks(numbers.tolist(), labels=[("none", *kinds)[number + 1] for number in numbers], minor=False)
        colours.minorticks_off()
    if boxes and len(fields.levels) > 1:
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


def _draw_metal(panel: Axes, metal: tuple[Array, Array], corners: Array) -> None:
    """Draw electrodes: what lies in them in one colour, and their surfaces in another."""
    inside, surface = metal
    colours = np.zeros((*inside.shape, 4), dtype=np.uint8)  # an eighth of the memory of floats, also in the drawing
    colours[inside] = np.round(255 * np.array(METAL))
    colours[surface] = np.round(255 * np.array(OUTLINE))
    extent = (corners[0, 0], corners[0, 1], corners[1, 0], corners[1, 1])
    panel.imshow(np.swapaxes(colours, 0, 1), origin="lower", extent=extent, aspect=panel.get_aspect())


def _extent(raster: Raster) -> Array:
    """Return the corners (2, 2) in m of what a raster shows, the first axis first."""
    is_finite = np.isfinite(raster.values)
    out = []
    for d in range(2):
        pixels = np.flatnonzero(is_finite.any(axis=1 - d))
        edges = np.array([pixels[0], pixels[-1] + 1]) / is_finite.shape[d]
        out.append(raster.lower[d] + edges * (raster.upper[d] - raster.lower[d]))
    return np.array(out)


def _draw_boxes(panel: Axes, fields: Composite, raster: Raster, length: float, only: int | None) -> None:
    """Outline the boxes that a plane cuts, or all of them, in a light colour per level."""
    axes = list(raster.axes)
    for level, description in enumerate(fields.levels):
        if only not in (None, level):
            continue
        boxes = description.boxes
        if raster.position is not None:
            boxes = boxes[cut_by(fields, level, raster.axis, raster.position)]
        flat = np.unique(boxes[:, [*axes, axes[0] + 3, axes[1] + 3]], axis=0)
        lower = (fields.lower[axes] + flat[:, :2] * description.spacing[axes]) / length
        upper = (fields.lower[axes] + (flat[:, 2:] + 1) * description.spacing[axes]) / length
        x, y = (np.stack([lower[:, k], upper[:, k]]) for k in range(2))
        outlines = np.stack([x[[0, 1, 1, 0, 0]], y[[0, 0, 1, 1, 0]]], axis=-1).transpose(1, 0, 2)
        colour = LEVEL_COLOURS[level % len(LEVEL_COLOURS)]
        panel.add_collection(LineCollection(list(outlines), colors=colour, linewidths=0.5, alpha=0.7))
        panel.plot([], [], color=colour, label=f"level {level}")


def curve(distance: Array, values: Array, symbol: str, unit: str, title: str) -> Picture:
    """Return the picture of values (n,) along a line, by their distance (n,) in m from its start."""
    figure = Picture(figsize=(8, 3.6), layout="constrained")
    panel = figure.subplots()
    length, length_prefix = prefix_of(float(np.abs(distance).max()))
    draw_curve(panel, distance / length, values, symbol, unit)
    panel.set_xlabel(f"distance along the line / {length_prefix}m")
    panel.set_title(title.replace("-", "−"), fontsize="medium")
    return figure


def draw_curve(
    panel: Axes, along: Array, values: Array, symbol: str, unit: str, colour: str = "C0", steps: bool = True
) -> None:
    """Draw values into a panel whose abscissa is `along`: by steps, as they are constant in cells, or joined by lines."""
    factor, label = _scaled(symbol, unit, values)
    panel.plot(along, values / factor, color=colour, linewidth=1.0, drawstyle="steps-mid" if steps else "default")
    panel.set_ylabel(label)
    panel.grid(alpha=0.3)
    panel.margins(x=0)


def _scaled(symbol: str, unit: str, values: Array) -> tuple[float, str]:
    """Return what values are divided by, and the label of the axis that shows the quotients."""
    if not unit:
        return 1.0, symbol
    factor, prefix = prefix_of(float(np.nanmax(np.abs(values))))
    return factor, f"{symbol} / {divisor(prefix, unit)}"


def divisor(prefix: str, unit: str) -> str:
    """Return the unit as what a number is divided by."""
    pretty = unit.replace("^2", "²").replace("^3", "³")
    return f"({prefix}{pretty})" if "/" in pretty or " " in pretty else f"{prefix}{pretty}"


def _moderate(corners: Array) -> bool:
    """Whether a plane, which is wider than high, can be drawn to scale."""
    width, height = corners[:, 1] - corners[:, 0]
    return bool(width <= 5 * height)


def _canvas(corners: Array) -> tuple[Picture, Axes, Axes]:
    """Return a figure, a panel of the shape of a plane that is wider than high, and the axes of its colour bar.

    Placed by hand: automatic layouts do not converge on a panel of fixed shape with a colour bar of its height.
    """
    width, height = corners[:, 1] - corners[:, 0]
    panel = (5.6, 5.6 * (float(height / width) if _moderate(corners) else 0.6))  # inches
    left, bottom, right, top = 0.8, 0.8, 1.1, 0.4
    size = left + panel[0] + right, bottom + panel[1] + top
    figure = Picture(figsize=size)
    axes = figure.add_axes((left / size[0], bottom / size[1], panel[0] / size[0], panel[1] / size[1]))
    bar_left = (left + panel[0] + 0.15) / size[0]
    return figure, axes, figure.add_axes((bar_left, bottom / size[1], 0.2 / size[0], panel[1] / size[1]))

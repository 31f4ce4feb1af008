"""Pictures of a field dump: slices, a projection of the charge and profiles along a line, with the boxes drawn."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib import colormaps
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection
from matplotlib.colors import Colormap, LinearSegmentedColormap, LogNorm, Normalize
from matplotlib.figure import Figure
from numpy.typing import NDArray

from .errors import OutputError
from .hierarchy import AXES
from .io.collect import one_line
from .io.dump import Dump
from .io.durable import publish, temporary
from .raster import Line, Raster, Spread, cut_by, line_through, line_values, projection, slice_through, spread_of

Array = NDArray[Any]
Colours = Callable[[Array], tuple[Normalize, Colormap]]

PREFIXES = {1e9: "G", 1e6: "M", 1e3: "k", 1.0: "", 1e-3: "m", 1e-6: "µ", 1e-9: "n", 1e-12: "p", 1e-15: "f"}
LEVEL_COLOURS = ("#9a9a9a", "#ffffff", "#7fe3ff", "#ffb3de", "#b7f58f", "#ffe08a")  # light: they lie on dark data
ONE_SIGN = colormaps["inferno"]
BOTH_SIGNS = LinearSegmentedColormap.from_list("both signs", ["#b9e3ff", "#3d8bc9", "#0b0b14", "#c9553d", "#ffd0b9"])
DECADES = 5  # of the charge that its projection shows
ROUNDING = 1e-12  # of the mean charge per area
DPI = 150


def plot(path: Path, directory: Path | None = None, axis: str = "z", position: float | None = None) -> list[Path]:
    """Draw a field dump and return the pictures' paths. Serial: for one rank.

    Slices are normal to `axis`, at `position` (m) or through the middle of the charge. Pictures go beside the dump
    unless `directory` is given. Raises InputError for what is no dump, OutputError if a picture cannot be written.
    """
    path, normal = Path(path), AXES.index(axis)
    with Dump(path) as dump:
        spread = spread_of(dump)
        place = float(spread.centre[normal]) if position is None else position
        line = line_through(dump, spread)
        pictures = {
            f"phi_{axis}": slice_picture(dump, "phi", "φ", normal, place),
            f"E_{axis}": slice_picture(dump, "E", "|E|", normal, place),
            f"rho_{axis}": projection_picture(dump, normal, spread),
            "line": line_picture(dump, line),
        }
    folder = path.parent if directory is None else Path(directory)
    return [_save(figure, folder / f"{path.stem}_{name}.png") for name, figure in pictures.items()]


def slice_picture(dump: Dump, name: str, symbol: str, axis: int, position: float) -> Figure:
    """Return the picture of a field in a plane."""
    raster = slice_through(dump, name, axis, position)
    title = f"{symbol} at {AXES[axis]} = {quantity(position, 'm', reach(dump))}"
    return _picture(dump, raster, raster.values, symbol, dump.units[name], linear_colours, title)


def projection_picture(dump: Dump, axis: int, spread: Spread) -> Figure:
    """Return the picture of the charge per area, seen along an axis."""
    raster = projection(dump, "rho", axis)
    # Opposite charges that cancel along the line of sight leave rounding, which is not to be shown.
    mean = spread.charge / float(np.prod(raster.upper - raster.lower))
    values = np.where(np.abs(raster.values) > ROUNDING * mean, raster.values, 0.0)
    sign, symbol = (-1.0, f"−∫ρ d{AXES[axis]}") if values.max() <= 0 > values.min() else (1.0, f"∫ρ d{AXES[axis]}")
    title = f"charge per area along {AXES[axis]}"
    return _picture(dump, raster, sign * values, symbol, "C/m²", logarithmic_colours, title)


def linear_colours(values: Array) -> tuple[Normalize, Colormap]:
    """Return norm and colour map: from zero for values of one sign, symmetric about zero for both."""
    low, high = min(float(values.min()), 0.0), max(float(values.max()), 0.0)
    most = max(-low, high) or 1.0
    if min(-low, high) > 0.02 * most:
        return Normalize(-most, most), BOTH_SIGNS
    return (Normalize(0, most), ONE_SIGN) if high >= -low else (Normalize(-most, 0), ONE_SIGN.reversed())


def logarithmic_colours(values: Array) -> tuple[Normalize, Colormap]:
    """Return norm and colour map of the largest decades; linear ones if values have both signs or are all zero."""
    most = float(values.max())
    if most <= 0 or values.min() < -(10.0**-DECADES) * most:
        return linear_colours(values)
    return LogNorm(10.0**-DECADES * most, most, clip=True), ONE_SIGN


def _picture(dump: Dump, raster: Raster, values: Array, symbol: str, unit: str, colours: Colours, title: str) -> Figure:
    """Return a picture of a raster with the boxes of all levels over it."""
    length, length_prefix = prefix_of(reach(dump))
    scale, prefix = prefix_of(float(np.abs(values).max()))
    norm, colour_map = colours(values / scale)
    corners = np.stack([raster.lower, raster.upper], axis=1) / length
    figure, panel, bar = _canvas(corners)
    image = panel.imshow(
        (values / scale).T,
        origin="lower",
        extent=(corners[0, 0], corners[0, 1], corners[1, 0], corners[1, 1]),
        norm=norm,
        cmap=colour_map,
        interpolation="nearest",
        aspect="equal" if _moderate(corners) else "auto",
    )
    _draw_boxes(panel, dump, raster, length)
    panel.set(
        xlabel=f"{AXES[raster.axes[0]]} / {length_prefix}m",
        ylabel=f"{AXES[raster.axes[1]]} / {length_prefix}m",
        xlim=corners[0],
        ylim=corners[1],
    )
    panel.set_title(f"{title}, step {dump.step}, t = {quantity(dump.time, 's')}", fontsize="medium")
    figure.colorbar(image, cax=bar, label=f"{symbol} / {_in(prefix, unit)}")
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


def _draw_boxes(panel: Axes, dump: Dump, raster: Raster, length: float) -> None:
    """Outline the boxes that a plane cuts, or all of them, in a light colour per level."""
    axes = list(raster.axes)
    for level, description in enumerate(dump.levels):
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


def line_picture(dump: Dump, line: Line) -> Figure:
    """Return the profiles of φ, of E along the line and of ρ."""
    profiles = {
        "φ": (line_values(dump, "phi", line), dump.units["phi"]),
        "E along the line": (line_values(dump, "E", line) @ line.direction, dump.units["E"]),
        "ρ": (line_values(dump, "rho", line), dump.units["rho"]),
    }
    length, length_prefix = prefix_of(float(np.abs(line.along).max()))
    figure = Figure(figsize=(8, 7.5), layout="constrained")
    panels = figure.subplots(3, 1, sharex=True)
    for panel, (symbol, (values, unit)), colour in zip(panels, profiles.items(), ("C0", "C3", "C2"), strict=True):
        scale, prefix = prefix_of(float(np.abs(values).max()))
        panel.plot(line.along / length, values / scale, color=colour, linewidth=1.0, drawstyle="steps-mid")
        panel.set_ylabel(f"{symbol} / {_in(prefix, unit)}")
        panel.grid(alpha=0.3)
        panel.margins(x=0)
    panels[-1].set_xlabel(f"distance from the centre of charge / {length_prefix}m")
    centre = ", ".join(quantity(x, "m", reach(dump)) for x in line.centre)
    direction = ", ".join(f"{x:.3g}" for x in line.direction).replace("-", "−")
    panels[0].set_title(
        f"through ({centre}) along ({direction}), step {dump.step}, t = {quantity(dump.time, 's')}", fontsize="medium"
    )
    return figure


def prefix_of(largest: float) -> tuple[float, str]:
    """Return the SI prefix, as a factor and a letter, that brings the largest magnitude between 1 and 1000."""
    for factor, letter in PREFIXES.items():
        if abs(largest) >= 0.9995 * factor:
            return factor, letter
    return 1.0, ""


def quantity(value: float, unit: str, like: float | None = None) -> str:
    """Return a number with its unit, in the prefix that suits it, or `like`."""
    factor, letter = prefix_of(value if like is None else like)
    # To a thousandth of what it is compared with: the centre of a cloud of particles is not known better.
    digits = 3 - len(f"{abs(value if like is None else like) / factor:.0f}")
    return f"{round(value / factor, digits + 1) + 0.0:g} {letter}{unit}".replace("-", "−")


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
    left, bottom, right, top = 0.8, 0.85, 1.1, 0.4
    size = left + panel[0] + right, bottom + panel[1] + top
    figure = Figure(figsize=size)
    axes = figure.add_axes((left / size[0], bottom / size[1], panel[0] / size[0], panel[1] / size[1]))
    bar_left = (left + panel[0] + 0.15) / size[0]
    return figure, axes, figure.add_axes((bar_left, bottom / size[1], 0.2 / size[0], panel[1] / size[1]))


def _save(figure: Figure, path: Path) -> Path:
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        figure.savefig(temporary(path), format="png", dpi=DPI, bbox_inches="tight")
        publish(path)
    except OSError as error:
        raise OutputError(f"cannot write picture {path}: {one_line(error)}; choose another output folder") from None
    return path

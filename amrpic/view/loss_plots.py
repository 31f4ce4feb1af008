"""Pictures of losses: what is lost along z, at what."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.figure import Figure
from numpy.typing import NDArray

from ..errors import InputError
from ..io import time_series
from ..mesh.pictures import DECADES
from ..units import prefix_of, quantity
from .figures import save

FILE = "losses.csv"
UNITS = {"energy": "J/m", "charge": "C/m", "particles": "1/m"}  # of what is lost per length
TITLES = {"energy": "deposited energy", "charge": "lost charge", "particles": "lost macroparticles"}
OVERVIEW = ("energy", "charge")
SEVERAL = 30.0  # times as much in one bin as in another asks for a logarithmic scale


def plot(path: Path, directory: Path | None = None, quantities: Sequence[str] = OVERVIEW) -> list[Path]:
    """Draw a map of losses, or that in a run's folder; return the picture's path. Serial.

    The picture goes beside the map unless `directory` is given. Raises InputError if there are no losses or no such quantity,
    OutputError if the picture cannot be written.
    """
    for name in quantities:
        if name not in UNITS:
            raise InputError(f"a map of losses has no {name}; choose among {', '.join(UNITS)}")
    path = Path(path)
    file = path / FILE if path.is_dir() else path
    table = time_series.read(file)
    if "cause" not in (table.dtype.names or ()):
        raise InputError(f"{file} is not a map of losses; name a losses.csv or the folder of a run")
    if len(table) == 0:
        raise InputError(f"{file} holds no losses to draw; choose another run")
    folder = file.parent if directory is None else Path(directory)
    return [save(draw(table, quantities), folder / f"{file.stem}.png")]


def draw(table: NDArray[Any], quantities: Sequence[str]) -> Figure:
    """Return the picture of a map: a panel for each quantity, a colour for each cause."""
    length, length_prefix = prefix_of(float(np.abs([table["lower"], table["upper"]]).max()))
    causes = list(dict.fromkeys(table["cause"].tolist()))
    figure = Figure(figsize=(8, 1.2 + 2.6 * len(quantities)), layout="constrained")
    panels = figure.subplots(len(quantities), 1, sharex=True, squeeze=False)[:, 0]
    for panel, name in zip(panels, quantities, strict=True):
        values = np.abs(table[name]) / (table["upper"] - table["lower"])
        factor, prefix = prefix_of(float(values.max()))
        for number, cause in enumerate(causes):
            rows = table["cause"] == cause
            width = (table["upper"] - table["lower"])[rows] / length
            panel.bar(
                table["lower"][rows] / length, values[rows] / factor, width, align="edge", color=f"C{number}", alpha=0.75,
                label=cause,
            )  # fmt: skip
        positive = values[values > 0]
        if len(positive) > 0 and positive.max() > SEVERAL * positive.min():
            panel.set_yscale("log")
            panel.set_ylim(bottom=max(positive.min() / 2, positive.max() * 10.0**-DECADES) / factor)
        panel.set_ylabel(f"{TITLES[name]} / ({prefix}{UNITS[name]})")
        panel.grid(alpha=0.3)
    panels[-1].set_xlabel(f"z / {length_prefix}m")
    panels[0].legend(fontsize="small", ncols=4)
    energy = quantity(float(table["energy"].sum()), "J")
    charge = quantity(float(table["charge"].sum()), "C")
    title = f"{table['particles'].sum()} particles lost, {charge}, {energy}".replace("-", "−")
    figure.suptitle(title, fontsize="medium")
    return figure

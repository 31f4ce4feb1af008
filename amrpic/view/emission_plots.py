"""Pictures of what sources gave: charge over their surfaces, and current in time."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.figure import Figure
from numpy.typing import NDArray

from ..io import time_series
from ..units import prefix_of, quantity

MAP, IN_TIME = "emission.csv", "sources.csv"


def figures(folder: Path) -> Iterator[tuple[str, Figure]]:
    """Yield the picture of all currents of a run's sources, and those of what each gave, by name. InputError if none."""
    in_time = time_series.read(folder / IN_TIME)
    yield "current of sources", _currents(in_time)
    if (folder / MAP).exists():
        table = time_series.read(folder / MAP)
        for name in dict.fromkeys(table["source"].tolist()):
            yield f"emission of {name}", draw_map(table[table["source"] == name], name)


def draw_map(table: NDArray[Any], name: str) -> Figure:
    """Return the picture of the charge per area that a source gave."""
    (x, y), density = (np.unique(table[axis]) for axis in ("x", "y")), np.abs(table["charge"] / table["area"])
    length, length_prefix = prefix_of(float(np.abs([table["x"], table["y"]]).max()))
    factor, prefix = prefix_of(float(density.max()))
    figure = Figure(figsize=(5.5, 4.6), layout="constrained")
    panel = figure.subplots()
    mesh = panel.pcolormesh(x / length, y / length, density.reshape(len(x), len(y)).T / factor, cmap="viridis")
    panel.set_aspect("equal")
    panel.set_xlabel(f"first axis / {length_prefix}m")
    panel.set_ylabel(f"second axis / {length_prefix}m")
    figure.colorbar(mesh, label=f"born charge / ({prefix}C/m²)")
    figure.suptitle(f"{name}: {quantity(float(table['charge'].sum()), 'C')}".replace("-", "−"), fontsize="medium")
    return figure


def _currents(table: NDArray[Any]) -> Figure:
    figure = Figure(figsize=(5.5, 4.6), layout="constrained")
    panel = figure.subplots()
    duration, duration_prefix = prefix_of(float(np.abs(table["time"]).max()))
    factor, prefix = prefix_of(float(np.abs(table["current"]).max()))
    for name in dict.fromkeys(table["source"].tolist()):
        rows = table[table["source"] == name]
        panel.plot(rows["time"] / duration, rows["current"] / factor, label=name)
    panel.set_xlabel(f"t / {duration_prefix}s")
    panel.set_ylabel(f"current / {prefix}A")
    panel.grid(alpha=0.3)
    panel.legend(fontsize="small")
    return figure

"""Pictures of tables: how columns change along a run."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator
from numpy.typing import NDArray

from ..mesh.domain import FACES
from ..mesh.pictures import divisor
from ..units import prefix_of

Table = NDArray[Any]


@dataclass(frozen=True)
class Panel:
    """Curves that share an ordinate, by the columns that they show."""

    label: str
    unit: str
    columns: Sequence[str]
    logarithmic: bool = False
    stacked: bool = False  # one above the other, as parts of a sum

    def there(self, table: Table) -> list[str]:
        """Return those of its columns that a table has, with a number besides zero in them."""
        present = (name for name in self.columns if name in (table.dtype.names or ()))
        return [name for name in present if np.any(np.isfinite(table[name]) & (table[name] != 0))]


BEAM = (
    Panel("rms size", "m", ("rms_x", "rms_y", "rms_z")),
    Panel("emittance", "m rad", ("emittance_x", "emittance_y", "emittance_z")),
    Panel("energy", "J", ("kinetic_energy", "potential_energy")),
    Panel("lost particles", "", ("lost_particles",)),
)
BODY = (
    Panel("force of a face", "N", [f"force_{face}" for face in FACES]),
    Panel("energy", "J", ("work", "stored", "dissipated")),
    Panel("det F", "", ("j_min", "j_max")),
    Panel("damage", "", ("damage_max",)),
)
SOLVER = (
    Panel("cycles", "", ("cycles",)),
    Panel("turns and iterations", "", ("turns", "newton_iterations", "cg_iterations")),
    Panel("residual", "", ("residual",), logarithmic=True),
)


def draw(table: Table, panels: Sequence[Panel], against: str = "step", unit: str = "") -> Figure:
    """Return a picture with a panel for each of some, of the columns that the table has."""
    drawn_panels = [panel for panel in panels if panel.there(table)]
    figure = Figure(figsize=(8, 0.6 + 1.9 * max(len(drawn_panels), 1)), layout="constrained")
    axes = figure.subplots(max(len(drawn_panels), 1), 1, sharex=True, squeeze=False)[:, 0]
    along, label = table[against], against
    if unit:
        factor, prefix = prefix_of(float(np.abs(along).max(initial=0.0)))
        along, label = along / factor, f"{against} / {divisor(prefix, unit)}"
    for panel, axis in zip(drawn_panels, axes, strict=False):
        names = panel.there(table)
        factor, prefix = (
            prefix_of(max(float(np.nanmax(np.abs(table[name]))) for name in names)) if panel.unit else (1, "")
        )
        labels = [name.removeprefix("seconds_") for name in names]
        values = [table[name] / factor for name in names]
        if panel.logarithmic:
            values = [np.where(curve > 0, curve, np.nan) for curve in values]
        if panel.stacked:
            axis.stackplot(along, *values, labels=labels, step="mid")
        else:
            for name, curve in zip(labels, values, strict=True):
                axis.plot(along, curve, label=name, marker="o" if len(along) == 1 else None)
        if panel.logarithmic:
            axis.set_yscale("log")
        elif not panel.unit:
            axis.yaxis.set_major_locator(MaxNLocator(integer=all(table[name].dtype.kind == "i" for name in names)))
        axis.set_ylabel(f"{panel.label} / {divisor(prefix, panel.unit)}" if panel.unit else panel.label)
        axis.grid(alpha=0.3)
        if len(names) > 1:
            axis.legend(fontsize="x-small", ncols=4)
    axes[-1].set_xlabel(label)
    if along.dtype.kind == "i":
        axes[-1].xaxis.set_major_locator(MaxNLocator(integer=True))
    return figure

"""Pictures of a run of material points beside those of its fields. Serial: for one rank."""

from __future__ import annotations

from pathlib import Path

from ..io import time_series
from ..mesh.domain import AXES
from ..results.run_results import SERIES
from ..units import prefix_of
from ..view.plot import save

NAME = "force.png"


def draw_forces(folder: Path, into: Path) -> list[Path]:
    """Draw the forces of faces of a run over the travel of its platens, or over the load if none moves; return the paths.

    There is none of a table without rows, as after a restart from the last step. Raises InputError if the run has no series,
    OutputError if the picture cannot be written.
    """
    from matplotlib.figure import Figure

    rows = time_series.read(Path(folder) / SERIES)
    if len(rows) == 0:
        return []
    moving = [axis for axis in AXES if rows[f"travel_{axis}"].any()]
    figure = Figure(figsize=(6, 4), layout="constrained")
    panel = figure.subplots()
    largest = max(abs(rows[f"force_{axis}_{side}"]).max() for axis in moving or AXES for side in ("lower", "upper"))
    newton, letter = prefix_of(float(largest))
    for axis in moving or AXES:
        over = rows[f"travel_{axis}"] if moving else 100 * rows["load"]
        length, metre = prefix_of(float(abs(over).max())) if moving else (1.0, "")
        for side, style in (("lower", "o-"), ("upper", "x--")):
            force = rows[f"force_{axis}_{side}"]
            if force.any():
                panel.plot(over / length, force / newton, style, label=f"{axis} {side}")
        panel.set_xlabel(f"travel / {metre}m" if moving else "part of the load / %")
    panel.set_ylabel(f"force of a face on the body, along its axis / {letter}N")
    if panel.lines:
        panel.legend()
    panel.grid(alpha=0.3)
    return [save(figure, Path(into) / NAME)]

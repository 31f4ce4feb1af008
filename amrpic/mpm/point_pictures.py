"""Pictures of a run of material points beside those of its fields. Serial: for one rank."""

from __future__ import annotations

from pathlib import Path

from ..io import time_series
from ..mesh.domain import AXES, FACES
from ..results.run_results import SERIES
from ..units import prefix_of
from ..view.figures import save

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
    forces = {face: rows[f"force_{face}"] for face in FACES if face[0] in moving or not moving}
    newton, letter = prefix_of(float(max(abs(force).max() for force in forces.values())))
    metre, prefix = prefix_of(float(max(abs(rows[f"travel_{axis}"]).max() for axis in AXES)))
    figure = Figure(figsize=(6, 4), layout="constrained")
    panel = figure.subplots()
    for face, force in forces.items():
        over = rows[f"travel_{face[0]}"] / metre if moving else 100 * rows["load"]
        if force.any():
            panel.plot(over, force / newton, "o-" if face.endswith("lower") else "x--", label=face.replace("_", " "))
    panel.set_xlabel(f"travel / {prefix}m" if moving else "part of the load / %")
    panel.set_ylabel(f"force of a face on the body, along its axis / {letter}N")
    if panel.lines:
        panel.legend()
    panel.grid(alpha=0.3)
    return [save(figure, Path(into) / NAME)]

"""The section [diagnostics] of a scene: how often the beam is measured, and how finely."""

from __future__ import annotations

from pydantic import Field

from .section import Section
from .units import Length


class Diagnostics(Section):
    """What is measured of all particles, of each species and of each bunch, and written beside the time series."""

    every: int = Field(
        default=20,
        ge=0,
        description="Steps between rows of beam.csv and slices.csv, and between calls of a script's own diagnostics; 0 writes "
        "none. The first and the last step are there in any case. A row takes about as long as one to two steps of the "
        "particles, hence not each step.",
    )
    slices: int = Field(
        default=0,
        ge=0,
        le=1000,
        description="Slices along z of each group of particles, in slices.csv, all as long; 0: none. They reach over the "
        "group, at most 4 rms lengths to either side of its centre: particles beyond are in the outermost ones.",
    )
    loss_bin: Length | None = Field(
        default=None,
        gt=0,
        description="Length of the bins of losses.csv along z, m; a hundredth of the domain's if not given.",
    )

"""The sections of a scene without laws of their own: [schedule], [diagnostics], [output] and [particles]."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Literal, Self

from pydantic import Field, model_validator

from ..particles.clouds import Clouds, CompensationKind, Shape
from .section import Section
from .units import Length, Time

PART_BYTES = 2**30


class Files(Section):
    """What a run of any method writes."""

    directory: str | None = Field(
        default=None, min_length=1, description="Where to write; runs/<name of the scene> if not given."
    )
    write: Sequence[str] = Field(default=[], description="The kinds of output wanted.")
    checkpoint_every: int = Field(
        default=10, ge=0, description="Steps between checkpoints; 0 writes the last one only."
    )
    keep: int = Field(
        default=2, ge=1, description="Newest checkpoints kept: two, so that one remains if a disk fails the last."
    )
    keep_every: int = Field(
        default=0,
        ge=0,
        description="Of the checkpoints one in so many stays for good, besides the newest: those of steps that are multiples "
        "of keep_every times checkpoint_every; 0: none does.",
    )
    writers: int | None = Field(
        default=None,
        ge=0,
        description="Ranks that write a checkpoint, field or particle file, each a part of its own; 0 lets all of them. If not "
        "given, one for each `part_bytes` of the file, and for each 128 ranks.",
    )
    part_bytes: int = Field(
        default=PART_BYTES,
        ge=1,
        description="Bytes of a file from which on one more rank writes, if `writers` is not given.",
    )


class Output(Files):
    """What a run writes."""

    write: list[Literal["checkpoint", "fields", "particles", "series", "losses", "pictures", "report"]] = Field(
        default=["checkpoint", "fields", "series", "losses", "pictures"],
        description="The kinds of output wanted; particles are openPMD files, which a restart does without; losses are the "
        "records of lost particles and of screens, as openPMD, and a map of losses along z: written where there are any; "
        "report is a page for a browser with all that is known of the run, made at its end.",
    )
    fields_every: int = Field(default=0, ge=0, description="Steps between field files; 0 writes the last one only.")
    particles_every: int = Field(
        default=0, ge=0, description="Steps between particle files; 0 writes the last one only."
    )


MOST_STEPS = 2**31 - 1


class Schedule(Section):
    """How long a run is. The first solve comes before the first step."""

    steps: int | None = Field(default=None, ge=0, le=MOST_STEPS, description="Steps after the first solve.")
    start: Time | None = Field(
        default=None,
        description="Time at the start, s, of RF phases and all that depends on time. By default that of the openPMD files "
        "that bunches are read from, else 0.",
    )
    solves: int | None = Field(
        default=None, ge=1, le=MOST_STEPS, description="Solves in all instead: one more than steps."
    )

    @model_validator(mode="after")
    def _one_of_two(self) -> Self:
        self.require_at_most_one("solves", "steps")
        return self

    @property
    def last_step(self) -> int:
        """Number of the step that ends the run."""
        return self.steps if self.steps is not None else (self.solves or 1) - 1


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


class ParticlesSection(Section):
    """How particles meet the mesh: their clouds, the same in deposit and gather."""

    shape: Shape = Field(
        default="cloud-in-cell",
        description="Cloud of a particle: nearest-grid-point touches its own cell alone and is noisy, cloud-in-cell two cells "
        "per axis, triangular-shaped-cloud three, smoother and nearly three times as expensive. All keep the charge exactly.",
    )
    interface: Literal["auto", "matched", "own-level"] = Field(
        default="auto",
        description="Particles less than two fine cells inside a coarse-fine face. own-level: clouds of the fine cells; such "
        "a particle pushes itself by up to 0.6 q²/(4πε₀h²). matched: clouds of the coarse cells, which bring that below 0.02 "
        "but see the field as the coarse level does. auto: matched unless every bunch has more than 140 (σ/h)² particles, "
        "σ its rms size and h the cell width of the finest level; the log and the scene in the outputs say which was taken.",
    )
    compensation: Literal["auto"] | CompensationKind = Field(
        default="none",
        description="What gather gives back of the field that clouds smooth, by the slope of the density. clouds: what they "
        "smooth in deposit and gather, all of it where cells are cubes in the frame of the field, else that over the narrowest "
        "width. clouds-and-mesh: in cubes also most of the solver's own error. Noise grows by a fifth to a half. auto: clouds "
        "where every bunch has more than 0.5 (σ/h)² particles per cell where it is densest (0.8 with cloud-in-cell, 1.2 with "
        "nearest-grid-point), σ its smallest rms size in cells h of the finest level, else none; the log and the scene in the "
        "outputs say which was taken.",
    )

    @property
    def clouds(self) -> Clouds:
        """The clouds; "auto" that is not settled counts as own-level and none."""
        kind = "none" if self.compensation == "auto" else self.compensation
        return Clouds(self.shape, self.interface == "matched", kind)

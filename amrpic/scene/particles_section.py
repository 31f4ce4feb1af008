"""The section [particles] of a scene: how particles meet the mesh."""

from __future__ import annotations

from typing import Literal

from pydantic import Field

from ..particles.clouds import Clouds, CompensationKind, Shape
from .section import Section


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

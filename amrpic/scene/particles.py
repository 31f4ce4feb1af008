"""The section [particles] of a scene: how particles meet the mesh."""

from __future__ import annotations

from typing import Literal

from pydantic import Field

from ..particles.clouds import Shape
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

"""The section [motion] of a scene: how the particles move."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field

from .real_particle import RealParticle
from .section import Section
from .units import Length, Length3, Time


class NoMotion(Section):
    """The particles rest."""

    kind: Literal["none"] = "none"


class Reference(RealParticle):
    """The particle that others are seen from: it moves by the fields of elements alone."""

    position: Length3 = Field(default=(0.0, 0.0, 0.0), description="At the start, m.")


class Leapfrog(Section):
    """Particles move in their own field, relativistically."""

    kind: Literal["leapfrog"]
    pusher: Literal["higuera-cary", "boris"] = Field(
        default="higuera-cary",
        description="How magnetic fields turn momenta. Higuera and Cary's keeps particles at rest in their bunch where E and "
        "v × B cancel; Boris's does not, and costs a root less.",
    )
    frame: Literal["auto", "lab", "rest"] = Field(
        default="auto",
        description="Where the self-field is electrostatic. rest: in the frame of the mean momentum, along a mesh axis, so "
        "that the laboratory has its magnetic field too; lab: in the laboratory, without one, refused above β² = 0.01; "
        "auto: lab below β² = 1e-4, else rest.",
    )
    energy_bins: Literal["auto"] | Annotated[int, Field(ge=1)] = Field(
        default="auto",
        description="Parts of a beam by the Lorentz factor along its motion and the direction of that, each solved for in a "
        "frame of its own. auto: as many as let γ differ by a tenth within one, at most 16, chosen at the start and every 16 "
        "steps; a number: so many of equal width in ln γ. What holds less than 0.1 % of the charge joins its neighbour.",
    )
    window: Literal["none", "reference"] = Field(
        default="none",
        description="reference: the mesh goes with the reference particle. It keeps its axes and goes along the one that the "
        "particle starts along; where all faces are open, it follows and turns with it. Coordinates of particles and fields "
        "are then those of the mesh at the start; elements stay where they are.",
    )
    reference: Reference | None = Field(
        default=None,
        description="The particle that the path length s belongs to. By default, with a window, it starts in the middle of the "
        "first bunch with its mean momentum.",
    )
    dt: Time = Field(gt=0, description="Time step, s; well below the plasma period and the time to cross a cell.")


class RandomWalk(Section):
    """Each coordinate of each particle takes a uniform random step: the reference benchmark's motion."""

    kind: Literal["random-walk"]
    amplitude: Length = Field(ge=0, description="Largest change per step and axis, m.")

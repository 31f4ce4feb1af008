"""The section [motion] of a scene: how the particles move."""

from __future__ import annotations

from typing import Literal

from pydantic import Field

from .section import Section
from .units import Length, Time


class NoMotion(Section):
    """The particles rest."""

    kind: Literal["none"] = "none"


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
    dt: Time = Field(gt=0, description="Time step, s; well below the plasma period and the time to cross a cell.")


class RandomWalk(Section):
    """Each coordinate of each particle takes a uniform random step: the reference benchmark's motion."""

    kind: Literal["random-walk"]
    amplitude: Length = Field(ge=0, description="Largest change per step and axis, m.")

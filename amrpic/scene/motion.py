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
    """Particles move in their own field, non-relativistically."""

    kind: Literal["leapfrog"]
    dt: Time = Field(gt=0, description="Time step, s; well below the plasma period and the time to cross a cell.")


class RandomWalk(Section):
    """Each coordinate of each particle takes a uniform random step: the reference benchmark's motion."""

    kind: Literal["random-walk"]
    amplitude: Length = Field(ge=0, description="Largest change per step and axis, m.")

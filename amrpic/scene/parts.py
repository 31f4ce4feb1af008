"""The parts of a scene, each checked by itself."""

from __future__ import annotations

from typing import Annotated, Literal

import numpy as np
from pydantic import Field

from .bunch_files import ArrayBunch, OpenPMDBunch
from .bunch_shapes import GaussianBunch, HaloBunch, HollowBunch, KVBunch, ParabolicBunch, SphereBunch, WaterbagBunch
from .bunches import DescribedBunch, LatticeBunch
from .diagnostics import Diagnostics
from .domain import DomainSection
from .elements import AnyElement
from .motion import Leapfrog, NoMotion, RandomWalk, Reference
from .obstacles import AnyAperture, Screen
from .output import Output
from .particles import ParticlesSection
from .refinement import Refinement
from .schedule import Schedule
from .section import Section
from .solver_options import SolverSection
from .thermal_bunch import ThermalBunch


class SceneParts(Section):
    """What a scene is made of; `fits_together.check` says whether the parts go together."""

    name: str = Field(default="scene", min_length=1, description="Name of the scene and of its output folder.")
    seed: int = Field(default=1, ge=0, lt=2**63, description="Of all random numbers; the same seed gives the same run.")
    background: Literal["none", "neutralizing"] = Field(
        default="none", description="neutralizing: a uniform density that cancels the net charge, for periodic scenes."
    )
    domain: DomainSection
    bunches: list[
        Annotated[
            GaussianBunch
            | SphereBunch
            | WaterbagBunch
            | KVBunch
            | ParabolicBunch
            | HollowBunch
            | HaloBunch
            | ThermalBunch
            | LatticeBunch
            | ArrayBunch
            | OpenPMDBunch,
            Field(discriminator="distribution"),
        ]
    ] = Field(default=[], description="The particles; without any, the scene runs with ρ = 0.")
    elements: list[AnyElement] = Field(
        default=[], description="Magnets, cavities and other fields along the beam line."
    )
    apertures: list[AnyAperture] = Field(default=[], description="Holes in solids at which particles are lost.")
    screens: list[Screen] = Field(default=[], description="Planes where particles are recorded as they pass.")
    refinement: Refinement = Refinement()
    particles: ParticlesSection = ParticlesSection()
    solver: SolverSection = SolverSection()
    motion: Annotated[NoMotion | Leapfrog | RandomWalk, Field(discriminator="kind")] = NoMotion()
    schedule: Schedule = Schedule()
    diagnostics: Diagnostics = Diagnostics()
    output: Output = Output()

    @property
    def reference(self) -> Reference | None:
        """The reference particle at the start, if there is one."""
        motion = self.motion
        if not isinstance(motion, Leapfrog) or motion.reference is not None or motion.window == "none":
            return motion.reference if isinstance(motion, Leapfrog) else None
        first = self.bunches[0] if self.bunches else None
        if not isinstance(first, DescribedBunch):
            return None
        places = first.places() or [self.domain.lower, self.domain.upper]
        x, y, z = np.mean(places, axis=0).tolist()
        return Reference(species=first.species, momentum=first.mean_momentum, position=(x, y, z))

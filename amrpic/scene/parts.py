"""The parts of a scene, each checked by itself."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Annotated, ClassVar, Literal

import numpy as np
from pydantic import Field

from ..mesh.domain import AXES
from ..mesh.mirror import SIGNS
from ..mesh.window import vector
from .any_scene import AnyScene
from .bunch_files import ArrayBunch, OpenPMDBunch
from .bunch_shapes import GaussianBunch, HaloBunch, HollowBunch, KVBunch, ParabolicBunch, SphereBunch, WaterbagBunch
from .bunches import DescribedBunch, LatticeBunch
from .domain_section import DomainSection
from .electrodes import ApertureMetal, ElectrodeSection, apertures_of_metal
from .elements import AnyElement
from .injection import AnySource
from .lattice_file import LatticeSection
from .motion import Motion, NoMotion, Reference
from .obstacles import AnyAperture, Screen
from .refinement import Refinement
from .run_sections import Diagnostics, Output, ParticlesSection, Schedule
from .solver_options import SolverSection
from .thermal_bunch import ThermalBunch

OF_POINTS = ("faces", "points", "structure", "materials", "gravity", "floor_stiffness")  # keys of amrpic.mpm.Scene


class SceneParts(AnyScene):
    """What a scene is made of; `fits_together.check` says whether the parts go together."""

    foreign: ClassVar[Mapping[str, str]] = dict.fromkeys(
        (*OF_POINTS, "method"), 'it is for material points: begin the file with method = "mpm", or leave it out'
    )

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
    sources: list[AnySource] = Field(default=[], description="Surfaces from which particles come over time.")
    elements: list[AnyElement] = Field(
        default=[], description="Magnets, cavities and other fields along the beam line."
    )
    lattice: LatticeSection | None = Field(
        default=None,
        description="A lattice of another code, a file or a section: its elements, apertures and screens join those of the "
        "scene, which then names none.",
    )
    electrodes: list[ElectrodeSection] = Field(
        default=[], description="Metal of any shape, at voltages or with charges; it does not move."
    )
    apertures: list[AnyAperture] = Field(
        default=[], description="Solids, or holes in them, at which particles are lost."
    )
    screens: list[Screen] = Field(default=[], description="Planes where particles are recorded as they pass.")
    refinement: Refinement = Refinement()
    particles: ParticlesSection = ParticlesSection()
    solver: SolverSection = SolverSection()
    motion: Annotated[Motion, Field(discriminator="kind")] = NoMotion()
    schedule: Schedule = Schedule()
    diagnostics: Diagnostics = Diagnostics()
    output: Output = Output()

    @property
    def reference(self) -> Reference | None:
        """The reference particle at the start, if there is one."""
        motion = self.motion
        if motion.reference is not None or motion.window == "none":
            return motion.reference
        first = self.bunches[0] if self.bunches else None
        if not isinstance(first, DescribedBunch):
            return None
        places = first.places() or [self.domain.lower, self.domain.upper]
        momentum = np.array(first.mean_momentum)
        if isinstance(first, ArrayBunch):
            momentum = momentum @ first.axes
        return Reference(species=first.species, momentum=vector(momentum), position=vector(np.mean(places, axis=0)))

    @property
    def conductors(self) -> list[ElectrodeSection | ApertureMetal]:
        """What the field ends on: the electrodes, and behind them apertures of metal."""
        return [*self.electrodes, *apertures_of_metal(self.apertures, self.domain.lower, self.domain.upper)]

    @property
    def fixes_no_potential(self) -> bool:
        """Whether a net charge has no potential: no face and no electrode has one."""
        fixed = any(conductor.voltage is not None for conductor in self.conductors)
        return self.domain.value.singular and self.solver.screening == 0 and not fixed

    @property
    def window_axis(self) -> int | None:
        """The axis that the window starts along, if there is one."""
        reference = self.reference
        if self.motion.window == "none" or reference is None:
            return None
        return int(np.argmax(np.abs(reference.mean_momentum)))

    @property
    def axis_of_wall_left(self) -> int | None:
        """The axis along which the window leaves a wall behind; None if it leaves none."""
        axis = self.window_axis
        return axis if axis is not None and set(self.domain.boundary[AXES[axis]]) & set(SIGNS) else None

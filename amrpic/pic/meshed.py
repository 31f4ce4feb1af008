"""Particles on a mesh, as a step has them before their field is solved for."""

from __future__ import annotations

from dataclasses import dataclass

from ..mesh.field import Field
from ..mesh.hierarchy import Hierarchy
from ..particles.energy_bins import Frames
from ..particles.particles import Particles
from ..space_charge.drive import NO_ELECTRODES, Drive
from ..stages.deposit import Deposition
from ..stages.migrate import migrate, shared_out_by_work
from .setup import Setup
from .solution import Solution


@dataclass(frozen=True, eq=False)
class MeshedParticles:
    """Particles that are sorted on a hierarchy, the frames of their field, and what there is of this field already."""

    particles: Particles
    hierarchy: Hierarchy
    frames: Frames
    deposition: Deposition | None = None  # that has begun
    rho: Field | None = None  # that a rule of refinement asked for, C/m³
    solution: Solution | None = None  # likewise
    drive: Drive = NO_ELECTRODES  # electrodes at the time

    def on(self, hierarchy: Hierarchy, setup: Setup) -> MeshedParticles:
        """Return the same particles on another hierarchy. Collective."""
        with setup.clock("migrate"):
            particles, _ = migrate(self.particles, hierarchy, shared_out_by_work(self.particles, hierarchy))
        return MeshedParticles(particles, hierarchy, self.frames, drive=self.drive)


def deposit(beam: MeshedParticles, setup: Setup) -> Field:
    """Return the charge density of all particles, C/m³, unless a rule has asked for it already. Collective."""
    if beam.rho is not None:
        return beam.rho
    with setup.clock("deposit"):
        return (beam.deposition or Deposition(beam.particles, beam.hierarchy, setup.clouds)).density()

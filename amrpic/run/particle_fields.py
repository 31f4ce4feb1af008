"""Fields of the particles on a mesh (ρ, φ, E, particles per cell), each made when it is first asked for."""

from __future__ import annotations

from functools import cached_property

from ..mesh.field import Field, VectorField
from ..mesh.hierarchy import Hierarchy
from ..particles.frame import Frame
from ..particles.particles import Particles
from ..stages.deposit import deposit
from ..stages.migrate import migrate
from ..stages.regrid import carry_over
from ..stages.tag import count
from .plan import Plan


class ParticleFields:
    """Fields of particles that are sorted on a hierarchy. All ranks ask for the same ones: the first time is collective.

    Potential and field are carried over from `known`, those of the step before; without it they are solved for, in `frame`, by
    default that of the particles. Collective to make.
    """

    def __init__(
        self,
        particles: Particles,
        hierarchy: Hierarchy,
        plan: Plan,
        known: tuple[Field, VectorField] | None = None,
        frame: Frame | None = None,
    ) -> None:
        self.particles, self.hierarchy, self.plan, self.known = particles, hierarchy, plan, known
        self.frame = frame if frame is not None else plan.frame(particles)

    def on(self, hierarchy: Hierarchy) -> ParticleFields:
        """Return the fields of the same particles on another hierarchy. Collective."""
        with self.plan.clock("migrate"):
            particles, _ = migrate(self.particles, hierarchy)
        return ParticleFields(particles, hierarchy, self.plan, self.known, self.frame)

    @cached_property
    def rho(self) -> Field:
        """Charge density, C/m³."""
        with self.plan.clock("deposit"):
            return deposit(self.particles, self.hierarchy, self.plan.clouds)

    @cached_property
    def phi(self) -> Field:
        """Potential, V."""
        if self.known is not None:
            return self._carried(self.known[0])
        rho = self.rho
        with self.plan.clock("solve"):
            return self.plan.solve(rho, None, self.frame)[0]

    @cached_property
    def efield(self) -> VectorField:
        """Electric field, V/m."""
        if self.known is not None:
            x, y, z = map(self._carried, self.known[1].components)
            return VectorField(x, y, z)
        phi = self.phi
        with self.plan.clock("solve"):
            return self.plan.poisson(self.hierarchy, self.frame).deferred_field(phi)

    @cached_property
    def particles_per_cell(self) -> Field:
        """Macroparticles in each cell, in covered cells those of their children."""
        return count(self.particles, self.hierarchy)

    @property
    def guess(self) -> Field | None:
        """A potential to start a solve from, if one is known."""
        with self.plan.clock("regrid"):
            return self.phi if self.known is not None or "phi" in vars(self) else None

    def _carried(self, field: Field) -> Field:
        return field if field.hierarchy is self.hierarchy else carry_over(field, self.hierarchy)

"""The state of a run between two steps."""

from __future__ import annotations

from dataclasses import dataclass, field

from ..mesh.field import Field, VectorField
from ..mesh.hierarchy import Hierarchy
from ..mesh.window import Window
from ..particles.particles import Particles
from ..run.clock import Spent
from ..stages.beam_diagnostics import Beam
from ..stages.diagnostics import Moments, moments
from ..stages.poisson import SolveReport
from .course import Course
from .records import Record
from .solution import Solution
from .staggered import Staggered
from .tallies import Tallies


@dataclass(frozen=True, eq=False)
class State:
    """Everything that a step starts from; positions and fields belong to the same time. Made by `begin` and `advance`."""

    staggered: Staggered  # the particles, and where they go next
    solution: Solution
    lost: Record  # at faces of the domain and at apertures
    screens: Record  # as they passed these
    tallies: Tallies  # of the scene's sources
    course: Course
    step: int
    time: float  # s
    longest: float = 0.0  # s, that a step may take, as it was looked at last; that of all steps where they are equal
    regridded: bool = False  # whether the latest step changed the mesh
    spent: dict[str, Spent] = field(default_factory=dict)  # on the stages of the latest step, by this rank

    @property
    def particles(self) -> Particles:
        """Sorted on the hierarchy; their momenta lag positions where `staggered` says so."""
        return self.staggered.particles

    @property
    def synchronized(self) -> Particles:
        """The particles with momenta of the time of the state, to rounding; made anew each time."""
        return self.staggered.synchronized

    @property
    def beam(self) -> Beam:
        """The particles with what gives their momenta at the time of the state."""
        return self.staggered.beam

    @property
    def hierarchy(self) -> Hierarchy:
        """The mesh."""
        return self.solution.rho.hierarchy

    @property
    def window(self) -> Window:
        """Where the mesh is in the laboratory."""
        return self.course.window

    @property
    def rho(self) -> Field:
        """Charge density of the particles, C/m³."""
        return self.solution.rho

    @property
    def phi(self) -> Field:
        """Potential, V, with that of what walls hold."""
        return self.solution.potential

    @property
    def efield(self) -> VectorField:
        """Electric field, V/m, with that of what walls hold."""
        return self.solution.electric

    @property
    def report(self) -> SolveReport:
        """How the solve went."""
        return self.solution.report

    @property
    def seconds(self) -> dict[str, float]:
        """What the stages of the latest step took on this rank, s."""
        return {stage: spent.seconds for stage, spent in self.spent.items()}

    def moments(self) -> Moments:
        """Return the moments of the particles at the time of the state. Collective."""
        beam, hierarchy = self.beam, self.hierarchy
        return moments(hierarchy.comm, beam.particles, beam.later, beam.weight, hierarchy.domain)

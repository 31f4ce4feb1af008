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
from .leapfrog import Staggered
from .records import Record
from .solution import Solution


@dataclass(frozen=True, eq=False)
class State:
    """Everything that a step starts from; positions and fields belong to the same time. Made by `step.state_of`."""

    particles: Particles  # sorted on the hierarchy; their momenta lag positions where `staggered` says so
    staggered: Staggered | None  # None without leapfrog: then momenta belong to the time of positions
    solution: Solution
    lost: Record  # at faces of the domain and at apertures
    screens: Record  # as they passed these
    course: Course
    step: int
    time: float  # s
    regridded: bool = False  # whether the latest step changed the mesh
    spent: dict[str, Spent] = field(default_factory=dict)  # on the stages of the latest step, by this rank

    @property
    def hierarchy(self) -> Hierarchy:
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

    @property
    def synchronized(self) -> Particles:
        """The particles with momenta of the time of the state, to rounding; made anew each time."""
        return self.particles if self.staggered is None else self.staggered.synchronized(self.particles)

    @property
    def lag(self) -> float:
        """By how much momenta of `particles` lag the state's time, s, where they say more than those of its own time."""
        return self.staggered.lag if self.staggered is not None and self.staggered.between is not None else 0.0

    @property
    def flight(self) -> float:
        """How long the flight to the next state takes, s; 0 without leapfrog."""
        return self.staggered.flight if self.staggered is not None else 0.0

    @property
    def beam(self) -> Beam:
        """The particles with what gives their momenta at the time of the state."""
        staggered = self.staggered
        if staggered is None or staggered.between is not None:
            now = self.synchronized
            return Beam(now, now)
        return Beam(self.particles, staggered.moved, 0.5 if staggered.lag > 0 else 0.0)

    def moments(self) -> Moments:
        """Return the moments of the particles at the time of the state. Collective."""
        beam, hierarchy = self.beam, self.hierarchy
        return moments(hierarchy.comm, beam.particles, beam.later, beam.weight, hierarchy.domain)

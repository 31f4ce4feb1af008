"""The state of a run between two steps."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from ..io.provenance import Moment
from ..mesh.field import Field, VectorField
from ..mesh.hierarchy import Hierarchy
from ..mesh.window import Window
from ..particles.arrays import empty_columns
from ..particles.particles import Particles
from ..run.clock import Spent
from ..stages.beam_diagnostics import Beam
from ..stages.diagnostics import Moments, moments
from ..stages.poisson import SolveReport
from .course import Course
from .records import Record
from .solution import Solution
from .tallies import Tallies


@dataclass(frozen=True, eq=False)
class Staggered:
    """The particles of a state, by how much their momenta lag positions, and where they go next.

    Momenta of `particles` lag the state's time by `lag` (0, or half of the step before), those of `moved` lead it by Δt/2.
    Without a magnetic field, elements or fields from Python those of the state's time lie between both; with them they are
    kept, as `between`.
    Where motion follows no field nothing lags, and `moved` are the particles as they are.
    """

    particles: Particles  # sorted on the mesh
    moved: Particles  # after the kick by `lag` + Δt/2 and a drift by Δt; not sorted; from the origin of the next window
    course: Course  # then
    lag: float = 0.0  # s
    flight: float = 0.0  # s, of that drift: Δt, and Δt/2 without a kick at the start of drift, kick, drift
    between: np.ndarray | None = None  # (n, 3) kg m/s
    dt: float = 0.0  # s, of the step that begins: Δt

    @property
    def synchronized(self) -> Particles:
        """The particles with momenta of the time of their positions, to rounding; made anew each time."""
        if self.lag == 0:
            return self.particles
        if self.between is not None:
            return self.particles.replace(momentum=self.between)
        lagging, out = self.particles.momentum, empty_columns(len(self.particles))
        np.subtract(self.moved.momentum, lagging, out=out)
        out *= self._part_behind
        out += lagging
        return self.particles.replace(momentum=out)

    @property
    def beam(self) -> Beam:
        """The particles with what gives their momenta at the time of their positions."""
        if self.between is not None:
            now = self.synchronized
            return Beam(now, now)
        return Beam(self.particles, self.moved, self._part_behind)

    @property
    def _part_behind(self) -> float:
        """Which part of the kick lies before the time of positions."""
        return self.lag / (self.lag + self.dt / 2) if self.lag > 0 else 0.0

    @property
    def lag_to_keep(self) -> float:
        """The lag, s, if momenta of the particles say more than those of the time of positions: a checkpoint keeps both."""
        return 0.0 if self.between is None else self.lag


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
    def moment(self) -> Moment:
        """Step, time and window, as files have them."""
        return Moment(self.step, self.time, self.window)

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

"""One time step as a composition of the stages, and the state before the first one."""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np
from mpi4py import MPI

from ..errors import InputError
from ..mesh.field import Field, VectorField
from ..mesh.hierarchy import Hierarchy
from ..particles.arrays import empty_columns
from ..particles.particles import Particles, concatenate
from ..scene.motion import Leapfrog, RandomWalk
from ..stages.migrate import migrate
from ..stages.poisson import SolveReport
from ..stages.push import push, random_walk
from .adapt import follow, make_base, outrun
from .initial_particles import make_bunches
from .particle_fields import Quantities
from .plan import Plan


@dataclass(frozen=True, eq=False)
class Lost:
    """Particles that left the domain, as they were when they did, and the time (n,) in s. This rank's share."""

    particles: Particles
    time: np.ndarray

    def joined(self, particles: Particles, now: float) -> Lost:
        """Return these and those that are lost now."""
        if len(particles) == 0:
            return self
        times = np.concatenate([self.time, np.full(len(particles), now)])
        return Lost(concatenate([self.particles, particles]), times)


@dataclass(frozen=True, eq=False)
class State:
    """Everything that a step starts from; positions and fields belong to the same time.

    The momenta of `particles` are those of `behind` s before, with which they came here, half a step or none; those of `moved`
    are half a step later. Momenta of the time itself are not kept, but see `synchronized` and `kicked`.
    """

    particles: Particles  # sorted on the hierarchy
    hierarchy: Hierarchy
    rho: Field  # of the particles, C/m³; without a neutralizing background
    phi: Field  # V
    efield: VectorField  # V/m
    moved: Particles | None  # after the kick and a drift, not sorted, where motion asks for them
    lost: Lost
    step: int
    time: float  # s
    report: SolveReport
    regridded: bool = False  # whether the latest step changed the mesh
    seconds: dict[str, float] = field(default_factory=dict)  # of the stages of the latest step, on this rank
    behind: float = 0.0  # s

    @property
    def share(self) -> float:
        """How far momenta of the time of the state are on the way from those of `particles` to those of `moved`."""
        return 0.5 if self.behind > 0 else 0.0

    @property
    def synchronized(self) -> Particles:
        """The particles with momenta of the time of the state, to rounding; made anew each time."""
        if self.moved is None or self.share == 0:
            return self.particles
        early, out = self.particles.momentum, empty_columns(len(self.particles))
        np.subtract(self.moved.momentum, early, out=out)
        out *= self.share
        out += early
        return self.particles.replace(momentum=out)


def advance(state: State, plan: Plan) -> State:
    """Return the state one step later. Collective.

    Leapfrog in its kick, drift, kick form: half a kick with the field that the particles start in, a drift, and half a kick
    with the field that they arrive in. The latter is taken together with the first one of the step after.
    """
    step, now = state.step + 1, state.time + plan.dt
    with plan.clock("push"):
        moved = set_off(state, plan)
    with plan.clock("migrate"):
        particles, gone = migrate(moved, state.hierarchy)
    seen = Quantities(particles, state.hierarchy, plan, (state.phi, state.efield))
    if plan.regrids_at(step) or outrun(seen):
        seen = follow(seen, plan.scene.refinement.hysteresis)
    state = replace(state, lost=state.lost.joined(gone, now), step=step, time=now)
    return arrive(with_field(state, seen), plan)


def begin(plan: Plan) -> State:
    """Return the state before the first step: particles made, mesh refined to fit them, field solved. Collective."""
    base = make_base(plan)
    with plan.clock("beam"):
        bunches = make_bunches(plan.comm, plan.scene)
        plan.settle_interface(bunches)
        made = concatenate(bunches)
        particles, gone = migrate(made, base)
    _require_some_inside(plan.comm, particles, made)
    seen = follow(Quantities(particles, base, plan))
    lost = Lost(Particles.empty(made.species), np.zeros(0)).joined(gone, 0.0)
    nothing = Field(seen.hierarchy)
    unsolved = SolveReport(False, 0, [], {}, "not solved yet", 0.0)
    none = VectorField(nothing, nothing, nothing)
    state = State(seen.particles, seen.hierarchy, nothing, nothing, none, None, lost, 0, 0.0, unsolved)
    state = with_field(state, seen)
    return replace(accelerated(state, plan, 0.0), seconds=plan.clock.take())


def set_off(state: State, plan: Plan) -> Particles:
    """Return the particles after the first part of their motion, at their new places."""
    motion = plan.scene.motion
    match motion:
        case Leapfrog():
            assert state.moved is not None
            return state.moved
        case RandomWalk():
            return random_walk(state.particles, motion.amplitude, plan.scene.seed, state.step + 1)
    return state.particles


def arrive(state: State, plan: Plan) -> State:
    """Return the state after the last part of the motion, in the new field. Collective."""
    return replace(accelerated(state, plan, plan.dt / 2), seconds=plan.clock.take())


def with_field(state: State, seen: Quantities) -> State:
    """Return the state with what is seen now and the field of that. Collective.

    Raises SolverError if the solve does not converge.
    """
    plan, rho = seen.plan, seen.rho
    with plan.clock("solve"):
        phi, report = plan.solve(rho, seen.guess)
        efield = plan.poisson(seen.hierarchy).deferred_field(phi, covered=plan.clouds.covered)
    regridded = seen.hierarchy is not state.hierarchy
    state = replace(state, particles=seen.particles, hierarchy=seen.hierarchy, regridded=regridded)
    return replace(state, rho=rho, phi=phi, efield=efield, report=report)


def accelerated(state: State, plan: Plan, behind: float) -> State:
    """Return the state with where the particles are next, if there is motion by its field. Collective.

    Their momenta are those of `behind` s before.
    """
    if not isinstance(plan.scene.motion, Leapfrog):
        return state
    with plan.clock("gather"):
        moved = push(state.efield, state.particles, behind, plan.dt / 2, plan.dt, plan.clouds)
    return replace(state, moved=moved, behind=behind)


def kicked(state: State, plan: Plan) -> State:
    """Return the state with particles whose momenta are of its own time. Collective.

    In all digits those on the way to `moved`: a run that is started with them goes on as it would have.
    """
    if state.behind == 0:
        return state
    after_kick = push(state.efield, state.particles, state.behind, 0.0, 0.0, plan.clouds)
    return replace(state, particles=state.particles.replace(momentum=after_kick.momentum), behind=0.0)


def _require_some_inside(comm: MPI.Comm, inside: Particles, made: Particles) -> None:
    total, left = made.global_count(comm), inside.global_count(comm)
    if total > 0 and left == 0:
        raise InputError(f"all {total} particles of the scene lie outside the domain; move the bunches or enlarge it")

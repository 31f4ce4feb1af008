"""One time step as a composition of the stages, and the state before the first one."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from mpi4py import MPI

from ..errors import InputError
from ..mesh.domain import Domain
from ..mesh.window import part_of
from ..particles.particles import Particles
from ..run.clock import Spent
from ..scene.motion import Leapfrog, RandomWalk
from ..stages.push import random_walk
from .adapt import follow, make_base, outrun
from .course import Course
from .flight import fly, place
from .image_forces import frames_with_images
from .initial_particles import make_bunches, start_of
from .leapfrog import kick_and_drift
from .particle_fields import ParticleFields
from .plan import Plan
from .records import Record
from .solution import Solution
from .state import State
from .time_step import check_time_step, settle_time_step


def advance(state: State, plan: Plan) -> State:
    """Return the state one step later. Collective; SolverError if the solve does not converge."""
    step, now = state.step + 1, state.time + state.flight
    course = state.course if state.staggered is None else state.staggered.course
    with plan.clock("push"):
        moved = _moved(state, plan)
    with plan.clock("migrate"):
        particles, deposition, lost, screens = fly(state, moved, course.window, plan)
    turn = state.window.turn_to(course.window)
    behind = None if turn is None else part_of(turn.T, plan.dt / 2 / state.flight)  # momenta are, of the latest turn
    frames = plan.frames(particles, frames_with_images(state, plan), lost.particles, behind, course.window)
    fields = ParticleFields(particles, state.hierarchy, plan, state.solution, frames, deposition)
    if plan.scene.refinement.regrids_at(step) or outrun(fields):
        fields = follow(fields, plan.scene.refinement.hysteresis)
    check_time_step(fields, step)
    # Boxes may be cut anew without another cell, as after a restart on other ranks.
    regridded = fields.hierarchy is not state.hierarchy and not fields.hierarchy.same_cells(state.hierarchy)
    return state_of(plan, fields.particles, fields.solution, lost, screens, course, step, now, plan.dt / 2, regridded)


def begin(plan: Plan) -> State:
    """Return the state before the first step: particles made, mesh refined to fit them, field solved. Collective."""
    base, course = make_base(plan), Course.of_scene(plan.scene)
    with plan.clock("beam"):
        bunches = [bunch.seen_from(course.window) for bunch in make_bunches(plan.comm, plan.scene)]
        plan.settle_clouds(bunches)
        made = plan.comm.allreduce(sum(map(len, bunches)))
        for sentence in _require_mostly_inside(plan.comm, bunches, base.domain):
            plan.remark(sentence)
        start, notes = start_of(plan.comm, plan.scene)
        for sentence in notes:
            plan.note(sentence)
        particles, lost, screens = place(bunches, base, course.window, plan, start)
    _require_some_inside(plan.comm, particles, made)
    fields = follow(ParticleFields(particles, base, plan))
    settle_time_step(fields, course)
    return state_of(plan, fields.particles, fields.solution, lost, screens, course, 0, start)


def state_of(
    plan: Plan,
    particles: Particles,
    solution: Solution,
    lost: Record,
    screens: Record,
    course: Course,
    step: int,
    time: float,
    lag: float = 0.0,
    regridded: bool = False,
) -> State:
    """Return the state of particles and the field that was solved for them. Collective.

    Under leapfrog their momenta lag positions by `lag` s, and the state holds where they go next.
    """
    staggered = None
    if isinstance(plan.scene.motion, Leapfrog):
        with plan.clock("gather"):
            staggered = kick_and_drift(solution, particles, lag, step, time, course, plan)
    return State(particles, staggered, solution, lost, screens, course, step, time, regridded, plan.clock.take())


def with_momenta(state: State, momentum: np.ndarray, plan: Plan) -> State:
    """Return the state with particles of other momenta (n, 3) in kg m/s, at its own time. Collective."""
    particles = state.particles.replace(momentum=momentum)
    if state.staggered is None:
        return replace(state, particles=particles)
    out = state_of(
        plan,
        particles,
        state.solution,
        state.lost,
        state.screens,
        state.course,
        state.step,
        state.time,
        regridded=state.regridded,
    )
    spent = {stage: state.spent.get(stage, Spent()) + more for stage, more in out.spent.items()}
    return replace(out, spent={**state.spent, **spent})


def _moved(state: State, plan: Plan) -> Particles:
    """Return the particles at their next places, not yet sorted there."""
    if state.staggered is not None:
        moved, turn = state.staggered.moved, state.window.turn_to(state.staggered.course.window)
        return moved if turn is None else moved.turned(turn)
    motion = plan.scene.motion
    if isinstance(motion, RandomWalk):
        return random_walk(state.particles, motion.amplitude, plan.scene.seed, state.step + 1)
    return state.particles


def _require_mostly_inside(comm: MPI.Comm, bunches: Sequence[Particles], domain: Domain) -> list[str]:
    """Return a sentence for each bunch of which particles are outside. Collective.

    Raises InputError on all ranks if more than half of a bunch, but not all of all, are.
    """
    walls = ~np.array(domain.periodic)
    lower, upper = np.array(domain.lower)[walls], np.array(domain.upper)[walls]
    counts = [
        (len(one), int(((one.position[:, walls] < lower) | (one.position[:, walls] > upper)).any(axis=1).sum()))
        for one in bunches
    ]
    of_all = comm.allreduce(np.array(counts, dtype=np.int64).reshape(-1, 2))
    worst = int(np.argmax(2 * of_all[:, 1] - of_all[:, 0]))
    made, outside = of_all[worst].tolist()
    if 2 * outside > made and of_all[:, 1].sum() < of_all[:, 0].sum():
        raise InputError(
            f"{outside} of {made} particles of bunch {worst} of {len(bunches) - 1} lie outside the domain; "
            "move the bunch (one from a file by its shift), make it smaller, or enlarge the domain"
        )
    return [
        f"{outside} of {made} particles of bunch {number} of {len(bunches) - 1} lie outside the domain at the start: lost"
        for number, (made, outside) in enumerate(of_all.tolist())
        if 0 < outside < made
    ]


def _require_some_inside(comm: MPI.Comm, inside: Particles, made: int) -> None:
    if made > 0 and inside.global_count(comm) == 0:
        raise InputError(
            f"all {made} particles of the scene lie outside the domain; move the bunches (those from files by "
            "their shift) or enlarge it"
        )

"""One time step as a composition of the stages, and the state before the first one."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from ..mesh.hierarchy import Hierarchy
from ..mpi import MPI
from ..run.clock import Spent
from ..scene.scene import Scene
from .adapt import follow, make_base, regrid_if_due
from .births import births
from .course import Course
from .field_functions import FieldFunction
from .flight import Arrived, migrate, place
from .frames import first_frames, next_frames
from .initial_particles import make_bunches, outside, require_some_inside, start_of
from .leapfrog import gather_and_push
from .meshed import MeshedParticles, deposit
from .metal_images import check_images
from .setup import Setup, resolved, set_up
from .solve import solve
from .state import State
from .time_step import check_time_step, next_step, with_time_step


def advance(state: State, setup: Setup) -> State:
    """Return the state one step later. Collective; SolverError if the solve does not converge."""
    step, time, course = state.step + 1, state.time + state.staggered.flight, state.staggered.course
    with setup.clock("push"):
        moved = setup.move(state)
    born = births(state, setup)
    with setup.clock("migrate"):
        arrived = migrate(state, moved, born, setup)
    frames = next_frames(state, arrived.particles, arrived.lost.particles, setup)
    drive = setup.drive(time, course.window, arrived.lost)
    beam = MeshedParticles(arrived.particles, state.hierarchy, frames, arrived.deposition, drive=drive)
    beam = regrid_if_due(beam, state, setup)
    rho = deposit(beam, setup)
    solution = solve(beam, rho, state.solution, setup)
    lag, dt, goal = state.staggered.dt / 2, *next_step(state, beam, solution, course, setup)
    check_time_step(beam, solution, step, dt, setup)
    check_images(beam, solution, step, setup)
    staggered = gather_and_push(solution, beam.particles, lag, dt, step, time, course, setup)
    # Boxes may be cut anew without another cell, as after a restart on other ranks.
    regridded = beam.hierarchy is not state.hierarchy and not beam.hierarchy.same_cells(state.hierarchy)
    return State(staggered, solution, *arrived.records, course, step, time, goal, regridded, setup.clock.take())


def begin(comm: MPI.Comm, scene: Scene, fields: Sequence[FieldFunction] = ()) -> tuple[State, Setup]:
    """Return the state before the first step, and the set-up of steps. Collective; InputError, SolverError on all ranks."""
    setup = set_up(comm, scene, fields)
    course = Course.of_scene(scene, setup.emitters)
    base = make_base(setup.comm, scene)
    with setup.clock("beam"):
        arrived, start, setup = _made(base, course, setup)
    frames, drive = first_frames(arrived.particles, setup), setup.drive(start, course.window, arrived.lost)
    beam = MeshedParticles(arrived.particles, base, frames, drive=drive)
    beam = follow(beam, None, setup)
    rho = deposit(beam, setup)
    solution = solve(beam, rho, None, setup)
    check_images(beam, solution, 0, setup)
    setup = with_time_step(setup, beam, solution, course)
    staggered = gather_and_push(solution, beam.particles, 0.0, setup.dt, 0, start, course, setup)
    return State(staggered, solution, *arrived.records, course, 0, start, setup.dt, spent=setup.clock.take()), setup


def _made(base: Hierarchy, course: Course, setup: Setup) -> tuple[Arrived, float, Setup]:
    """Return the particles of a scene in their places on its base level, their time (s), and the set-up with clouds for them.
    Collective; InputError on all ranks.
    """
    bunches = [bunch.seen_from(course.window) for bunch in make_bunches(setup.comm, setup.scene)]
    setup = resolved(setup, bunches)
    count = setup.comm.allreduce(sum(map(len, bunches)))
    for sentence in outside(setup.comm, bunches, base.domain):
        setup.remarks.remark(sentence)
    start, notes = start_of(setup.comm, setup.scene)
    for sentence in notes:
        setup.remarks.note(sentence)
    for name, emitter in zip(setup.scene.source_names, setup.emitters, strict=True):
        first, missed = emitter.before(start)
        if missed > 0:
            setup.remarks.remark(
                f"{missed:.3g} of the charge of {name} would be born before the run starts at {start:g} s, the first at "
                f"{first:g} s, and is not; set schedule.start to that, or let the source begin later"
            )
    arrived = place(bunches, base, course.window, start, setup)
    require_some_inside(setup.comm, arrived.particles, count)
    return arrived, start, setup


def with_momenta(state: State, momentum: np.ndarray, setup: Setup) -> State:
    """Return the state with particles of other momenta (n, 3) in kg m/s, at its own time. Collective."""
    particles = state.particles.replace(momentum=momentum)
    dt, course = state.staggered.dt, state.course
    staggered = gather_and_push(state.solution, particles, 0.0, dt, state.step, state.time, course, setup)
    spent = {stage: state.spent.get(stage, Spent()) + more for stage, more in setup.clock.take().items()}
    return replace(state, staggered=staggered, spent={**state.spent, **spent})

"""Leapfrog: momenta that are staggered in time against positions.

In the form kick, drift, kick the second half kick of a step and the first one of the next use the same field, so they are taken
together. In the form drift, kick, drift two half drifts are: it is the same loop, after half a drift without a kick. Its states
are those of the middle of a kick, where positions, field and momenta are of one time.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from .. import _native
from ..particles.arrays import empty_columns
from ..particles.clouds import Clouds
from ..particles.frame import LABORATORY
from ..particles.particles import Particles
from ..stages.gather import gather
from ..stages.push import push
from ..units import SPEED_OF_LIGHT
from .course import Course
from .setup import Setup
from .solution import Solution
from .state import Staggered, State


def gather_and_push(
    solution: Solution,
    particles: Particles,
    lag: float,
    dt: float,
    step: int,
    time: float,
    course: Course,
    setup: Setup,
) -> Staggered:
    """Return where particles go whose momenta lag positions by `lag` s, at `time` s before `step` + 1 of `dt` s. Collective.

    The field is read at each particle, which is kicked and drifts in the same pass. Where motion follows no field there is
    nothing to do.
    """
    motion, fields = setup.scene.motion, setup.fields
    if not motion.follows_fields:
        return Staggered(particles, particles, course)
    drifts_first = motion.form == "drift-kick-drift" and step == 0
    after, flight = (0.0, dt / 2) if drifts_first else (dt / 2, dt)
    later = course.after(flight, time, setup.external, _pusher(solution, setup))
    with setup.clock("push"):
        by_e_alone = solution.frames.only == LABORATORY and not setup.scene.elements and not fields
        between = None if by_e_alone else empty_columns(len(particles))
        external = setup.external.seen_from(course.window).native if setup.scene.elements else None
        of_fields = fields.at(particles, time, course.window) if fields else None
        shift = course.window.shift_to(later.window)
        moved = _push(solution, particles, lag, after, flight, setup, between, external, of_fields, time, shift)
    return Staggered(particles, moved, later, lag, flight, between, dt)


def kick(solution: Solution, particles: Particles, staggered: Staggered, setup: Setup) -> Particles:
    """Return particles of a state, all or some, with momenta of the time of their positions. Collective.

    In all digits those on the way to `moved`; `Staggered.synchronized` has them to rounding, without a pass over the field.
    """
    return particles.replace(momentum=_push(solution, particles, staggered.lag, 0.0, 0.0, setup).momentum)


def kicked(state: State, newborn: Particles, during: np.ndarray, setup: Setup) -> Particles:
    """Return particles, sorted on the mesh of a state, with the momenta that its fields at their places give them `during` (n,)
    s, which may be negative. Collective.
    """
    window, most = state.window, np.abs(during).max(initial=0.0) or 1.0
    fields = setup.external.seen_from(window).fields(newborn.position, state.time) if setup.scene.elements else None
    if setup.fields:
        of_python = setup.fields.at(newborn, state.time, window)
        fields = of_python if fields is None else (fields[0] + of_python[0], fields[1] + of_python[1])
    return _push(state.solution, newborn, float(most), 0.0, 0.0, setup, of_fields=fields, parts=during / most)


def synchronized(state: State, setup: Setup) -> State:
    """Return the state whose `synchronized` particles have the momenta of its own time in all digits. Collective."""
    staggered = state.staggered
    if staggered.lag == 0 or staggered.between is not None:
        return state
    particles = kick(state.solution, state.particles, staggered, setup)
    return replace(state, staggered=replace(staggered, particles=particles, lag=0.0))


def momenta_of(state: State, chosen: np.ndarray, setup: Setup) -> np.ndarray:
    """Return the momenta (m, 3) of some particles, ascending, as `synchronized` has them for all. Collective."""
    staggered, few = state.staggered, state.particles.ascending(chosen)
    if staggered.lag == 0:
        return few.momentum
    if staggered.between is not None:
        return staggered.between[chosen]
    return kick(state.solution, few, staggered, setup).momentum


def felt(solution: Solution, particles: Particles, clouds: Clouds) -> tuple[np.ndarray, np.ndarray]:
    """Return E (V/m) and B (T), (n, 3), of a solution at particles, as a push has them. Collective."""
    electric = gather(solution.efield, particles, clouds)
    if solution.magnetic is not None:
        magnetic = gather(solution.magnetic, particles, clouds)
    else:
        magnetic = np.cross(solution.beta, electric) / SPEED_OF_LIGHT
    if solution.walls is not None:
        electric += gather(solution.walls[1], particles, clouds)
    if solution.images is not None:
        of_images = felt(solution.images, particles, clouds)
        electric, magnetic = electric + of_images[0], magnetic + of_images[1]
    return electric, magnetic


def _push(
    solution: Solution,
    particles: Particles,
    before: float,
    after: float,
    dt: float,
    setup: Setup,
    between: np.ndarray | None = None,
    external: _native.ExternalFields | None = None,
    of_fields: tuple[np.ndarray, np.ndarray] | None = None,
    time: float = 0.0,
    shift: tuple[float, float, float] = (0.0, 0.0, 0.0),
    parts: np.ndarray | None = None,
) -> Particles:
    electric, magnetic = of_fields if of_fields is not None else (None, None)
    if solution.walls is not None:
        electric = _sum(electric, gather(solution.walls[1], particles, setup.clouds))
    if solution.magnetic is not None:
        magnetic = _sum(magnetic, gather(solution.magnetic, particles, setup.clouds))
    if solution.images is not None:
        of_images = felt(solution.images, particles, setup.clouds)
        electric = _sum(electric, of_images[0])
        if solution.images.frames.only != LABORATORY:
            magnetic = _sum(magnetic, of_images[1])
    if solution.layers:
        electric = np.zeros((len(particles), 3)) if electric is None else electric
        for layer in solution.layers.values():
            layer.correct(electric, particles, setup.clouds)
    return push(
        solution.efield,
        particles,
        before,
        after,
        dt,
        setup.clouds,
        pusher=_pusher(solution, setup),
        beta=solution.beta,
        electric=electric,
        magnetic=magnetic,
        between=between,
        external=external,
        time=time,
        shift=shift,
        parts=parts,
    )


def _sum(one: np.ndarray | None, other: np.ndarray) -> np.ndarray:
    return other if one is None else one + other


def _pusher(solution: Solution, setup: Setup) -> str:
    """Return how magnetic fields turn momenta of particles with this self-field.

    Boris's angle counts what E alone would change: of a beam's own E and B, which cancel up to 1/γ² of either, it leaves
    more than that.
    """
    pusher = setup.scene.motion.pusher
    if pusher == "boris" and solution.frames.only != LABORATORY:
        setup.remarks.note("motion.pusher: higuera-cary while the particles have a magnetic field of their own")
        return "higuera-cary"
    return pusher

"""Leapfrog: momenta that are staggered in time against positions.

In the form kick, drift, kick the second half kick of a step and the first one of the next use the same field, so they are taken
together. In the form drift, kick, drift two half drifts are: it is the same loop, after half a drift without a kick. Its states
are those of the middle of a kick, where positions, field and momenta are of one time.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from .. import _native
from ..particles.arrays import empty_columns
from ..particles.clouds import Clouds
from ..particles.frame import LABORATORY
from ..particles.particles import Particles
from ..scene.motion import Leapfrog
from ..stages.gather import gather
from ..stages.push import push
from ..units import SPEED_OF_LIGHT
from .course import Course
from .plan import Plan
from .solution import Solution


@dataclass(frozen=True, eq=False)
class Staggered:
    """Where leapfrog takes the particles of a state next, and by how much their momenta lag positions.

    Momenta of the particles lag the state's time by `lag` (0 or Δt/2), those of `moved` lead it by Δt/2. Without a magnetic
    field, elements or fields from Python those of the state's time are the mean of both; with them they are kept, as `between`.
    """

    moved: Particles  # after the kick by `lag` + Δt/2 and a drift by Δt; not sorted; from the origin of the next window
    course: Course  # then
    lag: float  # s
    flight: float  # s, of that drift: Δt, and Δt/2 without a kick at the start of drift, kick, drift
    between: np.ndarray | None = None  # (n, 3) kg m/s

    def synchronized(self, particles: Particles) -> Particles:
        """Return the particles of the state with momenta of the time of their positions, to rounding."""
        if self.lag == 0:
            return particles
        if self.between is not None:
            return particles.replace(momentum=self.between)
        lagging, out = particles.momentum, empty_columns(len(particles))
        np.subtract(self.moved.momentum, lagging, out=out)
        out *= 0.5
        out += lagging
        return particles.replace(momentum=out)


def kick_and_drift(
    solution: Solution, particles: Particles, lag: float, step: int, time: float, course: Course, plan: Plan
) -> Staggered:
    """Return where particles go whose momenta lag positions by `lag` s, at `time` s before `step` + 1. Collective."""
    by_e_alone = solution.frames.only == LABORATORY and not plan.scene.elements and not plan.fields
    between = None if by_e_alone else empty_columns(len(particles))
    motion = plan.scene.motion
    assert isinstance(motion, Leapfrog)
    drifts_first = motion.form == "drift-kick-drift" and step == 0
    after, flight = (0.0, plan.dt / 2) if drifts_first else (plan.dt / 2, plan.dt)
    then = course.after(flight, time, plan.external, plan.pusher(solution.frames))
    external = plan.external.seen_from(course.window).native if plan.scene.elements else None
    given = plan.fields.at(particles, time, course.window) if plan.fields else None
    shift = course.window.shift_to(then.window)
    moved = _push(solution, particles, lag, after, flight, plan, between, external, given, time, shift)
    return Staggered(moved, then, lag, flight, between)


def kick(solution: Solution, particles: Particles, staggered: Staggered, plan: Plan) -> Particles:
    """Return the particles with momenta of the time of their positions. Collective.

    In all digits those on the way to `moved`; `Staggered.synchronized` has them to rounding, without a pass over the field.
    """
    if staggered.between is not None:
        return particles.replace(momentum=staggered.between)
    return particles.replace(momentum=_push(solution, particles, staggered.lag, 0.0, 0.0, plan).momentum)


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
    plan: Plan,
    between: np.ndarray | None = None,
    external: _native.ExternalFields | None = None,
    given: tuple[np.ndarray, np.ndarray] | None = None,
    time: float = 0.0,
    shift: tuple[float, float, float] = (0.0, 0.0, 0.0),
) -> Particles:
    electric, magnetic = given if given is not None else (None, None)
    if solution.walls is not None:
        electric = _sum(electric, gather(solution.walls[1], particles, plan.clouds))
    if solution.magnetic is not None:
        magnetic = _sum(magnetic, gather(solution.magnetic, particles, plan.clouds))
    if solution.images is not None:
        of_images = felt(solution.images, particles, plan.clouds)
        electric = _sum(electric, of_images[0])
        if solution.images.frames.only != LABORATORY:
            magnetic = _sum(magnetic, of_images[1])
    return push(
        solution.efield,
        particles,
        before,
        after,
        dt,
        plan.clouds,
        pusher=plan.pusher(solution.frames),
        beta=solution.beta,
        electric=electric,
        magnetic=magnetic,
        between=between,
        external=external,
        time=time,
        shift=shift,
    )


def _sum(one: np.ndarray | None, other: np.ndarray) -> np.ndarray:
    return other if one is None else one + other

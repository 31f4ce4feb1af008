"""Images of the charge in walls: where those walls are, how much the images act, and when they no longer count."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from ..errors import InputError
from ..mesh.domain import AXES, FACES, Domain
from ..mesh.mirror import SIGNS, Mirror
from ..mesh.window import Window
from ..parallel import global_sum
from ..particles.clouds import Clouds
from ..particles.energy_bins import Frames
from ..particles.motion_of_charge import charges
from ..particles.particles import Particles
from ..scene.scene import Scene
from ..stages.push import IN_CACHE
from ..units import SPEED_OF_LIGHT
from .leapfrog import felt
from .setup import Setup
from .solution import Solution
from .state import State


def mirrored(frames: Frames, last: Frames, scene: Scene, window: Window) -> Frames:
    """Return the frames with the walls across the motion, as they are from a window. InputError for walls that have no images.

    Images that were given up in the frames of the step before, `last`, stay so.
    """
    domain, axis = scene.domain.value, scene.axis_of_wall_left
    fast = any(member.is_fast for member in frames.members)
    if axis is not None and fast and frames.axis != axis:
        raise InputError(
            f"the window leaves a wall across {AXES[axis]} behind, and particles faster than 0.1 c move along "
            f'{AXES[frames.axis]}, beside it; make the faces of {AXES[axis]} "open", or set motion.window to "none"'
        )
    if axis is None or _is_at_wall(scene, axis, window):
        across = fast and bool(set(domain.boundary[frames.axis]) & set(SIGNS))
        return replace(frames, mirror=Mirror.of_faces(domain, frames.axis) if across else None, leaves=False)
    if last.leaves and last.mirror is not None and not last.mirror.reflects:
        return replace(frames, mirror=Mirror(axis), leaves=True)
    half = domain.spacing[axis] / 2
    mirror = Mirror.of_faces(domain, axis, half * float(np.round(window.origin[axis] / half)))
    _require_behind(mirror, domain)
    return replace(frames, mirror=mirror, leaves=True)


def _is_at_wall(scene: Scene, axis: int, window: Window) -> bool:
    """Whether the window rests at a wall that emits: for charge that is slow there it is a face of the mesh."""
    return window.origin[axis] == 0 and any(source.emits_at(axis) for source in scene.sources)


def _require_behind(mirror: Mirror, domain: Domain) -> None:
    """Raise InputError if the window has come back over the wall that it left."""
    axis, outwards = mirror.axis, (-1, 1)
    for side, (plane, face) in enumerate(zip(mirror.planes, (domain.lower[axis], domain.upper[axis]), strict=True)):
        if plane is not None and (face - plane.place) * outwards[side] > domain.spacing[axis] / 4:
            raise InputError(
                f"the window has come back by {abs(face - plane.place):.3g} m over the wall of {FACES[2 * axis + side]}, which "
                'it left behind; end the run before, or set motion.window to "none" and give the domain the length of the way'
            )


EVERY = 16  # steps from one look at how much images act to the next
WEAK = 1e-4  # of the charge's own force on itself, below which images in a wall left behind are given up


def frames_with_images(state: State, setup: Setup) -> Frames:
    """Return the frames of a state's field, without the wall left behind once images in it no longer count. Collective."""
    solution, particles = state.solution, state.particles
    frames, images, mirror = solution.frames, solution.images, solution.frames.mirror
    if images is None or mirror is None or not frames.leaves or (state.step + 1) % EVERY > 0:
        return frames
    of_images, own = (rms_force(part, particles, setup.clouds) for part in (images, replace(solution, images=None)))
    if of_images >= WEAK * own:
        return frames
    setup.remarks.remark(
        f"images of the charge in the wall across {AXES[mirror.axis]} that the window left behind act with "
        f"{of_images / own:.1e} of the charge's own force at step {state.step}, less than {WEAK:g}, and are left out from "
        "then on"
    )
    return replace(frames, mirror=Mirror(mirror.axis))


def rms_force(solution: Solution, particles: Particles, clouds: Clouds) -> float:
    """Return the root mean square over the charge of the force of a solution, over the charge, V/m. Collective."""
    electric, magnetic = felt(solution, particles, clouds)
    weight, sums = charges(particles), np.zeros(2)
    for first in range(0, len(particles), IN_CACHE):
        chunk = slice(first, first + IN_CACHE)
        u = particles.momentum[chunk] / (particles.mass[chunk] * SPEED_OF_LIGHT)[:, None]
        velocity = SPEED_OF_LIGHT * u / np.sqrt(1 + (u**2).sum(axis=1))[:, None]
        force = electric[chunk] + np.cross(velocity, magnetic[chunk])
        sums += weight[chunk] @ (force**2).sum(axis=1), weight[chunk].sum()
    square, total = (global_sum(solution.rho.comm, value) for value in sums)
    return math.sqrt(square / total) if total > 0 else 0.0

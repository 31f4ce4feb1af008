"""How much images of the charge act, and when they no longer count."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from ..mesh.domain import AXES
from ..mesh.mirror import Mirror
from ..parallel import global_sum
from ..particles.clouds import Clouds
from ..particles.energy_bins import Frames
from ..particles.motion_of_charge import charges
from ..particles.particles import Particles
from ..stages.push import IN_CACHE
from ..units import SPEED_OF_LIGHT
from .leapfrog import felt
from .setup import Setup
from .solution import Solution
from .state import State

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

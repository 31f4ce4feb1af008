"""Push: the motion of particles."""

from __future__ import annotations

import numpy as np

from .. import _native
from ..errors import ParticleError
from ..mesh.field import VectorField
from ..particles.arrays import empty_columns
from ..particles.clouds import PLAIN, Clouds
from ..particles.particles import Particles

RANDOM_WALK = 1  # stream of the counter-based generator; bunches draw from others


def push(
    efield: VectorField, particles: Particles, before: float, after: float, dt: float, clouds: Clouds = PLAIN
) -> Particles:
    """Return the particles after `before` s and a further `after` s in the field at their places, and a flight of `dt` s.
    Let `migrate` follow.

    p += q E Δt, with the field as `gather` finds it, and x += p dt / m, non-relativistic; each particle is read once. The two
    parts are added one after the other: with the momenta between them, a second call goes on to the same in all digits.
    Collective, and as `gather` in all else.
    """
    hierarchy = efield.hierarchy
    sorting = particles.sorted_on(hierarchy)
    momentum, position = (empty_columns(len(particles)) for _ in range(2))
    time_over_mass = particles.spread(dt / particles.species.masses)
    given, out = particles.arrays, (momentum, position)
    try:
        mesh, starts = hierarchy.particle_mesh, sorting.starts
        _native.push(
            mesh, *clouds.native, efield.native, *given, starts, particles.charge, time_over_mass, before, after, *out
        )
    except IndexError as moved:
        raise ParticleError(str(moved)) from None
    return particles.replace(position, momentum)


def random_walk(particles: Particles, amplitude: float, seed: int, step: int) -> Particles:
    """Return the particles moved by up to `amplitude` (m) along each axis, uniformly. Let `migrate` follow.

    A particle's move depends on seed, step and its id alone: not on the ranks, nor on the order of particles.
    """
    draws = np.empty((4, len(particles)))
    _native.uniforms(seed, RANDOM_WALK, step, particles.id, draws)
    return particles.replace(position=particles.position + amplitude * (2 * draws[:3].T - 1))

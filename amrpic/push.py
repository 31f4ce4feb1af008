"""Motion of particles."""

from __future__ import annotations

import numpy as np

from . import _native
from .clouds import PLAIN, Clouds
from .errors import ParticleError
from .field import VectorField
from .particles import Particles, empty_columns, particle_mesh

RANDOM_WALK = 1  # stream of the counter-based generator; bunches draw from others


def accelerate(
    efield: VectorField, particles: Particles, before: float, after: float, clouds: Clouds = PLAIN
) -> tuple[Particles, np.ndarray]:
    """Return the particles after `before` s in the field at their places, and their momenta (n, 3) a further `after` s later.

    p += q E dt, with the field as `gather` finds it; it is not kept. The second momenta are for the drift that follows. A
    particle's position is not looked at twice. Collective, and as `gather` in all else.
    """
    hierarchy = efield.hierarchy
    sorting = particles.sorted_on(hierarchy)
    x, y, z = (c.native for c in efield.components)
    now, onward = empty_columns(len(particles)), empty_columns(len(particles))
    charge = _each_or_all(particles, particles.species.charges)
    try:
        mesh, given = particle_mesh(hierarchy), particles.arrays
        _native.accelerate(mesh, *clouds.native, x, y, z, *given, sorting.starts, charge, before, after, now, onward)
    except IndexError as moved:
        raise ParticleError(str(moved)) from None
    return particles.replace(momentum=now), onward


def drift(particles: Particles, dt: float) -> Particles:
    """Return the particles after a flight of dt (s), non-relativistic: x += p dt / m. Let `migrate` follow."""
    position = empty_columns(len(particles))
    _native.drift(*particles.arrays, _each_or_all(particles, dt / particles.species.masses), position)
    return particles.replace(position=position)


def random_walk(particles: Particles, amplitude: float, seed: int, step: int) -> Particles:
    """Return the particles moved by up to `amplitude` (m) along each axis, uniformly. Let `migrate` follow.

    A particle's move depends on seed, step and its id alone: not on the ranks, nor on the order of particles.
    """
    draws = np.empty((4, len(particles)))
    _native.uniforms(seed, RANDOM_WALK, step, particles.id, draws)
    return particles.replace(position=particles.position + amplitude * (2 * draws[:3].T - 1))


def _each_or_all(particles: Particles, values: np.ndarray) -> np.ndarray:
    """One value per species as one per particle (n,), or as one for all (1,) if there is one species."""
    return values if len(values) == 1 else values[particles.kind]

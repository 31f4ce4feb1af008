"""Motion of particles."""

from __future__ import annotations

import numpy as np

from . import _native
from .particles import Particles

RANDOM_WALK = 1  # stream of the counter-based generator; bunches draw from others


def kick(particles: Particles, efield: np.ndarray, dt: float) -> Particles:
    """Return the particles after a time dt (s) in the field (n, 3) in V/m: p += q E dt."""
    momentum = particles.spread(dt * particles.species.charges)[:, None] * efield
    momentum += particles.momentum
    return particles.replace(momentum=momentum)


def drift(particles: Particles, dt: float) -> Particles:
    """Return the particles after a flight of dt (s), non-relativistic: x += p dt / m. Let `migrate` follow."""
    position = particles.spread(dt / particles.species.masses)[:, None] * particles.momentum
    position += particles.position
    return particles.replace(position=position)


def random_walk(particles: Particles, amplitude: float, seed: int, step: int) -> Particles:
    """Return the particles moved by up to `amplitude` (m) along each axis, uniformly. Let `migrate` follow.

    A particle's move depends on seed, step and its id alone: not on the ranks, nor on the order of particles.
    """
    draws = np.empty((4, len(particles)))
    _native.uniforms(seed, RANDOM_WALK, step, particles.id, draws)
    return particles.replace(position=particles.position + amplitude * (2 * draws[:3].T - 1))

"""Push: the motion of particles."""

from __future__ import annotations

import numpy as np

from .. import _native
from ..errors import ParticleError
from ..mesh.field import VectorField
from ..particles.arrays import columns, empty_columns
from ..particles.clouds import PLAIN, Clouds
from ..particles.particles import Particles

IN_CACHE = 2**14  # particles whose random numbers are drawn at a time
RANDOM_WALK = 1  # stream of the counter-based generator; bunches draw from others


PUSHERS = ("higuera-cary", "boris")


def pusher_of(name: str) -> _native.Pusher:
    """Return one of `PUSHERS` as the kernels take it."""
    return getattr(_native.Pusher, name.replace("-", "_"))


def push(
    efield: VectorField,
    particles: Particles,
    before: float,
    after: float,
    dt: float,
    clouds: Clouds = PLAIN,
    *,
    pusher: str = "higuera-cary",
    beta: tuple[float, float, float] = (0.0, 0.0, 0.0),
    electric: np.ndarray | None = None,
    magnetic: np.ndarray | None = None,
    between: np.ndarray | None = None,
    external: _native.ExternalFields | None = None,
    time: float = 0.0,
    shift: tuple[float, float, float] = (0.0, 0.0, 0.0),
    parts: np.ndarray | None = None,
) -> Particles:
    """Return the particles after `before` s and a further `after` s in the fields at their places, and a flight of `dt` s.
    Let `migrate` follow.

    dp/dt = q (E + v × B), with the mesh's field as `gather` finds it, and x += p dt / (γ m), γ² = 1 + (p / m c)²; each particle
    is read once. Charge whose field the mesh holds moves with `beta` c, so that B = beta × E / c. Fields that are added:
    `electric` (V/m) and `magnetic` (T), (n, 3) at the particles, and those of `external` elements at `time` (s). The two parts
    act one after the other, and what is between them is written into `between`, (n, 3): a second call goes on from there to
    the same, without magnetic fields in all digits. Positions afterwards are those from an origin that is `shift` (m) further
    on. Magnetic fields turn momenta as Boris (1970), or Higuera and Cary, Phys. Plasmas 24, 052104 (2017), have it. With
    `parts` (n,) fields act on each particle for another time, this part of `before` and `after`, which may be negative.
    Collective, and as `gather` in all else.
    """
    hierarchy = efield.hierarchy
    sorting = particles.sorted_on(hierarchy)
    momentum, position = (empty_columns(len(particles)) for _ in range(2))
    charge, inverse_mass = particles.charge, particles.spread(1 / particles.species.masses)
    if (
        parts is not None
    ):  # all that fields do goes with charge times time; the kernel takes one of both for all, or two for each
        charge, inverse_mass = charge * parts, np.array(inverse_mass)
    try:
        _native.push(
            hierarchy.particle_mesh,
            sorting.remote,
            *clouds.native,
            efield.native,
            *particles.arrays,
            sorting.starts,
            charge,
            inverse_mass,
            before,
            after,
            dt,
            pusher_of(pusher),
            beta,
            _at_particles(electric, particles, "electric"),
            _at_particles(magnetic, particles, "magnetic"),
            momentum,
            position,
            between,
            external,
            time,
            shift,
        )
    except IndexError as moved:
        raise ParticleError(str(moved)) from None
    return particles.replace(position, momentum)


def _at_particles(field: np.ndarray | None, particles: Particles, kind: str) -> np.ndarray | None:
    if field is None:
        return None
    components = columns(field, f"{kind} fields at particles")
    if len(components) != len(particles):
        raise ParticleError(
            f"{len(components)} {kind} fields are given for {len(particles)} particles; give one for each"
        )
    return components


def random_walk(particles: Particles, amplitude: float, seed: int, step: int) -> Particles:
    """Return the particles moved by up to `amplitude` (m) along each axis, uniformly. Let `migrate` follow.

    A particle's move depends on seed, step and its id alone: not on the ranks, nor on the order of particles.
    """
    position, buffer = empty_columns(len(particles)), np.empty(4 * min(IN_CACHE, len(particles)))
    for start in range(0, len(particles), IN_CACHE):
        chunk = slice(start, start + IN_CACHE)
        draws = buffer[: 4 * len(particles.id[chunk])].reshape(4, -1)  # in one piece, as native code writes to it
        _native.uniforms(seed, RANDOM_WALK, step, particles.id[chunk], draws)
        position[chunk] = particles.position[chunk] + amplitude * (2 * draws[:3].T - 1)
    return particles.replace(position=position)

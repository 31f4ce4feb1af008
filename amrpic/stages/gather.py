"""Gather: the field at the particles."""

from __future__ import annotations

import numpy as np

from .. import _native
from ..errors import ParticleError
from ..mesh.field import VectorField
from ..particles.arrays import empty_columns
from ..particles.clouds import PLAIN, Clouds
from ..particles.particles import Particles


def gather(efield: VectorField, particles: Particles, clouds: Clouds = PLAIN) -> np.ndarray:
    """Return the field at the particles, (n, 3) in the field's unit, with the clouds of the deposit. Collective.

    Beyond the edge of a level the field is trilinear from the coarser one, beyond a wall that of the wall cell. Matched clouds
    ask for a field with `covered="difference"`. Particles must be sorted on the hierarchy; `migrate` sees to that.
    """
    hierarchy = efield.hierarchy
    sorting = particles.sorted_on(hierarchy)
    out = empty_columns(len(particles))
    try:
        _native.gather(
            hierarchy.particle_mesh,
            sorting.remote,
            *clouds.native,
            efield.native,
            *particles.arrays,
            sorting.starts,
            out,
        )
    except IndexError as moved:
        raise ParticleError(str(moved)) from None
    return out

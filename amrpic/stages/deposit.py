"""Deposit: the charge of particles onto the mesh."""

from __future__ import annotations

from .. import _native
from ..errors import ParticleError
from ..mesh.field import Field
from ..mesh.hierarchy import Hierarchy
from ..particles.clouds import PLAIN, Clouds
from ..particles.particles import Particles


def deposit(particles: Particles, hierarchy: Hierarchy, clouds: Clouds = PLAIN) -> Field:
    """Return the charge density of the particles in C/m^3. Collective.

    Total charge is conserved to rounding, also across coarse-fine faces; what overhangs a wall is folded onto the wall cell.
    Particles must be sorted on the hierarchy; `migrate` sees to that.
    """
    sorting = particles.sorted_on(hierarchy)
    density = Field.unset(hierarchy, unit="C/m^3")
    position, momentum, weight, id = particles.arrays
    charge = float(particles.species.charges[0])
    if len(particles.species.kinds) > 1:
        weight, charge = weight * particles.charge, 1.0
    try:
        _native.deposit(
            hierarchy.particle_mesh,
            sorting.remote,
            *clouds.native,
            position,
            momentum,
            weight,
            id,
            sorting.starts,
            charge,
            density.native,
        )
    except IndexError as moved:
        raise ParticleError(str(moved)) from None
    return density

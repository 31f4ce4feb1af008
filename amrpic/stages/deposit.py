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
    return Deposition(particles, hierarchy, clouds).density()


class Deposition:
    """A deposit that may begin while some of the particles are under way to this rank: their messages pass meanwhile."""

    def __init__(self, particles: Particles, hierarchy: Hierarchy, clouds: Clouds = PLAIN) -> None:
        self._particles, self._hierarchy = particles, hierarchy
        sorting = particles.sorted_on(hierarchy)
        self._density = Field.unset(hierarchy, unit="C/m^3")
        position, momentum, weight, id = particles.arrays
        charge = float(particles.species.charges[0])
        if len(particles.species.kinds) > 1:
            weight, charge = weight * particles.charge, 1.0
        self._native = _native.Deposition(
            hierarchy.particle_mesh,
            sorting.remote,
            *clouds.native,
            position,
            momentum,
            weight,
            id,
            sorting.starts,
            charge,
            self._density.native,
        )

    def begin(self, migration: _native.Migration) -> None:
        """Deposit particles that a migration has put into their places while others are under way to theirs. Local.

        Its messages move meanwhile. The charge of the others is found from their ids, and may not be asked for yet: give
        particles of one species.
        """
        self._native.begin(migration)

    @property
    def left(self) -> int:
        """How many particles of this rank `density` has still to deposit."""
        return self._native.left

    def density(self) -> Field:
        """Return the density of all particles, once they are there; see `deposit`. Collective, once."""
        try:
            self._native.finish()
        except IndexError as moved:
            raise ParticleError(str(moved)) from None
        del self._native  # whose memory is for this deposit alone
        return self._density

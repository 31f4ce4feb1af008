"""Gather: the field at the particles."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from .. import _native
from ..errors import ParticleError
from ..mesh.field import Compensation, Field, VectorField
from ..particles.arrays import empty_columns
from ..particles.clouds import PLAIN, Clouds
from ..particles.particles import Particles
from ..units import VACUUM_PERMITTIVITY


def compensate(
    efield: VectorField, rho: Field, clouds: Clouds, stretch: tuple[float, float, float] = (1.0, 1.0, 1.0)
) -> None:
    """Let gather and push give back what these clouds smooth of the field of a density, if they are to; the density is locked.

    `stretch` is that of the equation. Components of the field, its energy and what is written stay what they are.
    """
    if clouds.compensation == "none":
        return
    widths = [rho.hierarchy.spacing(level) * np.array(stretch) for level in range(rho.hierarchy.levels)]
    strength = tuple(clouds.compensated(width) / VACUUM_PERMITTIVITY for width in widths)
    efield.compensate(Compensation(rho, strength, stretch))


def gather(efield: VectorField, particles: Particles, clouds: Clouds = PLAIN) -> np.ndarray:
    """Return the field at the particles, (n, 3) in the field's unit, with the clouds of the deposit. Collective.

    Beyond the edge of a level the field is trilinear from the coarser one, beyond a wall that of the wall cell. Matched clouds
    ask for a field with `covered="difference"`. What `compensate` has set is added.
    Particles must be sorted on the hierarchy; `migrate` sees to that.
    """
    out = empty_columns(len(particles))
    _native_gather(_native.gather, efield, particles, clouds, out)
    return out


def gather_into_places(
    efield: VectorField,
    particles: Particles,
    clouds: Clouds,
    places: np.ndarray,
    factors: tuple[float, float, float],
    out: np.ndarray,
) -> None:
    """Write what `gather` returns, its components times factors, to rows of `out` (m, 3): that of the n-th particle to
    places[n]. Collective."""
    _native_gather(_native.gather_into_places, efield, particles, clouds, places, factors, out)


def _native_gather(
    kernel: Callable[..., None], efield: VectorField, particles: Particles, clouds: Clouds, *to: Any
) -> None:
    hierarchy, sorting = efield.hierarchy, particles.sorted_on(efield.hierarchy)
    mesh = hierarchy.particle_mesh
    try:
        kernel(mesh, sorting.remote, *clouds.native, efield.native, *particles.arrays, sorting.starts, *to)
    except IndexError as moved:
        raise ParticleError(str(moved)) from None

"""Bunches of particles from distributions and from arrays.

Particle number i of a bunch is made from the seed and its id alone, so a bunch is the same on any number of ranks. Each rank
makes a contiguous run of ids, wherever these particles lie; `migrate` brings them home.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from mpi4py import MPI
from scipy.special import ndtri

from . import _native
from .errors import ParticleError
from .particles import Particles
from .species import Species, SpeciesTable

POSITION, MOMENTUM = 2, 3  # streams of the counter-based generator; the random walk draws from another

Vector = Sequence[float] | np.ndarray


def gaussian(
    comm: MPI.Comm,
    count: int,
    *,
    centre: Vector,
    sigma: float | Vector,
    bunch_charge: float,
    species: Species,
    momentum: Vector = (0.0, 0.0, 0.0),
    momentum_sigma: float | Vector = 0.0,
    seed: int = 0,
    first_id: int = 0,
) -> Particles:
    """Return this rank's share of a bunch with normal distributions along each axis.

    `centre` and `sigma` in m, `momentum` (mean) and `momentum_sigma` in kg m/s of one real particle; `bunch_charge` is that of
    all `count` macroparticles, `species` tells charge and mass of one real particle. Ids start at `first_id`.
    """
    ids = _share(comm, count, first_id)
    position = np.asarray(centre) + np.asarray(sigma) * _normal(seed, POSITION, ids)
    return _bunch(ids, count, position, momentum, momentum_sigma, bunch_charge, species, seed)


def uniform_sphere(
    comm: MPI.Comm,
    count: int,
    *,
    centre: Vector,
    radius: float,
    bunch_charge: float,
    species: Species,
    momentum: Vector = (0.0, 0.0, 0.0),
    momentum_sigma: float | Vector = 0.0,
    seed: int = 0,
    first_id: int = 0,
) -> Particles:
    """Return this rank's share of a bunch of uniform density in a sphere; `radius` in m, the rest as for `gaussian`."""
    ids = _share(comm, count, first_id)
    volume, height, angle = _uniform(seed, POSITION, ids)[:3]
    distance, cosine, azimuth = radius * np.cbrt(volume), 2 * height - 1, 2 * np.pi * angle
    sine = np.sqrt(1 - cosine**2)
    directions = np.stack([sine * np.cos(azimuth), sine * np.sin(azimuth), cosine]).T
    position = np.asarray(centre) + distance[:, None] * directions
    return _bunch(ids, count, position, momentum, momentum_sigma, bunch_charge, species, seed)


def from_arrays(
    comm: MPI.Comm,
    position: np.ndarray,
    *,
    species: Species,
    bunch_charge: float | None = None,
    weight: np.ndarray | None = None,
    momentum: np.ndarray | None = None,
    first_id: int = 0,
) -> Particles:
    """Return this rank's share of particles given as arrays: position (n, 3) m, momentum (n, 3) kg m/s, weight (n,).

    All ranks pass the same whole arrays, which may be memory-mapped: a rank reads its share only. Without `weight` the
    particles share `bunch_charge` equally. Raises ParticleError if the arrays do not fit together.
    """
    if (weight is None) == (bunch_charge is None):
        raise ParticleError("particles from arrays need either their weights or the charge of the bunch")
    count = len(position)
    for name, values in (("momentum", momentum), ("weight", weight)):
        if values is not None and len(values) != count:
            raise ParticleError(
                f"particles have {count} positions but {len(values)} values of {name}; give one for each"
            )
    ids = _share(comm, count, first_id)
    own = slice(*_run(comm, count))
    return Particles(
        position[own],
        np.zeros((len(ids), 3)) if momentum is None else momentum[own],
        _equal_weights(ids, count, bunch_charge, species.charge) if weight is None else weight[own],
        ids,
        SpeciesTable((species,)),
    )


def _run(comm: MPI.Comm, count: int) -> tuple[int, int]:
    """This rank's run of particle numbers."""
    return count * comm.rank // comm.size, count * (comm.rank + 1) // comm.size


def _share(comm: MPI.Comm, count: int, first_id: int) -> np.ndarray:
    start, stop = _run(comm, count)
    return np.arange(first_id + start, first_id + stop, dtype=np.int64)


def _uniform(seed: int, stream: int, ids: np.ndarray) -> np.ndarray:
    """Numbers in (0, 1), (4, n)."""
    out = np.empty((4, len(ids)))
    _native.uniforms(seed, stream, 0, ids, out)
    return out


def _normal(seed: int, stream: int, ids: np.ndarray) -> np.ndarray:
    """Standard normal numbers, (n, 3)."""
    return ndtri(_uniform(seed, stream, ids)[:3]).T


def _equal_weights(ids: np.ndarray, count: int, bunch_charge: float | None, charge: float) -> np.ndarray:
    if count == 0 or bunch_charge is None:
        return np.zeros(len(ids))
    return np.full(len(ids), bunch_charge / (count * charge))


def _bunch(
    ids: np.ndarray,
    count: int,
    position: np.ndarray,
    momentum: Vector,
    momentum_sigma: float | Vector,
    bunch_charge: float,
    species: Species,
    seed: int,
) -> Particles:
    spread = np.asarray(momentum_sigma)
    momenta = np.tile(np.asarray(momentum, dtype=np.float64), (len(ids), 1))
    if spread.any():
        momenta += spread * _normal(seed, MOMENTUM, ids)
    weight = _equal_weights(ids, count, bunch_charge, species.charge)
    return Particles(position, momenta, weight, ids, SpeciesTable((species,)))

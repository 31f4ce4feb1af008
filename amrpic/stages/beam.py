"""Bunches of particles from distributions, on lattices, and from arrays.

Particle number i of a bunch is made from the seed and its id alone, so a bunch is the same on any number of ranks. Each rank
makes a contiguous run of ids, wherever these particles lie; `migrate` sends them to the ranks that serve them.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from ..errors import ParticleError
from ..mpi import MPI
from ..parallel import share
from ..particles.particles import Particles
from ..particles.phase_space import PhaseSpace
from ..particles.species import Species, SpeciesTable
from ..particles.uniform_numbers import Sampling, draw

Vector = Sequence[float] | np.ndarray


def sampled(
    comm: MPI.Comm,
    count: int,
    distribution: Callable[[np.ndarray], np.ndarray],
    space: PhaseSpace,
    *,
    bunch_charge: float,
    species: Species,
    sampling: Sampling = "random",
    seed: int = 0,
    first_id: int = 0,
) -> Particles:
    """Return this rank's share of a bunch of `count` macroparticles, which have `bunch_charge` (C) together.

    `distribution` is a function as those in `distributions`; `space` gives it its place, sizes and momenta. Ids start at
    `first_id`.
    """
    numbers = draw(sampling, seed, first_id, *share(comm, count))
    position, momentum = space.place(distribution(numbers))
    return _joined(comm, count, position, momentum, species.weight(bunch_charge, count), species, first_id)


def lattice(
    comm: MPI.Comm,
    per_axis: Sequence[int],
    lower: Vector,
    upper: Vector,
    *,
    bunch_charge: float,
    species: Species,
    displacement: Vector = (0.0, 0.0, 0.0),
    waves: Sequence[int] = (1, 1, 1),
    momentum: Vector = (0.0, 0.0, 0.0),
    first_id: int = 0,
) -> Particles:
    """Return this rank's share of particles that fill a cuboid (m) evenly, z fastest.

    They are shifted along each axis by a sine of amplitude `displacement` (m) with so many `waves` across the cuboid.
    """
    count = int(np.prod([int(n) for n in per_axis], dtype=object))
    places = np.unravel_index(np.arange(*share(comm, count)), tuple(per_axis)) if count else (np.empty(0, int),) * 3
    position = np.empty((3, len(places[0])))
    for axis, place in enumerate(places):
        offset = (place + 0.5) / max(per_axis[axis], 1)
        shift = displacement[axis] * np.sin(2 * np.pi * waves[axis] * offset)
        position[axis] = lower[axis] + (upper[axis] - lower[axis]) * offset + shift
    weight = species.weight(bunch_charge, count)
    return _joined(comm, count, position.T, np.array(momentum, dtype=float), weight, species, first_id)


def from_arrays(
    comm: MPI.Comm,
    position: np.ndarray,
    *,
    species: Species,
    bunch_charge: float | None = None,
    weight: np.ndarray | None = None,
    momentum: np.ndarray | Vector = (0.0, 0.0, 0.0),
    first_id: int = 0,
) -> Particles:
    """Return this rank's share of particles given as arrays: position (n, 3) m, momentum (n, 3) or (3,) kg m/s, weight (n,).

    All ranks pass the same whole arrays, which may be memory-mapped: a rank reads its share only. Without `weight` the
    particles share `bunch_charge` equally. Raises ParticleError if the arrays do not fit together.
    """
    if (weight is None) == (bunch_charge is None):
        raise ParticleError("particles from arrays need either their weights or the charge of the bunch")
    count, momenta = len(position), np.asanyarray(momentum)
    for name, values in (("momentum", momenta if momenta.ndim == 2 else None), ("weight", weight)):
        if values is not None and len(values) != count:
            raise ParticleError(
                f"particles have {count} positions but {len(values)} values of {name}; give one for each"
            )
    own = slice(*share(comm, count))
    if momenta.ndim == 2:
        momenta = momenta[own]
    weights = species.weight(bunch_charge or 0.0, count) if weight is None else weight[own]
    return _joined(comm, count, position[own], momenta, weights, species, first_id)


def _joined(
    comm: MPI.Comm,
    count: int,
    position: np.ndarray,
    momentum: np.ndarray,
    weight: np.ndarray | float,
    species: Species,
    first_id: int,
) -> Particles:
    """Return this rank's share of a bunch from the rows of its share, or from values that all rows have."""
    start, stop = share(comm, count)
    ids = np.arange(first_id + start, first_id + stop, dtype=np.int64)
    momenta = np.broadcast_to(momentum, position.shape)
    return Particles(position, momenta, np.broadcast_to(weight, len(ids)), ids, SpeciesTable((species,)))

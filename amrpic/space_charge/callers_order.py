"""A caller's order of particles: out of it for the stages, and back into it, also where other ranks serve them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from .. import _native
from ..mesh.field import VectorField
from ..mesh.hierarchy import Hierarchy
from ..mpi import MPI
from ..parallel import Communicator
from ..particles.arrays import empty_columns, recycled, zero_columns
from ..particles.clouds import Clouds
from ..particles.particles import Particles
from ..particles.species import Species, SpeciesTable
from ..stages.gather import gather, gather_into_places
from ..stages.migrate import NONE, migrate_without
from .callers_arrays import Arrays, ColumnSums, column_sums, require_charges, require_places
from .placing import Coordinates

CHARGES = SpeciesTable((Species("charge", charge=1.0, mass=1.0),))  # the weight of a particle is its charge in C
MIXED = 0.1  # of neighbours in the caller's order that are not neighbours when sorted, from which that is kept
SAMPLED = 16  # one of so many pairs is looked at
MULTIPLIER = np.uint64(0x9E3779B97F4A7C15)  # of the golden ratio: spreads bits


@dataclass(frozen=True, eq=False)
class Taken:
    """This rank's living particles, in the order in which they are taken."""

    position: np.ndarray  # (k, 3) in the coordinates of the mesh
    charge: np.ndarray  # (k,) C, one number that is repeated if all are equal
    magnitude: float  # Σ |q|, C
    places: tuple[ColumnSums, ColumnSums, ColumnSums]  # of x, y and z, m

    def __len__(self) -> int:
        return len(self.position)


class Buffers:
    """Keeps the memory of one call for the next, between which nothing of it is in use."""

    COLUMNS = 16  # of eight bytes for each particle, that a call has at a time

    def __init__(self) -> None:
        self._particles, self._reserved = 0, _native.ReservedMemory(0)

    def serve(self, particles: int) -> None:
        """Let there be room for so many particles."""
        if particles != self._particles:
            self._particles, self._reserved = particles, _native.ReservedMemory(8 * self.COLUMNS * particles)


class CallersOrder:
    """How the latest caller's particles follow each other when they are sorted on the mesh: kept for the next call, whose
    particles are then taken nearly sorted. Whatever is kept, results are those of the particles that are given.

    `reproducible`: particles are taken in an order that depends on their places and charges alone.
    """

    def __init__(self, reproducible: bool = False) -> None:
        self._reproducible = reproducible
        self._order: np.ndarray | None = None  # indices into the caller's arrays; None: as they are
        self._of = -1  # number of particles that `_order` is of
        self._alive: np.ndarray | None = None
        self._numbers = np.zeros(0, dtype=np.int64)  # 0, 1, 2, …
        self.outside = 0  # particles of all ranks that lay outside the mesh when they were sorted

    def take(self, arrays: Arrays, coordinates: Coordinates) -> Taken:
        """Return the living particles in coordinates of a mesh. Local; InputError for values that are no places or charges."""
        self._take_up(arrays)
        if self._reproducible:
            self._sort_by_value(arrays)
        count = len(arrays) if self._order is None else len(self._order)
        position = empty_columns(count)
        x, y, z = (self._coordinate(arrays, axis, coordinates, position) for axis in range(3))
        charge, of_charge = self._charges(arrays, count)
        return Taken(position, charge, of_charge.magnitude, (x, y, z))

    def moved(self, taken: Taken, arrays: Arrays, before: Coordinates, after: Coordinates) -> Taken:
        """Return what was taken in some coordinates in others. Local."""
        for axis in range(3):
            if before.along(axis) != after.along(axis):
                self._coordinate(arrays, axis, after, taken.position)
        return taken

    def particles(self, taken: Taken, first: int) -> Particles:
        """Return what was taken as particles; `first` is the id of this rank's first one."""
        position, charge, count = taken.position, taken.charge, len(taken)
        places = self._indices(count)
        if not self._reproducible:
            return Particles(position, zero_columns(count), charge, places + first if first else places, CHARGES)
        # who serves a particle follows from its id, so that is made of what it is, and its number goes with the momentum
        momentum = empty_columns(count)
        momentum[...] = 0
        momentum[:, 0] = places + first
        return Particles(position, momentum, charge, _digest(position, charge), CHARGES)

    def numbers(self, particles: Particles) -> np.ndarray:
        """Return the numbers, `first` + index in the caller's arrays, of sorted particles, int64 (k,)."""
        return particles.momentum[:, 0].astype(np.int64) if self._reproducible else particles.id

    def sort(self, hierarchy: Hierarchy, particles: Particles, servers: np.ndarray | None) -> Particles:
        """Return particles sorted on a hierarchy, without those that lie outside it: `outside` says how many. Collective.

        `servers` that serve no longer are replaced.
        """
        evenly, at_rest = servers is not None, not self._reproducible
        settled, _, self.outside = migrate_without(particles, hierarchy, NONE, servers, evenly, at_rest=at_rest)
        if self._reproducible:
            assert settled.sorting is not None
            among = np.lexsort((settled.weight, *settled.position.T[::-1]))  # those of a brick follow each other so
            settled = migrate_without(settled.select(among), hierarchy, NONE, settled.sorting.servers)[0]
        return settled

    def back(
        self,
        efield: VectorField,
        particles: Particles,
        clouds: Clouds,
        counts: np.ndarray,
        factors: tuple[float, float, float],
    ) -> np.ndarray:
        """Return the field at particles that are sorted, times factors, as values (n, 3) of this rank's caller. Collective.

        Zero for those that are lost or do not live. `counts`: particles of each rank's caller, (ranks,).
        """
        comm, numbers = efield.hierarchy.comm, self.numbers(particles)
        count = int(counts[comm.rank])
        out = empty_columns(count)
        if comm.size > 1:
            firsts = np.concatenate([[0], np.cumsum(counts)])
            numbers, values = _returned(comm, numbers, gather(efield, particles, clouds), firsts)
            numbers = numbers - firsts[comm.rank]
        if len(numbers) < count:
            out[...] = 0
        if comm.size > 1:
            _native.put_into_places(values, numbers, factors, out)
        else:
            gather_into_places(efield, particles, clouds, numbers, factors, out)
        self._keep(numbers, count)
        return out

    def _take_up(self, arrays: Arrays) -> None:
        """Drop what is kept where it is of other particles."""
        same = self._of == len(arrays) and (
            self._alive is arrays.alive
            or (self._alive is not None and arrays.alive is not None and np.array_equal(self._alive, arrays.alive))
        )
        if not same:
            self._of, self._order = len(arrays), None
            self._alive = None if arrays.alive is None else arrays.alive.copy()
            if arrays.alive is not None:
                self._order = np.flatnonzero(arrays.alive)

    def _sort_by_value(self, arrays: Arrays) -> None:
        """Take particles in an order that depends on their places and charges alone."""
        keys = [key for key in (arrays.charge, *arrays.places[::-1]) if isinstance(key, np.ndarray)]
        canonical = np.lexsort([key if self._order is None else key[self._order] for key in keys])
        self._order = canonical if self._order is None else self._order[canonical]

    def _coordinate(self, arrays: Arrays, axis: int, coordinates: Coordinates, position: np.ndarray) -> ColumnSums:
        sums = column_sums(arrays.places[axis], self._order, *coordinates.along(axis), position[:, axis])
        require_places(sums, arrays, axis)
        return sums

    def _charges(self, arrays: Arrays, count: int) -> tuple[np.ndarray, ColumnSums]:
        """Return the charges that are taken (k,), and what they add up to."""
        charge = arrays.charge
        if isinstance(charge, float):
            sums = ColumnSums(count * charge, count * abs(charge), charge, charge)
        else:
            out = recycled(count, np.float64)
            sums = column_sums(charge, self._order, out=out)
        require_charges(sums)
        equal = sums.least == sums.greatest
        return (np.broadcast_to(sums.least, count) if equal or count == 0 else out), sums

    def _indices(self, count: int) -> np.ndarray:
        if self._order is not None:
            return self._order
        if len(self._numbers) != count:
            self._numbers = np.arange(count)
        return self._numbers

    def _keep(self, numbers: np.ndarray, count: int) -> None:
        """Keep an order in which the particles come sorted, if that is another one than the caller's."""
        if self._reproducible or len(numbers) < 2:
            return
        if self._order is None:
            samples = numbers[1::SAMPLED] - numbers[:-1:SAMPLED]
            if np.count_nonzero(samples != 1) < MIXED * len(samples):
                return
        if len(numbers) < (count if self._order is None else len(self._order)):  # some are lost: they come last
            left = np.zeros(count, dtype=bool)
            left[self._indices(count)] = True
            left[numbers] = False
            numbers = np.concatenate([numbers, np.flatnonzero(left)])
        self._order = numbers


def _digest(position: np.ndarray, charge: np.ndarray) -> np.ndarray:
    """Return a number of 62 bits for each particle, that of its place and charge. int64 (n,)."""
    out = np.zeros(len(position), dtype=np.uint64)
    for column in (*position.T, charge):
        out = (out ^ np.ascontiguousarray(column).view(np.uint64)) * MULTIPLIER
        out ^= out >> np.uint64(29)
    return (out >> np.uint64(2)).view(np.int64)


def _returned(
    comm: Communicator, numbers: np.ndarray, values: np.ndarray, firsts: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Return the numbers (k,) and values (k, 3) that belong to this rank's caller, from all ranks. Collective."""
    owner = np.searchsorted(firsts, numbers, side="right") - 1
    order = np.argsort(owner, kind="stable")
    sent = np.bincount(owner, minlength=comm.size)
    received = np.empty_like(sent)
    comm.Alltoall(sent, received)
    total = int(received.sum())
    its_numbers, its_values = np.empty(total, dtype=np.int64), empty_columns(total)
    sizes, places = (sent, received), [np.concatenate([[0], np.cumsum(size)[:-1]]) for size in (sent, received)]

    def exchange(sent: np.ndarray, received: np.ndarray, kind: MPI.Datatype) -> None:
        comm.Alltoallv([sent, sizes[0], places[0], kind], [received, sizes[1], places[1], kind])

    exchange(numbers[order], its_numbers, MPI.INT64_T)
    for column, target in zip(values.T, its_values.T, strict=True):
        exchange(column[order], target, MPI.DOUBLE)
    return its_numbers, its_values

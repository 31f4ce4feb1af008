"""A caller's order of particles: out of it for the stages, and back into it, also where other ranks serve them."""

from __future__ import annotations

import numpy as np
from mpi4py import MPI

from ..parallel import Communicator
from ..particles.arrays import empty_columns, recycled
from ..particles.particles import Particles
from ..particles.species import Species, SpeciesTable
from .callers_arrays import Arrays

CHARGES = SpeciesTable((Species("charge", charge=1.0, mass=1.0),))  # the weight of a particle is its charge in C
MIXED = 0.1  # of neighbours in the caller's order that are not neighbours when sorted, from which that is kept
SAMPLED = 16  # one of so many pairs is looked at
MULTIPLIER = np.uint64(0x9E3779B97F4A7C15)  # of the golden ratio: spreads bits


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
        self._at_rest = empty_columns(0)

    def columns(self, given: Arrays) -> tuple[list[np.ndarray], np.ndarray]:
        """Return x, y and z of the living particles, and their charges, each (k,), in the order in which they are taken.

        They may be the caller's memory. Local.
        """
        self._take_up(given)
        charge = np.asarray(given.charge) if np.ndim(given.charge) == 0 else self._taken(np.asarray(given.charge))
        places = [self._taken(column) for column in given.places]
        charge = np.broadcast_to(charge, len(places[0]))
        if self._reproducible:
            canonical = np.lexsort((charge, *places[::-1]))
            self._order = canonical if self._order is None else self._order[canonical]
            places, charge = [column[canonical] for column in places], _chosen(charge, canonical)
        return places, charge

    def particles(self, position: np.ndarray, charge: np.ndarray, first: int) -> Particles:
        """Return particles at positions (k, 3) in the order of `columns`; `first` is the id of this rank's first one."""
        count = len(position)
        if len(self._at_rest) != count:
            self._at_rest = empty_columns(count)
            self._at_rest[...] = 0
        places = self._indices(count)
        if not self._reproducible:
            return Particles(position, self._at_rest, charge, places + first if first else places, CHARGES)
        # who serves a particle follows from its id, so that is made of what it is, and its number goes with the momentum
        momentum = empty_columns(count)
        momentum[...] = 0
        momentum[:, 0] = places + first
        return Particles(position, momentum, charge, _digest(position, charge), CHARGES)

    def numbers(self, particles: Particles) -> np.ndarray:
        """Return the numbers, `first` + index in the caller's arrays, of sorted particles, int64 (k,)."""
        return particles.momentum[:, 0].astype(np.int64) if self._reproducible else particles.id

    def settled(self, particles: Particles) -> Particles | None:
        """Return particles that were sorted on a hierarchy in the order in which those of a brick are to follow each other, to
        be sorted again; None if they are right. Local."""
        if not self._reproducible:
            return None
        return particles.select(np.lexsort((particles.weight, *particles.position.T[::-1])))

    def back(self, comm: Communicator, particles: Particles, values: np.ndarray, counts: np.ndarray) -> np.ndarray:
        """Return values (k, 3) of particles that are sorted on this rank, as values (n, 3) of this rank's caller. Collective.

        Zero for those that are lost or do not live. `counts`: particles of each rank's caller, (ranks,).
        """
        firsts = np.concatenate([[0], np.cumsum(counts)])
        first, count = firsts[comm.rank], int(counts[comm.rank])
        numbers = self.numbers(particles)
        if comm.size > 1:
            numbers, values = _returned(comm, numbers, values, firsts)
            numbers = numbers - first
        out = empty_columns(count)
        if len(numbers) < count:
            out[...] = 0
        for target, source in zip(out.T, values.T, strict=True):
            target[numbers] = source
        self._keep(numbers, count)
        return out

    def _take_up(self, given: Arrays) -> None:
        """Drop what is kept where it is of other particles."""
        same = self._of == len(given) and (
            self._alive is given.alive
            or (self._alive is not None and given.alive is not None and np.array_equal(self._alive, given.alive))
        )
        if not same:
            self._of, self._order = len(given), None
            self._alive = None if given.alive is None else given.alive.copy()
            if given.alive is not None:
                self._order = np.flatnonzero(given.alive)

    def _taken(self, column: np.ndarray) -> np.ndarray:
        if self._order is None:
            return column
        return np.take(column, self._order, out=recycled(len(self._order), np.float64), mode="clip")

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
            some = numbers[1::SAMPLED] - numbers[:-1:SAMPLED]
            if np.count_nonzero(some != 1) < MIXED * len(some):
                return
        if len(numbers) < (count if self._order is None else len(self._order)):  # some are lost: they come last
            left = np.zeros(count, dtype=bool)
            left[self._indices(count)] = True
            left[numbers] = False
            numbers = np.concatenate([numbers, np.flatnonzero(left)])
        self._order = numbers


def _chosen(charge: np.ndarray, order: np.ndarray) -> np.ndarray:
    return charge if charge.strides == (0,) else charge[order]


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

    def exchange(given: np.ndarray, taken: np.ndarray, kind: MPI.Datatype) -> None:
        comm.Alltoallv([given, sizes[0], places[0], kind], [taken, sizes[1], places[1], kind])

    exchange(numbers[order], its_numbers, MPI.INT64_T)
    for column, target in zip(values.T, its_values.T, strict=True):
        exchange(column[order], target, MPI.DOUBLE)
    return its_numbers, its_values

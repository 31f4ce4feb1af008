"""What is recorded of particles that met something on their way: those that are lost, and those that pass screens."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from ..particles.particles import Particles
from ..particles.species import SpeciesTable

GROWTH = 1.5  # of the memory of a record that needs more: then each particle is copied three times at most in the mean
LEAST = 1024  # particles that there is room for


@dataclass(frozen=True, eq=False)
class Record:
    """Particles as they were where they met something, in the laboratory. This rank's share."""

    particles: Particles  # their position there, and their momentum, which is known to second order in the time step
    time: np.ndarray  # (n,) s
    direction: np.ndarray  # (n,) int64: 1 for particles that came up z, -1 down, 0 across
    cause: np.ndarray  # (n,) int64, what they met: an index of `names`
    names: tuple[str, ...]
    charges: np.ndarray  # (names,) C, of those that met each
    _room: _Room | None = field(default=None, repr=False)  # whose first values these are

    @classmethod
    def of(
        cls, particles: Particles, time: np.ndarray, direction: np.ndarray, cause: np.ndarray, names: Sequence[str]
    ) -> Record:
        """Return the record of particles whose charges are to be summed."""
        charges = np.bincount(cause, particles.weight * particles.charge, len(names))
        return cls(particles, time, direction, cause, tuple(names), charges)

    @classmethod
    def empty(cls, species: SpeciesTable, names: Sequence[str]) -> Record:
        """Nothing yet, of what has these names."""
        no_numbers = np.zeros(0, dtype=np.int64)
        return cls.of(Particles.empty(species), np.zeros(0), no_numbers, no_numbers, names)

    def __len__(self) -> int:
        return len(self.time)

    def joined(self, later: Record) -> Record:
        """Return these and others, whose names may differ. It takes the time of the others, mostly: they are put behind these
        in memory that both records share, as long as nothing else has been put there."""
        if len(later) == 0:
            return self
        names = tuple(dict.fromkeys([*self.names, *later.names]))
        number = np.array([names.index(name) for name in later.names])
        charges = np.zeros(len(names))
        charges[: len(self.names)] = self.charges
        charges[number] += later.charges
        room, end = self._room, len(self) + len(later)
        if room is None or room.used != len(self) or room.capacity < end:
            room = _Room(max(int(GROWTH * end), LEAST))
            room.add(self, np.arange(len(self.names)))
        room.add(later, number)
        return room.record(self.particles.species, names, charges)


class _Room:
    """Memory for the columns of a record, most of it not used yet."""

    def __init__(self, capacity: int) -> None:
        self.used, self.capacity = 0, capacity
        self._reals, self._numbers = np.empty((8, capacity)), np.empty((3, capacity), dtype=np.int64)

    def add(self, record: Record, number: np.ndarray) -> None:
        """Put a record behind what is there; `number` is that of each of its names."""
        of, part = record.particles, slice(self.used, self.used + len(record))
        self._reals[:, part] = *of.position.T, *of.momentum.T, of.weight, record.time
        self._numbers[:, part] = of.id, record.direction, number[record.cause]
        self.used = part.stop

    def record(self, species: SpeciesTable, names: tuple[str, ...], charges: np.ndarray) -> Record:
        """Return the record of all that is there."""
        reals, (id, direction, cause) = self._reals[:, : self.used], self._numbers[:, : self.used]
        particles = Particles(reals[:3].T, reals[3:6].T, reals[6], id, species)
        return Record(particles, reals[7], direction, cause, names, charges, self)

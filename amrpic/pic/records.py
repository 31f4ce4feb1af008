"""What is recorded of particles that met something on their way: those that are lost, and those that pass screens."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ..particles.particles import Particles, concatenate
from ..particles.species import SpeciesTable


@dataclass(frozen=True, eq=False)
class Record:
    """Particles as they were where they met something, in the laboratory. This rank's share."""

    particles: Particles  # their position there, and their momentum, which is known to second order in the time step
    time: np.ndarray  # (n,) s
    direction: np.ndarray  # (n,) int64: 1 for particles that came up z, -1 down, 0 across
    cause: np.ndarray  # (n,) int64, what they met: an index of `names`
    names: tuple[str, ...]

    @staticmethod
    def empty(species: SpeciesTable, names: Sequence[str]) -> Record:
        """Nothing yet, of what has these names."""
        no_numbers = np.zeros(0, dtype=np.int64)
        return Record(Particles.empty(species), np.zeros(0), no_numbers, no_numbers, tuple(names))

    def __len__(self) -> int:
        return len(self.time)

    def joined(self, later: Record) -> Record:
        """Return these and others, whose names may differ."""
        if len(later) == 0:
            return self
        names = tuple(dict.fromkeys([*self.names, *later.names]))
        number = np.array([names.index(name) for name in later.names])
        return Record(
            concatenate([self.particles, later.particles]),
            np.concatenate([self.time, later.time]),
            np.concatenate([self.direction, later.direction]),
            np.concatenate([self.cause, number[later.cause]]),
            names,
        )

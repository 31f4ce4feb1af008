"""What rules of refinement ask for of particles on a mesh."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import Any

import numpy as np

from ..conductors.conductor import Conductor
from ..mesh.field import Field, VectorField
from ..mesh.hierarchy import Hierarchy
from ..particles.particles import Particles
from ..stages.tag import count


class QuantitiesOnMesh(Mapping[str, Any]):
    """Fields of particles that are sorted on a hierarchy by name, each made when it is first asked for: all ranks ask for the
    same, and all together.

    A method of the name after an underscore makes each: charge density (C/m³), potential (V), field (V/m).
    """

    NAMES = ("rho", "phi", "efield", "particles_per_cell")

    def __init__(self, particles: Particles, hierarchy: Hierarchy, electrodes: Sequence[Conductor] = ()) -> None:
        self.particles, self.hierarchy, self.electrodes = particles, hierarchy, tuple(electrodes)
        self._made: dict[str, Field | VectorField] = {}

    @property
    def surfaces(self) -> Sequence[tuple[int, np.ndarray, np.ndarray]]:
        """Faces of the domain that emit, by their numbers, with the corners (3,) in m of the part that does."""
        return ()

    def __getitem__(self, name: str) -> Any:
        if name not in self._made:
            self._made[name] = getattr(self, f"_{name}")()
        return self._made[name]

    def __iter__(self) -> Iterator[str]:
        return iter(self.NAMES)

    def __len__(self) -> int:
        return len(self.NAMES)

    def _particles_per_cell(self) -> Field:
        """Macroparticles in each cell, in covered cells those of their children."""
        return count(self.particles, self.hierarchy)

"""What rules of refinement ask for of particles on a mesh."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import replace
from typing import Any

from ..mesh.field import Field, VectorField
from ..stages.tag import count
from .meshed import MeshedParticles, deposit
from .setup import Setup
from .solution import Solution
from .solve import carried, solve


class Quantities(Mapping[str, Any]):
    """Fields of particles on a mesh by name, each made when it is first asked for: all ranks ask for the same, and all
    together.

    Potential and field are carried over from the `last` solution; without one they are solved for.
    """

    NAMES = ("rho", "phi", "efield", "particles_per_cell")

    def __init__(self, beam: MeshedParticles, last: Solution | None, setup: Setup) -> None:
        self.particles, self.hierarchy = beam.particles, beam.hierarchy
        self._beam, self._last, self._setup = beam, last, setup
        self._made: dict[str, Field | VectorField] = {}

    def __getitem__(self, name: str) -> Any:
        if name not in self._made:
            self._made[name] = getattr(self, f"_{name}")()
        return self._made[name]

    def __iter__(self) -> Iterator[str]:
        return iter(self.NAMES)

    def __len__(self) -> int:
        return len(self.NAMES)

    @property
    def beam(self) -> MeshedParticles:
        """The particles, with what there is of their field by now."""
        return self._beam

    def _rho(self) -> Field:
        """Charge density, C/m³."""
        rho = deposit(self._beam, self._setup)
        self._beam = replace(self._beam, deposition=None, rho=rho)
        return rho

    def _solution(self) -> Solution:
        solution = solve(self._beam, self["rho"], self._last, self._setup)
        self._beam = replace(self._beam, solution=solution)
        return solution

    def _phi(self) -> Field:
        """Potential, V, with that of what walls hold."""
        last = self._last
        return self._solution().potential if last is None else carried(last.potential, self.hierarchy, self._setup)

    def _efield(self) -> VectorField:
        """Electric field, V/m, with that of what walls hold."""
        if self._last is None:
            return self._solution().electric
        x, y, z = (carried(part, self.hierarchy, self._setup) for part in self._last.electric.components)
        return VectorField(x, y, z)

    def _particles_per_cell(self) -> Field:
        """Macroparticles in each cell, in covered cells those of their children."""
        return count(self.particles, self.hierarchy)

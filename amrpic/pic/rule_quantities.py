"""What rules of refinement ask for in a run."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from ..mesh.field import Field, VectorField
from ..space_charge.quantities import QuantitiesOnMesh
from .meshed import MeshedParticles, deposit
from .setup import Setup
from .solution import Solution
from .solve import carried, solve


class Quantities(QuantitiesOnMesh):
    """Those of a beam: potential and field are carried over from the `last` solution; without one they are solved for."""

    def __init__(self, beam: MeshedParticles, last: Solution | None, setup: Setup) -> None:
        super().__init__(beam.particles, beam.hierarchy, beam.drive.electrodes)
        self._beam, self._last, self._setup = beam, last, setup

    @property
    def beam(self) -> MeshedParticles:
        """The particles, with what there is of their field by now."""
        return self._beam

    @property
    def surfaces(self) -> Sequence[tuple[int, np.ndarray, np.ndarray]]:
        """Those of sources, but for walls that the window has left behind."""
        left = () if self._last is None else set(self._setup.emitting_walls.faces) - set(self._last.layers)
        domain, sources = self._setup.scene.domain.value, self._setup.scene.sources
        return [surface for source in sources for surface in source.surfaces(domain) if surface[0] not in left]

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

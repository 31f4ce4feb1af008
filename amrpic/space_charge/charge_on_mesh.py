"""Charge on a mesh that serves several calls: what stays of a call for the next, and what its rule may look at."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from ..mesh.field import Field, VectorField
from ..mesh.hierarchy import Hierarchy
from ..particles.clouds import PLAIN
from ..particles.particles import Particles
from ..scene.refinement import Refinement
from ..scene.solver_options import SolverSection
from ..stages.deposit import deposit
from ..stages.migrate import shared_out_by_work
from ..stages.poisson import SolveReport
from ..stages.regrid import carry_over
from .quantities import QuantitiesOnMesh
from .self_field import follow, self_field
from .solvers import Solvers
from .tagging_rules import refined

Sort = Callable[[Hierarchy, Particles, np.ndarray | None], Particles]


class Memory:
    """The solver, the potential to start from, and the report of the latest solve; particles are values that come and go."""

    def __init__(self, refinement: Refinement, options: SolverSection) -> None:
        self.refinement, self.options = refinement, options
        self.clouds = PLAIN
        self.report: SolveReport | None = None
        self.start_anew()

    def start_anew(self) -> None:
        """Forget the mesh and its potential, as for other charge."""
        self._solvers = Solvers(self.options)
        self._phi: Field | None = None
        self.report = None

    def self_field(self, rho: Field, deposited: float) -> tuple[Field, VectorField]:
        """Return φ (V) of a density, and the E (V/m) that its particles feel. Collective; SolverError if the solve fails.

        `deposited`: Σ |q| in C, of which rounding is no net charge.
        """
        before, hierarchy = self._phi, rho.hierarchy
        same = before is not None and before.hierarchy is hierarchy
        guess = before if same or before is None else carry_over(before, hierarchy)
        last = self.report if same else None
        self._phi, efield, self.report = self_field(
            self._solvers, rho, guess, self.clouds, last=last, deposited=deposited
        )
        self._solvers.take_reports()
        return self._phi, efield


class ChargeOnMesh(QuantitiesOnMesh):
    """Quantities of charge whose field is found anew."""

    def __init__(self, memory: Memory, particles: Particles, deposited: float) -> None:
        assert particles.sorting is not None
        super().__init__(particles, particles.sorting.hierarchy)
        self._memory, self._deposited = memory, deposited

    def followed(self, hysteresis: float, sort: Sort) -> ChargeOnMesh:
        """Return those of the same particles on a mesh that is refined where the rule asks for it. Collective.

        `sort`: sorts particles on a mesh, given who serves which.
        """
        refinement = self._memory.refinement
        return follow(
            self,
            refinement.levels,
            lambda present: refined(present, refinement, hysteresis)[0],
            lambda present, hierarchy: present._on(hierarchy, sort),
        )

    def _on(self, hierarchy: Hierarchy, sort: Sort) -> ChargeOnMesh:
        particles = sort(hierarchy, self.particles, shared_out_by_work(self.particles, hierarchy))
        return ChargeOnMesh(self._memory, particles, self._deposited)

    def _rho(self) -> Field:
        return deposit(self.particles, self.hierarchy, self._memory.clouds)

    def _phi(self) -> Field:
        return self._solved()[0]

    def _efield(self) -> VectorField:
        return self._solved()[1]

    def _solved(self) -> tuple[Field, VectorField]:
        """Return potential and field, of which the one that is not asked for is kept as well. Collective."""
        phi, efield = self._memory.self_field(self["rho"], self._deposited)
        self._made.update(phi=phi, efield=efield)
        return phi, efield

"""The field of charge on a mesh that follows it: deposit, solve, and the field that particles feel."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from ..errors import SolverError
from ..mesh.field import Field, VectorField
from ..mesh.hierarchy import Hierarchy
from ..particles.clouds import PLAIN
from ..particles.particles import Particles
from ..scene.refinement import Refinement
from ..scene.solver_options import SolverOptions
from ..stages.deposit import deposit
from ..stages.gather import compensate
from ..stages.migrate import shared_out_by_work
from ..stages.poisson import PoissonSolver, SolveReport
from ..stages.regrid import carry_over
from .quantities import QuantitiesOnMesh
from .tagging_rules import refined

Sort = Callable[[Hierarchy, Particles, np.ndarray | None], Particles]


class SelfField:
    """What finds the field of particles on a hierarchy: a solver that lives as long as that, and the potential to start from.

    Particles are values that come and go; φ and the estimate of the mesh's error stay for the next solve.
    """

    def __init__(self, refinement: Refinement, options: SolverOptions) -> None:
        self.refinement, self.options = refinement, options
        self.clouds = PLAIN
        self.report: SolveReport | None = None  # of the latest solve
        self._solver: PoissonSolver | None = None
        self._phi: Field | None = None

    def start_anew(self) -> None:
        """Forget the potential, as for other charge."""
        self._phi = self.report = None

    def solved(self, rho: Field, deposited: float) -> tuple[Field, VectorField]:
        """Return φ (V) of a density, and the E (V/m) that its particles feel. Collective; SolverError if the solve fails.

        `deposited`: Σ |q| in C, of which rounding is no net charge.
        """
        solver, hierarchy = self._on(rho.hierarchy), rho.hierarchy
        same = self._phi is not None and self._phi.hierarchy is hierarchy
        guess = self._phi if same or self._phi is None else carry_over(self._phi, hierarchy)
        phi, report = solver.solve(rho, guess, last=self.report if same else None, deposited=deposited)
        if not report.converged:
            reached = report.residuals[-1] if report.residuals else float("nan")
            raise SolverError(f"residual {reached:.1e} after {report.cycles} cycles ({report.reason}); {report.remedy}")
        self._phi, self.report = phi, report
        efield = solver.deferred_field(phi, covered=self.clouds.covered)
        compensate(efield, rho, self.clouds, self.options.stretch)
        return phi, efield

    def follow(self, particles: Particles, deposited: float, hysteresis: float, sort: Sort) -> Particles:
        """Return the particles sorted on a mesh that is refined where the rule asks for it. Collective.

        `sort`: sorts particles on a mesh, given who serves which.
        """
        for _ in range(2 * self.refinement.levels):  # not for ever, where a rule goes round in circles
            hierarchy = refined(ChargeOnMesh(self, particles, deposited), self.refinement, hysteresis)[0]
            if particles.sorting is not None and hierarchy is particles.sorting.hierarchy:
                break
            particles = sort(hierarchy, particles, shared_out_by_work(particles, hierarchy))
        return particles

    def _on(self, hierarchy: Hierarchy) -> PoissonSolver:
        solver = self._solver
        if solver is not None and solver.hierarchy is hierarchy:
            return solver
        kept = solver.base_setup if solver is not None and solver.hierarchy.domain == hierarchy.domain else None
        solver = self._solver = None  # the old operators go before the new ones come
        self._solver = PoissonSolver(hierarchy, options=self.options, reuse=kept)
        return self._solver


class ChargeOnMesh(QuantitiesOnMesh):
    """Those of charge whose field is found anew."""

    def __init__(self, of: SelfField, particles: Particles, deposited: float) -> None:
        assert particles.sorting is not None
        super().__init__(particles, particles.sorting.hierarchy)
        self._of, self._deposited = of, deposited

    def _rho(self) -> Field:
        return deposit(self.particles, self.hierarchy, self._of.clouds)

    def _phi(self) -> Field:
        return self._solved()[0]

    def _efield(self) -> VectorField:
        return self._solved()[1]

    def _solved(self) -> tuple[Field, VectorField]:
        """Return potential and field, of which the one that is not asked for is kept as well. Collective."""
        phi, efield = self._of.solved(self["rho"], self._deposited)
        self._made.update(phi=phi, efield=efield)
        return phi, efield


def with_levels(refinement: Refinement, levels: int) -> Refinement:
    """Return the refinement with another number of levels."""
    return refinement if levels == refinement.levels else refinement.model_copy(update={"levels": levels})

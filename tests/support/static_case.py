"""Case `static` of the verification, solved; its source and what measures errors."""

from __future__ import annotations

from mpi4py import MPI

import amrpic
from amrpic.stages.poisson import PoissonSolver
from exact.amrex import static as static_hierarchy
from exact.amrex import static_source
from exact.errors import level_errors as errors
from exact.errors import observed_order
from exact.sources import EPS0, Gaussian

__all__ = ["EPS0", "STATIC", "Gaussian", "errors", "observed_order", "solve_static", "static_hierarchy"]

STATIC = static_source()


def solve_static(comm: MPI.Comm, n0: int, max_grid_size: int = 24, **options):
    """Solve case `static n0`: (solver, phi, report)."""
    hierarchy = static_hierarchy(comm, n0, max_grid_size)
    solver = PoissonSolver(hierarchy, **options)
    rho = amrpic.Field(hierarchy).fill(STATIC.density)
    phi, report = solver.solve(rho, boundary_values=STATIC.potential)
    return solver, phi, report

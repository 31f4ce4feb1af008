"""Stopping at the error of the mesh: the estimate against the true error, and what the answer loses."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Literal

import numpy as np
from mpi4py import MPI

from ..field import Field
from ..hierarchy import Hierarchy
from ..poisson import PoissonSolver, SolveReport
from . import peers
from .convergence import smooth
from .errors import errors
from .meshes import MESHES
from .sources import Gaussian, Source, Together, fill
from .table import Cell, Goal, Table

LOST = 1.05  # of the error, at most
SEEN = 0.7  # of the largest true error of φ, at least, that the estimate shows


def tables(comm: MPI.Comm) -> Iterator[Table]:
    """The table of this topic. Collective."""
    yield Table(
        'tolerance = "discretization"',
        "Estimated over true largest error of φ; errors of φ and E (max) over those of a solve to 1e-10; cycles of both, of "
        "which the estimate takes one more. Where ρ is the mean over each cell instead of its value at the centre, the error "
        "of φ at cell centres is less than what the truncation error makes, so that the estimate is high.",
        ("case", "estimate over true", "φ", "E", "cycles", "to 1e-10"),
        [[name, *_row(*case)] for name, case in _cases(comm)],
    )


def _cases(comm: MPI.Comm) -> Iterator[tuple[str, tuple[Field, Source]]]:
    static, bunch = peers.static(comm, 64), peers.bunch(comm, 64)
    yield "static 64, point values", (_points(static, peers.static_source()), peers.static_source())
    yield "bunch 64, point values", (_points(bunch, peers.bunch_source()), peers.bunch_source())
    yield "static 64", (fill(Field(static), peers.static_source()), peers.static_source())
    for name in ("uniform", "nested cubes", "patch at a corner", "six levels off centre", "cells 1:1:10"):
        source = smooth(MESHES[name].size)
        yield f"smooth, {name}", (fill(Field(MESHES[name].hierarchy(comm, 32, "dirichlet")), source), source)
    gaussian = Gaussian((0.06,) * 3, (0.5,) * 3)
    yield "Gaussian, open faces", (fill(Field(MESHES["nested cubes"].hierarchy(comm, 32, "open")), gaussian), gaussian)


def _points(hierarchy: Hierarchy, source: Gaussian | Together) -> Field:
    return Field(hierarchy).fill(source.density)


def _row(rho: Field, source: Source) -> list[Cell]:
    converged, full = _solved(rho, source, 1e-10)
    stopped, short = _solved(rho, source, "discretization")
    estimate = short.discretization_error / (converged[0] * converged[2])
    lost = [Goal(a / b, LOST) for a, b in zip(stopped[:2], converged[:2], strict=True)]
    cycles = Goal(short.cycles if short.converged else np.nan, full.cycles - 1)
    return [Goal(estimate, SEEN, least=True), *lost, cycles, full.cycles]


def _solved(
    rho: Field, source: Source, tolerance: float | Literal["discretization"]
) -> tuple[tuple[float, float, float], SolveReport]:
    """Largest relative errors of φ and E, the largest φ, and the report."""
    solver = PoissonSolver(rho.hierarchy, tolerance=tolerance)
    phi, report = solver.solve(rho, boundary_values=source.potential)
    found = errors([phi], source.potential)[1], errors(solver.electric_field(phi).components, source.field)[1]
    return (*found, phi.max_abs()), report

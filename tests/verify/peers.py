"""Accuracy beside a mature solver: AMReX's MLMG on the same meshes, with the same charge and walls."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from mpi4py import MPI

from amrpic.mesh.field import Field
from amrpic.mesh.hierarchy import Hierarchy
from amrpic.stages.poisson import PoissonSolver
from amrpic.verify.table import Cell, Goal, Table
from exact.amrex import PEER, bunch, bunch_source, static, static_source
from exact.errors import level_errors
from exact.sources import Gaussian, Together

from .lengths import in_brief

MARGIN = 1.05
ON_INTERFACE = 1.1e-2  # largest error of E on level 1; a gradient through averaged-down φ gives twice as much


def tables(comm: MPI.Comm) -> Iterator[Table]:
    """The tables of this topic. Collective."""
    yield Table(
        "Accuracy beside AMReX",
        f"Errors per level over uncovered cells; each at most {MARGIN} times the peer's, which its goal names. L2 relative to "
        "the level's own norm, max to the largest value of all levels. Point values of ρ, Dirichlet walls at the exact "
        "potential. static: one Gaussian in two nested cubes; bunch: ten Gaussians and boxes that follow them.",
        ("case", "level", "φ L2", "φ max", "E L2", "E max"),
        [row for case in (("static 64",) if in_brief() else PEER) for row in _rows(comm, case)],
    )
    if in_brief():
        return
    yield Table(
        "Charge on a coarse-fine face",
        "static 64 with the Gaussian's centre at x = 0.625, on a face of level 2: the largest error of E on each level.",
        ("level", "E max"),
        _on_interface(comm),
    )


def _rows(comm: MPI.Comm, case: str) -> Iterator[list[Cell]]:
    name, n = case.split()
    hierarchy, source = (
        (static(comm, int(n)), static_source()) if name == "static" else (bunch(comm, int(n)), bunch_source())
    )
    for level, (found, peer) in enumerate(zip(_errors(hierarchy, source), PEER[case], strict=True)):
        yield [case, level, *(Goal(value, MARGIN * limit) for value, limit in zip(found, peer, strict=True))]


def _on_interface(comm: MPI.Comm) -> list[list[Cell]]:
    found = _errors(static(comm, 64), static_source(x=0.625))
    return [[level, Goal(row[3], ON_INTERFACE) if level == 1 else row[3]] for level, row in enumerate(found)]


def _errors(hierarchy: Hierarchy, source: Gaussian | Together) -> list[tuple[float, float, float, float]]:
    """Per level: L2 and max of φ, L2 and max of E."""
    solver = PoissonSolver(hierarchy)
    rho = Field(hierarchy).fill(source.density)
    phi, report = solver.solve(rho, boundary_values=source.potential)
    efield = solver.electric_field(phi)
    if not report.converged:
        return [(np.nan,) * 4] * hierarchy.levels
    of_phi, of_field = level_errors([phi], source.potential), level_errors(efield.components, source.field)
    return [(*a, *b) for a, b in zip(of_phi, of_field, strict=True)]

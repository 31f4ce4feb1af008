"""Accuracy beside a mature solver: AMReX's MLMG on the same meshes, with the same charge and walls."""

from __future__ import annotations

import json
from collections.abc import Iterator
from importlib.resources import files

import numpy as np
from mpi4py import MPI

from ..mesh.domain import BoundarySpec, Domain
from ..mesh.field import Field
from ..mesh.hierarchy import Hierarchy
from .chosen import solver_of
from .errors import level_errors
from .sources import EPS0, Gaussian, Together
from .table import Cell, Goal, Table

MARGIN = 1.05
# Per level: φ L2 relative to the level's own norm, φ max relative to that of all levels, E L2, E max; by AMReX 24.10.
PEER: dict[str, list[tuple[float, float, float, float]]] = {
    "static 64": [
        (6.8e-5, 2.7e-5, 1.12e-3, 2.0e-4),
        (1.0e-4, 4.4e-5, 1.07e-3, 7.5e-4),
        (2.2e-4, 8.2e-4, 1.11e-3, 2.2e-3),
    ],
    "static 128": [
        (1.7e-5, 6.5e-6, 2.8e-4, 5.2e-5),
        (2.5e-5, 1.1e-5, 2.6e-4, 1.9e-4),
        (5.6e-5, 2.1e-4, 2.8e-4, 5.4e-4),
    ],
    "bunch 64": [
        (9.4e-5, 2.8e-4, 3.5e-3, 2.9e-3),
        (1.4e-4, 2.7e-4, 4.0e-3, 5.0e-3),
        (3.9e-4, 3.4e-3, 4.6e-3, 1.26e-2),
    ],
    "bunch 128": [
        (4.3e-5, 1.4e-4, 1.5e-3, 2.4e-3),
        (8.6e-5, 8.8e-5, 1.6e-3, 2.0e-3),
        (1.3e-4, 8.2e-4, 1.3e-3, 4.6e-3),
    ],
}
ON_INTERFACE = 1.1e-2  # largest error of E on level 1; a gradient through averaged-down φ gives twice as much


def tables(comm: MPI.Comm) -> Iterator[Table]:
    """The tables of this topic. Collective."""
    yield Table(
        "Accuracy beside AMReX",
        f"Errors per level over uncovered cells; each at most {MARGIN} times the peer's, which its goal names. L2 relative to "
        "the level's own norm, max to the largest value of all levels. Point values of ρ, Dirichlet walls at the exact "
        "potential. static: one Gaussian in two nested cubes; bunch: ten Gaussians and boxes that follow them.",
        ("case", "level", "φ L2", "φ max", "E L2", "E max"),
        [row for case in PEER for row in _rows(comm, case)],
    )
    yield Table(
        "Charge on a coarse-fine face",
        "static 64 with the Gaussian's centre at x = 0.625, on a face of level 2: the largest error of E on each level.",
        ("level", "E max"),
        _on_interface(comm),
    )


def static(comm: MPI.Comm, n: int, max_grid_size: int = 32, walls: BoundarySpec = "dirichlet") -> Hierarchy:
    """The unit cube of n³ cells, and two nested cubes of as many in its middle. Collective."""
    domain = Domain((0, 0, 0), (1, 1, 1), (n,) * 3, boundary=walls)
    first = [((n // 2,) * 3, (3 * n // 2 - 1,) * 3)]
    second = [((3 * n // 2,) * 3, (5 * n // 2 - 1,) * 3)]
    return Hierarchy(comm, domain, [first, second], max_grid_size=max_grid_size)


def static_source(x: float = 0.5) -> Gaussian:
    """The Gaussian of the case, of unit charge over ε₀."""
    return Gaussian((0.03,) * 3, (x, 0.5, 0.5), EPS0)


def bunch(comm: MPI.Comm, n: int, max_grid_size: int = 32) -> Hierarchy:
    """The unit cube of n³ cells (64 or 128) with boxes around ten Gaussians. Collective."""
    domain = Domain((0, 0, 0), (1, 1, 1), (n,) * 3, boundary="dirichlet")
    return Hierarchy(comm, domain, _bunch_data()[f"levels_{n}"], max_grid_size=max_grid_size)


def bunch_source() -> Together:
    """The ten Gaussians."""
    rows = _bunch_data()["bunches"]
    return Together(tuple(Gaussian((s,) * 3, (x, y, z), q * EPS0) for x, y, z, s, q in rows))


def _bunch_data() -> dict:
    return json.loads((files(__package__) / "bunch.json").read_text())


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
    solver = solver_of(hierarchy)
    rho = Field(hierarchy).fill(source.density)
    phi, report = solver.solve(rho, boundary_values=source.potential)
    efield = solver.electric_field(phi)
    if not report.converged:
        return [(np.nan,) * 4] * hierarchy.levels
    of_phi, of_field = level_errors([phi], source.potential), level_errors(efield.components, source.field)
    return [(*a, *b) for a, b in zip(of_phi, of_field, strict=True)]

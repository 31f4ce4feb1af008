"""One solver, two executions: the backends give the same potential and field."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import get_args

import numpy as np
from mpi4py import MPI

from amrpic.mesh.domain import BoundarySpec
from amrpic.mesh.field import Field
from amrpic.mesh.hierarchy import Hierarchy
from amrpic.scene import solver_options
from amrpic.stages.poisson import PoissonSolver
from amrpic.verify.table import Cell, Goal, Table
from exact.meshes import MESHES
from exact.sources import Gaussian, Source, fill

from .convergence import smooth

CELLS = 32
SAME = 1e-8  # of the largest value, after solves to 1e-11


def tables(comm: MPI.Comm) -> Iterator[Table]:
    """The table of this topic; none while there is one backend alone. Collective."""
    first, *others = get_args(solver_options.Backend)
    for other in others:
        yield Table(
            f"Backend {other} beside {first}",
            f"Both solve to 1e-11 on {CELLS}³ base cells: largest difference of φ and of E over the largest value.",
            ("mesh", "faces", "φ", "E", f"cycles, {first}", f"cycles, {other}"),
            [
                [name, faces, *_compared(MESHES[name].hierarchy(comm, CELLS, boundary), _source(name), (first, other))]
                for name in MESHES
                for faces, boundary in FACES.items()
            ],
        )


FACES: Mapping[str, BoundarySpec] = {
    "dirichlet": "dirichlet",
    "open": "open",
    "neumann, dirichlet": {"x": "neumann", "y": ("dirichlet", "neumann"), "z": "dirichlet"},
    "periodic along x": {"x": "periodic", "y": "dirichlet", "z": "neumann"},
}


def _source(mesh: str) -> Source:
    """A bunch off the middle, over a smooth potential at the walls."""
    return Gaussian(tuple(0.1 * s for s in MESHES[mesh].size), tuple(0.45 * s for s in MESHES[mesh].size))  # type: ignore[arg-type]


def _compared(hierarchy: Hierarchy, source: Source, backends: tuple[str, str]) -> list[Cell]:
    walls = smooth((1, 1, 1)).potential
    found, cycles = [], []
    for backend in backends:
        solver = PoissonSolver(hierarchy, tolerance=1e-11, backend=backend)
        phi, report = solver.solve(fill(Field(hierarchy), source), boundary_values=walls)
        found.append((phi, *solver.electric_field(phi).components))
        cycles.append(report.cycles if report.converged else np.nan)
    parts = [(_apart(a, b), b.max_abs()) for a, b in zip(*found, strict=True)]
    of_phi, of_field = parts[0], parts[1:]
    return [
        Goal(of_phi[0] / of_phi[1], SAME),
        Goal(max(d for d, _ in of_field) / max(size for _, size in of_field), SAME),
        *cycles,
    ]


def _apart(a: Field, b: Field) -> float:
    """Largest difference in uncovered cells. Collective."""
    difference = a.copy()
    for level in range(a.hierarchy.levels):
        difference.array(level)[:] -= b.array(level)
    return difference.max_abs()

"""Narrow gaps between refined blocks: errors of φ and E where no face has a block of coarse cells to interpolate in."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from math import inf

import numpy as np
from mpi4py import MPI

from amrpic.mesh.field import Field
from amrpic.mesh.hierarchy import Hierarchy
from amrpic.stages.poisson import PoissonSolver
from amrpic.verify.table import Goal, Table
from exact.errors import errors, level_errors, observed_order
from exact.meshes import blocks
from exact.sources import Product, Wave, fill

from .curves import Curves

SMOOTH = Product((Wave(4.0, 0.3), Wave(5.0, -0.4), Wave(4.0, 0.2)))
CYCLES = 10  # to 1e-10


@dataclass(frozen=True)
class Gaps:
    """Refined blocks of so many fine cells, and the largest errors: of φ over that of the base alone, and of E, L2 and max."""

    chosen: Callable[[int, int, int], bool]
    cells: int = 16
    block: int = 4
    goals: tuple[float, float, float] = (inf, inf, inf)


def checkerboard(i: int, j: int, k: int) -> bool:
    return (i + j + k) % 2 == 0


def within(i: int, j: int, k: int) -> bool:
    """Whether a block is none of the outermost of eight along each axis."""
    return min(i, j, k) > 0 and max(i, j, k) < 7


CASES = {
    "checkerboard, blocks of 4": Gaps(checkerboard, goals=(1.1, 6.5e-3, 1.3e-2)),
    "columns, blocks of 4": Gaps(lambda i, j, k: (i + j) % 2 == 0, goals=(inf, inf, 1.4e-2)),
    "bent tunnel, blocks of 4": Gaps(
        lambda i, j, k: within(i, j, k) and not (k == 3 and ((j == 3 and i <= 4) or (i == 4 and j >= 3))),
        goals=(inf, inf, 7e-3),
    ),
    "closed cavity, blocks of 4": Gaps(
        lambda i, j, k: within(i, j, k) and (i, j, k) != (3, 3, 3), goals=(inf, inf, 5.6e-3)
    ),
    "checkerboard, blocks of 2": Gaps(checkerboard, cells=8, block=2, goals=(inf, inf, 4e-2)),
}
SIZES = (12, 16, 24)
ORDERS = (1.9, 1.5)  # of E on the checkerboard from the first to the last of these, L2 and max


def tables(comm: MPI.Comm) -> Iterator[Table]:
    """The tables of this topic. Collective."""
    yield Table(
        "Narrow gaps",
        "Refined blocks beside gaps of one block, unit cube, base of 16³ cells (8³ for blocks of 2), φ = cos(4x + 0.3) "
        "cos(5y − 0.4) cos(4z + 0.2), potentials given at the walls: the largest error of φ over that of the base alone, and "
        "the errors of E on the fine level, over its largest value for the max.",
        ("mesh", "φ", "E, L2", "E, max", "cycles to 1e-10"),
        [_row(comm, name, case) for name, case in CASES.items()],
    )
    measured = [_solved(comm, Gaps(checkerboard, cells)) for cells in SIZES]
    norms = [np.array([m.efield[n] for m in measured]) for n in (0, 1)]
    orders = [observed_order((SIZES[0], SIZES[-1]), (e[0], e[-1])) for e in norms]
    yield Curves(
        "Narrow gaps: order",
        "Order of the error of E on the fine level of the checkerboard of blocks of 4, from a base of 12³ to one of 24³ cells.",
        ("norm", "order", "error, 24³"),
        [
            [name, Goal(order, bound, least=True), float(e[-1])]
            for name, order, bound, e in zip(("L2", "max"), orders, ORDERS, norms, strict=True)
        ],
        curves={name: (SIZES, list(map(float, e))) for name, e in zip(("L2", "max"), norms, strict=True)},
        upwards="error of E",
    )


@dataclass(frozen=True)
class Solved:
    potential: float  # the largest error, over that of the base alone
    efield: tuple[float, float]  # errors on the fine level, L2 and max
    cycles: float


def _row(comm: MPI.Comm, name: str, case: Gaps) -> list[str | float | Goal]:
    found = _solved(comm, case)
    measured = (found.potential, *found.efield)
    cells = [m if bound == inf else Goal(m, bound) for m, bound in zip(measured, case.goals, strict=True)]
    return [name, *cells, Goal(found.cycles, CYCLES)]


def _solved(comm: MPI.Comm, case: Gaps) -> Solved:
    hierarchy = blocks(comm, case.chosen, case.cells, case.block)
    solver = PoissonSolver(hierarchy, tolerance=1e-10)
    phi, report = solver.solve(fill(Field(hierarchy), SMOOTH), boundary_values=SMOOTH.potential)
    efield = solver.electric_field(phi)
    fine = level_errors((efield.x, efield.y, efield.z), SMOOTH.field)[1]
    base = Hierarchy(comm, hierarchy.domain)
    plain, _ = PoissonSolver(base, tolerance=1e-10).solve(fill(Field(base), SMOOTH), boundary_values=SMOOTH.potential)
    worst, alone = (errors([p], SMOOTH.potential)[1] for p in (phi, plain))
    return Solved(worst / alone, fine, report.cycles if report.converged else float("nan"))

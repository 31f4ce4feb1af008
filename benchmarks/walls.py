"""Time a solve with open walls beside one with grounded walls on the mesh of `ten_bunches`. A worker of `bench`."""

from __future__ import annotations

from collections.abc import Iterator
from functools import partial
from typing import Annotated

from mpi4py import MPI

import amrpic
from amrpic.stages.poisson import PoissonSolver
from measuring import BACKEND, Backend, Record, Runs, slowest, timed, work_unit
from open_boundary import density

TOLERANCE = 1e-10
WALLS = ("dirichlet", "open")


def beside(comm: MPI.Comm, base: int, backend: str, runs: int) -> list[Record]:
    """Return the records of both solves from a zero guess, run in turns, on base³ cells and what refines them. Collective."""
    of_open = density(comm, base, "ten_bunches", ())
    mesh = of_open.hierarchy
    boxes = [mesh.boxes(level) for level in range(1, mesh.levels)]
    domain = mesh.domain
    grounded = amrpic.Domain(domain.lower, domain.upper, domain.cells, boundary="dirichlet")
    closed = amrpic.Hierarchy(comm, grounded, boxes, mesh.max_grid_size, mesh.blocking_factor)
    of_closed = amrpic.Field(closed)
    for level in range(mesh.levels):
        of_closed.array(level)[:] = of_open.array(level)
    cells = sum(mesh.cells(level) for level in range(mesh.levels))
    unit = work_unit(comm, cells)
    charges = {"dirichlet": of_closed, "open": of_open}
    solvers = {
        walls: PoissonSolver(charge.hierarchy, tolerance=TOLERANCE, backend=backend)
        for walls, charge in charges.items()
    }
    for walls in WALLS:
        solvers[walls].solve(charges[walls])  # tables of free space, and pages, come into being
    taken: dict[str, list[float]] = {walls: [] for walls in WALLS}
    facts = {}
    for _ in range(runs):
        for walls in WALLS:
            seconds, (_, report) = timed(comm, 1, partial(solvers[walls].solve, charges[walls]))
            taken[walls] += seconds
            facts[walls] = {"cycles": report.cycles, "stages": slowest(comm, report.seconds)}
    return [
        Record(walls_name(base, walls), taken[walls], facts=facts[walls], **unit.record_fields(cells))
        for walls in WALLS
    ]


def walls_name(base: int, walls: str) -> str:
    return f"walls, ten_bunches {base}, {walls}"


def run(
    backend: Backend = BACKEND,
    base: Annotated[int, "cells of the base along an axis"] = 144,
    runs: Runs = 5,
) -> Iterator[Record]:
    """Both solves. Collective."""
    yield from beside(MPI.COMM_WORLD, base, backend, runs)

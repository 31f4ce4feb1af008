"""Time a solve with open walls beside one with grounded walls on the mesh of `ten_bunches`. A worker of `bench`."""

from __future__ import annotations

import argparse
from functools import partial
from pathlib import Path

from mpi4py import MPI

import amrpic
from amrpic.stages.poisson import PoissonSolver
from measuring import BACKEND, BACKENDS, Record, slowest, timed, work_unit, write
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


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--backend", default=BACKEND, choices=BACKENDS, help="how the operators are executed")
    parser.add_argument("--base", type=int, default=144, help="cells of the base along an axis")
    parser.add_argument("--runs", type=int, default=5, help="runs of each")
    parser.add_argument("--output", type=Path, required=True, help="the JSON to write")
    given = parser.parse_args()
    comm = MPI.COMM_WORLD
    records = beside(comm, given.base, given.backend, given.runs)
    if comm.rank == 0:
        for record in records:
            print(f"{record.name}: {record.median:.4g} s, {record.units:.0f} work units", flush=True)
        write(given.output, records)
    return 0

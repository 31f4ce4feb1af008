"""What order 4 takes of time and memory beside order 2: `python benchmarks orders`. A worker of `bench`."""

from __future__ import annotations

import argparse
from collections.abc import Iterator
from functools import partial
from pathlib import Path

from mpi4py import MPI

import amrpic
from amrpic.mesh.field import Holds
from amrpic.stages.poisson import PoissonSolver
from cases import Remembered
from exact import amrex
from exact.sources import fill
from measuring import Record, in_turns, reset_peak, resident, write

CASES = (64, 128)
WALLS = ("dirichlet", "open")
DENSITIES: dict[str, tuple[int, Holds]] = {
    "order 2": (2, "points"),
    "order 4": (4, "means"),
    "order 4 of points": (4, "points"),
}


def name(cells: int, walls: str, density: str) -> str:
    return f"orders, static {cells}, {walls}, {density}"


def beside(cells: int, walls: str, runs: int) -> Iterator[Record]:
    """Yield solves of static from zero, in turns, in CPU time, with the bytes per cell that each takes beyond ρ and φ."""
    hierarchy = amrex.static(MPI.COMM_SELF, cells, walls=walls)
    source = amrex.static_source()
    values = Remembered(source.potential)
    count = sum(hierarchy.cells(level) for level in range(hierarchy.levels))
    works, facts = [], []
    for order, holds in DENSITIES.values():
        rho = fill(amrpic.Field(hierarchy), source)
        rho.holds = holds
        before = resident("VmRSS")
        reset_peak()
        solver = PoissonSolver(hierarchy, order=order)
        works.append(partial(solver.solve, rho, boundary_values=values))
        _, report = works[-1]()
        taken = resident("VmHWM") - before - 8 * count  # less the potential
        facts.append({"cycles": report.cycles, "bytes per cell": taken / count, "stages": report.seconds})
    for density, seconds, known in zip(DENSITIES, in_turns(works, runs), facts, strict=True):
        yield Record(name(cells, walls, density), seconds, cells=count, facts=known)


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--runs", type=int, default=5, help="runs of each")
    parser.add_argument("--cells", type=int, nargs="+", default=CASES, help="base cells along an axis")
    parser.add_argument("--output", type=Path, help="the JSON to write")
    given = parser.parse_args()
    records: list[Record] = []
    for cells in given.cells:
        for walls in WALLS:
            found = list(beside(cells, walls, given.runs))
            for record in found:
                stages = ", ".join(f"{stage} {seconds:.3f}" for stage, seconds in record.facts["stages"].items())
                print(
                    f"{record.name}: {record.median:.3f} s, {record.median / found[0].median:.2f} of order 2's, "
                    f"{record.facts['cycles']} cycles, {record.facts['bytes per cell']:.1f} B per cell; {stages}",
                    flush=True,
                )
            records += found
    if given.output is not None:
        write(given.output, records)
    return 0

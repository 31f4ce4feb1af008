"""What order 4 takes of time and memory beside order 2: `python benchmarks orders`. A worker of `bench`."""

from __future__ import annotations

import itertools
from collections.abc import Iterator
from functools import partial
from typing import Annotated

from mpi4py import MPI

import amrpic
from amrpic.mesh.field import Holds
from amrpic.stages.poisson import PoissonSolver
from cases import Remembered
from exact import amrex
from exact.sources import fill
from measuring import Record, Runs, in_turns, reset_peak, resident

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


def run(runs: Runs = 5, cells: Annotated[tuple[int, ...], "base cells along an axis"] = CASES) -> Iterator[Record]:
    """All cases."""
    for count, walls in itertools.product(cells, WALLS):
        yield from beside(count, walls, runs)


def printed(record: Record) -> str:
    facts = record.facts
    stages = ", ".join(f"{stage} {seconds:.3f}" for stage, seconds in facts["stages"].items())
    each = f"{facts['bytes per cell']:.1f} B per cell"
    return f"{record.name}: {record.median:.3f} s, {facts['cycles']} cycles, {each}; {stages}"

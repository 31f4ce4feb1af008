"""Time solves in the rest frame of fast bunches, on cells γ times as long, beside cubes on the same mesh. A worker of `bench`.

64³ cells and one refined level of most of the domain, or three nested ones; grounded and open walls; boxes of several sizes.
Each is measured in a process of its own, for its memory; one that takes too long, or fails, is skipped, and the table says so.
"""

from __future__ import annotations

import itertools
import math
import statistics
from collections.abc import Iterator, Mapping
from functools import partial
from typing import Annotated, Any

import numpy as np
from mpi4py import MPI

import amrpic
from amrpic.stages.poisson import PoissonSolver
from exact.sources import EPS0
from measuring import Record, Runs, in_turns, launch_or_skip, reset_peak, resident, timed
from solving import FULL

GAMMAS = (10, 20, 50, 100)
MESHES = {  # levels beyond the base, by the first and the last cell along each axis
    "one level": ((8, 119),),
    "three levels": ((32, 95), (96, 159), (224, 287)),
}
WALLS = ("dirichlet", "open")
BOXES = (16, 24, 32)
CUBES = ", cubes"  # what the name of the solve beside ends in
LIMIT = 60.0  # s, of one process
BYTES_PER_CELL, BYTES = 40, 100e6  # that the solver may take


def measure(gamma: float, mesh: str, walls: str, boxes: int, turns: int, seconds: float) -> Iterator[Record]:
    """Yield the solves on long cells and on cubes, in as many turns as fit into about so many seconds, at least one."""
    domain = amrpic.Domain((0, 0, 0), (1, 1, 1), (64,) * 3, boundary=walls)
    levels = [[((first,) * 3, (last,) * 3)] for first, last in MESHES[mesh]]
    hierarchy = amrpic.Hierarchy(MPI.COMM_SELF, domain, levels, boxes)
    cells = sum(hierarchy.cells(level) for level in range(hierarchy.levels))
    rho, guess = amrpic.Field(hierarchy).fill(density), amrpic.Field(hierarchy)
    for level in range(hierarchy.levels):
        guess.array(level)[:] = 0.0  # its pages exist
    small = amrpic.Hierarchy(MPI.COMM_SELF, amrpic.Domain((0, 0, 0), (1, 1, 1), (16,) * 3, boundary="dirichlet"))
    PoissonSolver(small)  # libraries are loaded

    before = resident("VmRSS")
    reset_peak()
    first = 0.0
    works, reports = [], []
    beyond = math.nan
    for stretch in (gamma, 1.0):
        solver = PoissonSolver(hierarchy, tolerance=FULL, stretch=(1.0, 1.0, stretch))
        works.append(partial(solver.solve, rho, guess=guess))
        taken, (phi, report) = timed(MPI.COMM_SELF, 1, works[-1])
        if stretch == gamma:
            beyond = resident("VmHWM") - before - 8 * cells  # less the potential that it returns
        del phi
        first += taken[0]
        reports.append(report)
    times = in_turns(works, min(turns, int(seconds / first)))
    label = gamma_name(gamma, mesh, walls, boxes)
    for one, taken, report in zip((label, label + CUBES), times, reports, strict=True):
        facts: dict[str, Any] = {"cycles": report.cycles, "converged": report.converged}
        if one == label:
            facts["bytes beyond"] = beyond
        yield Record(one, taken, cells=cells, facts=facts)


def density(x: np.ndarray, y: np.ndarray, z: np.ndarray) -> np.ndarray:
    return EPS0 * np.exp(-((x - 0.5) ** 2 + (y - 0.5) ** 2 + (z - 0.5) ** 2) / (2 * 0.06**2))


def gamma_name(gamma: float, mesh: str, walls: str, boxes: int) -> str:
    return f"gamma, {gamma:g}, {mesh}, {walls}, boxes {boxes}"


def gamma_ratio(records: Mapping[str, Record], record: Record) -> float:
    """Return the time over that of cubes, the median of the turns; infinite if it was skipped."""
    if record.skipped:
        return math.inf
    turns = zip(record.seconds, records[record.name + CUBES].seconds, strict=True)
    return statistics.median(one / other for one, other in turns)


def memory_ratio(record: Record) -> float:
    """Return the solver's memory over what it may take; infinite if it was skipped."""
    if record.skipped:
        return math.inf
    return float(record.facts["bytes beyond"]) / (BYTES_PER_CELL * record.cells + BYTES)


def rows(records: Mapping[str, Record]) -> list[tuple[str, ...]]:
    """Return the table: the case, cycles beside those of cubes, the ratio, and memory."""
    out: list[tuple[str, ...]] = [
        ("γ", "mesh", "walls", "boxes", "cycles", "of cubes", "time over that of cubes", "memory beyond φ and ρ")
    ]
    for record in records.values():
        if record.keys[0] != "gamma" or record.name.endswith(CUBES):
            continue
        case = (*record.keys[1:4], record.keys[4].removeprefix("boxes "))
        if record.skipped:
            out.append((*case, "–", "–", record.skipped, "–"))
            continue
        cubes = records[record.name + CUBES]
        cycles = f"{record.facts['cycles']}{'' if record.facts['converged'] else ', not converged'}"
        memory = (
            f"{record.facts['bytes beyond'] / record.cells:.0f} B/cell, {record.facts['bytes beyond'] / 1e6:.0f} MB"
        )
        ratio = f"{gamma_ratio(records, record):.2f}×"
        out.append((*case, cycles, str(cubes.facts["cycles"]), ratio, memory))
    return out


def run(
    gammas: tuple[float, ...] = GAMMAS,
    meshes: Annotated[tuple[str, ...], "kinds", MESHES] = tuple(MESHES),
    walls: Annotated[tuple[str, ...], "kinds", WALLS] = WALLS,
    boxes: tuple[int, ...] = BOXES,
    runs: Runs = 5,
    limit: Annotated[float, "seconds for a case"] = LIMIT,
    alone: Annotated[bool, "measure the only case in this process"] = False,
) -> Iterator[Record]:
    """Each case, in a process of its own."""
    records: list[Record] = []
    for case in itertools.product(gammas, meshes, walls, boxes):
        if alone:
            records += measure(*case, runs, limit / 3)
            continue
        options = zip(("--gammas", "--meshes", "--walls", "--boxes"), map(str, case), strict=True)
        arguments = ["--alone", *itertools.chain(*options), "--runs", str(runs), "--limit", str(limit)]
        records += launch_or_skip("gamma", arguments, gamma_name(*case), limit)
    if not alone:
        for row in rows({record.name: record for record in records}):
            print("  ".join(row), flush=True)
    yield from records

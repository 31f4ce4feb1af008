"""Measure one case once, in a process of its own: a worker of benchmarks/compare.py.

Prints, as JSON on its last line, the least CPU and wall time of each of the case's works, and of scipy's sine transform on
128³ cells, which takes turns with them. The least, since what disturbs a run can only make it longer; what differs between
processes (pages, the state of the machine) is left to the many turns of compare.py.
"""

from __future__ import annotations

import json
import time
from collections.abc import Callable
from functools import partial
from typing import Annotated

from mpi4py import MPI

import particles
from amrpic.stages.poisson import PoissonSolver
from cases import problem
from sine import Yardstick
from solving import FULL, follower

Work = Callable[[], object]
CLOCKS: dict[str, Callable[[], float]] = {"cpu": time.process_time, "wall": time.perf_counter}


def solve(case: str, boxes: int) -> tuple[dict[str, Work], int]:
    given = problem(MPI.COMM_SELF, case, boxes)
    solver = PoissonSolver(given.hierarchy, tolerance=FULL)
    return {"solve": partial(solver.solve, given.rho, boundary_values=given.walls)}, given.cells


def set_up(case: str, boxes: int) -> tuple[dict[str, Work], int]:
    given = problem(MPI.COMM_SELF, case, boxes)
    return {"set-up": lambda: [PoissonSolver(given.hierarchy, tolerance=FULL) for _ in range(5)]}, 5 * given.cells


def regrid(case: str, boxes: int) -> tuple[dict[str, Work], int]:
    given = problem(MPI.COMM_SELF, case, boxes)
    return {"regrid": partial(follower(given), lambda what: None)}, given.cells


def assembly(case: str, boxes: int) -> tuple[dict[str, Work], int]:
    given = problem(MPI.COMM_SELF, case, boxes)
    return {"assembly": lambda: PoissonSolver(given.hierarchy).operators(0)}, given.cells


def stages(count: int) -> tuple[dict[str, Work], int]:
    return {name: work for name, work in particles.stages(count, 128, 32).items() if name != "gather"}, count


CASES: dict[str, Callable[[], tuple[dict[str, Work], int]]] = {
    "uniform 128": partial(solve, "uniform 128", 64),
    "nested 64, boxes 24": partial(solve, "static 64", 24),
    "nested 64, boxes 64": partial(solve, "static 64", 64),
    "nested 128, boxes 64": partial(solve, "static 128", 64),
    "bunch 64, boxes 24": partial(solve, "bunch 64", 24),
    "set-up": partial(set_up, "bunch 64", 24),
    "regrid": partial(regrid, "bunch 64", 24),
    "assembly": partial(assembly, "bunch 64", 24),
    "particles 1e6": partial(stages, 1_000_000),
    "particles 1e7": partial(stages, 10_000_000),
}


def measure(case: str, repeats: int) -> dict[str, dict[str, float]]:
    """Return the least seconds per cell or particle of each work and, as "DST", of the sine transform per cell, by clock."""
    works, size = CASES[case]()
    yardstick = Yardstick()
    found: dict[str, dict[str, float]] = {}

    def run(name: str, work: Work, each: int) -> None:
        before = {clock: read() for clock, read in CLOCKS.items()}
        result = work()
        for clock, read in CLOCKS.items():
            taken = (read() - before[clock]) / each
            least = found.setdefault(clock, {})
            least[name] = min(least.get(name, taken), taken)
        del result

    for work in works.values():
        work()  # pages and tables come into being
    for _ in range(repeats):
        run("DST", yardstick.seconds_per_cell, yardstick.cells)
        for name, work in works.items():
            run(name, work, size)
    return found


def run(case: Annotated[str, "what is measured", tuple(CASES)] = "", repeats: int = 5) -> None:
    """Measure and print, as JSON."""
    print(json.dumps(measure(case, repeats)))

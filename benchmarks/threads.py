"""How much faster Kokkos' kernels are with several threads than with one: `python benchmarks threads --threads 2`.

The solve of static 128 in boxes of 64, and deposit and gather+push of 1e7 particles in 128³ cells: the least wall time of
each in a process of so many threads. For a build whose Kokkos has threads (docs/machine.md).
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
import time
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Annotated

PARTS = ("solve", "particles")


def works(part: str) -> dict[str, Callable[[], object]]:
    """Return what is timed, each by Kokkos' kernels."""
    from mpi4py import MPI

    from particles import BY_KOKKOS, stages

    if part == "particles":
        ready = stages(10**7, 128, 32, kernels="kokkos")
        return {f"{stage}, 1e7 particles": ready[stage] for stage in BY_KOKKOS}
    from amrpic.stages.poisson import PoissonSolver
    from cases import problem

    given = problem(MPI.COMM_SELF, "static 128", 64)
    solver = PoissonSolver(given.hierarchy, tolerance=1e-10, backend="kokkos")
    return {"solve, static 128": partial(solver.solve, given.rho, boundary_values=given.walls)}


def least_seconds(work: Callable[[], object], repeats: int) -> float:
    work()  # makes what is needed once
    taken = []
    for _ in range(repeats):
        start = time.perf_counter()
        work()
        taken.append(time.perf_counter() - start)
    return min(taken)


def measured(part: str, threads: int, repeats: int) -> dict[str, float]:
    """Return the seconds of a part in a process of its own."""
    environment = {"OMP_PROC_BIND": "spread", "OMP_PLACES": "threads", **os.environ, "OMP_NUM_THREADS": str(threads)}
    here = str(Path(__file__).parent)
    command = [sys.executable, here, "threads", "--parts", part, "--repeats", str(repeats), "--worker"]
    return json.loads(subprocess.run(command, env=environment, check=True, stdout=subprocess.PIPE).stdout)


def run(
    threads: int = 2,
    parts: Annotated[tuple[str, ...], "what is timed", PARTS] = PARTS,
    repeats: int = 5,
    worker: Annotated[bool, "measure here, with the threads that the environment sets"] = False,
) -> None:
    """Time each part with one thread and with several."""
    for part in parts:
        if worker:
            print(json.dumps({name: least_seconds(work, repeats) for name, work in works(part).items()}))
            continue
        alone, together = (measured(part, count, repeats) for count in (1, threads))
        for name, seconds in alone.items():
            ratio = seconds / together[name]
            print(f"{name}: {seconds:.3f} s, with {threads} threads {together[name]:.3f} s, {ratio:.2f} times")

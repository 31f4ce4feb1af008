"""The kernels of `solver.backend = "kokkos"` on a graphics card, beside the tuned loops on one core of its machine.

`python benchmarks card PART`, one of `first` (the smallest solve, deposit, gather and push, compared with those of the
host), `copy` (bandwidth of a copy in the card's memory) and `times` (solves and particle stages; wall time, the median of
five). Each line is printed as soon as it is known. docker/card/run calls all of them.
"""

from __future__ import annotations

import ctypes
import statistics
import time
from collections.abc import Callable, Sequence
from functools import partial
from typing import Annotated, Any

import numpy as np
from mpi4py import MPI

import amrpic
from amrpic import _native
from amrpic.stages.poisson import PoissonSolver
from cases import Problem, problem
from particles import BY_KOKKOS, stages

COPIED = 1 << 30  # bytes
SOLVES = (("static 64", 24), ("static 64", 64), ("static 128", 64), ("uniform 256", 256))
PARTICLES = ((10**6, 64), (10**7, 128))  # and base cells along an axis
BACKENDS = ("kokkos", "matrix-free")


def say(line: str) -> None:
    print(line, flush=True)


def first(cells: int) -> bool:
    """Compare a solve on two levels and the particle stages with the host's; return whether they agree."""
    domain = amrpic.Domain((0, 0, 0), (1, 1, 1), (cells,) * 3, boundary="dirichlet")
    refined = [[((cells // 2,) * 3, (3 * cells // 2 - 1,) * 3)]]
    hierarchy = amrpic.Hierarchy(MPI.COMM_SELF, domain, refined, max_grid_size=cells, blocking_factor=4)
    small = Problem(
        hierarchy, lambda x, y, z: 1e-9 * np.exp(-40 * ((x - 0.45) ** 2 + (y - 0.5) ** 2 + (z - 0.55) ** 2))
    )
    potentials, cycles = [], []
    for backend in BACKENDS:
        phi, report = PoissonSolver(hierarchy, tolerance=1e-10, backend=backend).solve(small.rho)
        potentials.append(np.concatenate([patch.data.ravel() for patch in phi.patches]))
        cycles.append(report.cycles)
    found = [far(*potentials)]
    say(f"solve, {small.cells} cells: cycles {cycles[0]} and {cycles[1]} on the host, φ differs by {found[0]:.1e}")
    kinds: list[dict[str, Callable[[], Any]]]
    kinds = [stages(4000, cells, cells, kernels=kernels) for kernels in ("kokkos", "vectors")]
    rho = [np.concatenate([patch.data.ravel() for patch in kind["deposit"]().patches]) for kind in kinds]
    momenta = [kind["gather+push"]().momentum for kind in kinds]
    for stage, pair in (("deposit", rho), ("gather and push", momenta)):
        found.append(far(*pair))
        say(f"{stage}, 4000 particles: differs by {found[-1]:.1e}")
    return cycles[0] == cycles[1] and max(found) < 1e-9


def far(ours: np.ndarray, reference: np.ndarray) -> float:
    """The largest difference over the largest value; nan if a value is."""
    return float(np.max(np.abs(ours - reference)) / np.max(np.abs(reference)))


def copy() -> None:
    """Print bytes read and written per second by copies within the card's memory, by the runtime's own calls."""
    if "Cuda" not in _native.kokkos_backend():
        return say("copy: not measured, kernels run on no card of CUDA")
    runtime = ctypes.CDLL("libcudart.so.13")

    def call(name: str, *arguments: object) -> None:
        if status := getattr(runtime, name)(*arguments):
            raise SystemExit(f"copy: {name} returned {status}")

    source, target = ctypes.c_void_p(), ctypes.c_void_p()
    for pointer in (source, target):
        call("cudaMalloc", ctypes.byref(pointer), ctypes.c_size_t(COPIED))

    def work() -> None:
        call("cudaMemcpy", target, source, ctypes.c_size_t(COPIED), 3)  # within the card
        call("cudaDeviceSynchronize")

    say(f"copy of 1 GiB: {2e-9 * COPIED / seconds(work, 20):.0f} GB/s read and written")


def seconds(work: Callable[[], object], repeats: int = 5) -> float:
    """The median of some runs after a first one."""
    work()
    taken = []
    for _ in range(repeats):
        start = time.perf_counter()
        work()
        taken.append(time.perf_counter() - start)
    return statistics.median(taken)


def beside(name: str, count: int, unit: str, works: Sequence[Callable[[], object]]) -> None:
    ours, core = (seconds(work) for work in works)
    say(
        f"{name}: {1e9 * ours / count:.2f} ns per {unit}, a core {1e9 * core / count:.2f}, {core / ours:.2f} times as fast"
    )


def times() -> None:
    """Print what solves and particle stages take."""
    for case, boxes in SOLVES:
        given = problem(MPI.COMM_SELF, case, boxes)
        solvers = [PoissonSolver(given.hierarchy, tolerance=1e-10, backend=backend) for backend in BACKENDS]
        reports = [solver.solve(given.rho, boundary_values=given.walls)[1] for solver in solvers]
        where = f"solve, {case} in boxes of {boxes}, {reports[0].cycles} cycles ({reports[1].cycles})"
        works = [partial(solver.solve, given.rho, boundary_values=given.walls) for solver in solvers]
        beside(where, given.cells, "cell", works)
        stages_of = ", ".join(f"{name} {1e3 * taken:.1f}" for name, taken in reports[0].seconds.items())
        say(f"    ms by stage: {stages_of}")
    for count, cells in PARTICLES:
        kinds = [stages(count, cells, 32, kernels=kernels) for kernels in ("kokkos", "vectors")]
        for stage in BY_KOKKOS:
            beside(f"{stage}, {count:.0e} particles", count, "particle", [kind[stage] for kind in kinds])


def run(
    part: Annotated[str, "what is tried", ("first", "copy", "times")],
    cells: Annotated[int, "of the smallest solve, along an axis"] = 16,
) -> int:
    """Try a part; 1 if what it finds is wrong."""
    say(_native.kokkos_backend())
    if part == "first":
        return int(not first(cells))
    copy() if part == "copy" else times()
    return 0

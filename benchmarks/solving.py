"""Time the solver: set-up, solves to several tolerances, regrids; and measure its memory. A worker of `bench`."""

from __future__ import annotations

import itertools
import time
from collections.abc import Callable, Iterator, Sequence
from functools import partial
from typing import Annotated, Any, Literal

import numpy as np
from mpi4py import MPI

import amrpic
from amrpic.stages.poisson import PoissonSolver
from amrpic.stages.regrid import Regridding, carry_over, regrid
from cases import FAMILIES, STRETCHED, Problem, problem
from exact.errors import errors
from measuring import (
    BACKEND,
    BACKENDS,
    CPU_TIME,
    Backend,
    Quick,
    Record,
    Runs,
    reset_peak,
    resident,
    slowest,
    timed,
    timed_beside_unit,
    watched,
    work_unit,
    yardstick,
)
from measuring import in_turns as turns_of

FULL = 1e-10
IN_TURNS = f"{FULL:g}, in turns"
BESIDE_DST = f"{FULL:g}, in turns with the sine transform"
OVER_DST = (("uniform 128", 64), ("static 64", 64), ("static 64", 24), ("bunch 64", 24), ("static 128", 64))
TURNS = 11
EACH_BACKEND = "static 64", 24  # solved by all of them
Tolerance = float | Literal["discretization"]
BOXES = (16, 24, 32, 64)


def name(case: str, boxes: int, ranks: int, what: str = f"{FULL:g}") -> str:
    """Return the name of the record of a solve; of a set-up, for `what`."""
    return f"solve, {case}, boxes {boxes}, {ranks} rank{'s' * (ranks > 1)}, {what}"


# ---- one mesh ----


def solves(given: Problem, case: str, backend: str, runs: int, tolerances: tuple[Tolerance, ...]) -> Iterator[Record]:
    """Yield the record of the set-up, and that of solves from a zero guess to each tolerance. Collective."""
    hierarchy, comm = given.hierarchy, given.hierarchy.comm
    boxes = hierarchy.max_grid_size
    _ = given.rho  # filled before anything is timed
    seconds, solver = timed(comm, runs, lambda: PoissonSolver(hierarchy, tolerance=FULL, backend=backend))
    levels = {"levels": hierarchy.levels, "boxes": sum(len(hierarchy.boxes(l)) for l in range(hierarchy.levels))}
    yield Record(
        name(case, boxes, comm.size, "set-up"),
        seconds,
        facts=levels,
        **work_unit(comm, given.cells).record_fields(given.cells),
    )
    converged = None
    for tolerance in tolerances:
        if tolerance != FULL:
            solver = PoissonSolver(hierarchy, tolerance=tolerance, backend=backend)
        solver.solve(given.rho, boundary_values=given.walls)  # remembers the walls; pages of scratch come into being
        facts: dict[str, Any] = dict(levels)
        with watched(facts):
            work = partial(solver.solve, given.rho, boundary_values=given.walls)
            seconds, beside, (phi, report) = timed_beside_unit(comm, runs, given.cells, work)
        facts |= {
            "cycles": report.cycles,
            "converged": report.converged,
            "residual": report.residuals[-1],
            "stages": slowest(comm, report.seconds),
        }
        if tolerance == FULL:
            converged = phi
        elif tolerance == "discretization" and converged is not None and given.exact is not None:
            left, least = (errors([field], given.exact)[1] for field in (phi, converged))
            facts["error over the converged one"] = left / least
        yield Record(name(case, boxes, comm.size, tolerance_text(tolerance)), seconds, facts=facts, **beside)


def over_dst(comm: MPI.Comm, cases: Sequence[tuple[str, int]], backend: str, runs: int) -> Iterator[Record]:
    """Yield solves of cases in boxes from a zero guess, in turns with each other and with the sine transform, in CPU time."""
    given = [problem(comm, case, boxes) for case, boxes in cases]
    works = []
    for one in given:
        solver = PoissonSolver(one.hierarchy, tolerance=FULL, backend=backend)
        works.append(partial(solver.solve, one.rho, boundary_values=one.walls))
    reports = [work()[1] for work in works]
    seconds: list[list[float]] = [[] for _ in cases]
    dst: list[list[float]] = [[] for _ in cases]
    for _ in range(runs):
        for work, taken, beside in zip(works, seconds, dst, strict=True):
            beside.append(yardstick().seconds_per_cell(CPU_TIME))
            taken += timed(comm, 1, work, CPU_TIME)[0]
    for (case, boxes), one, taken, beside, report in zip(cases, given, seconds, dst, reports, strict=True):
        facts = {"cycles": report.cycles}
        yield Record(name(case, boxes, 1, BESIDE_DST), taken, cells=one.cells, facts=facts, dst=beside)


def in_turns(comm: MPI.Comm, cases: list[str], boxes: int, backend: str, runs: int) -> Iterator[Record]:
    """Yield solves from a zero guess that take turns, so that their ratios stand on a machine of changing speed. Collective."""
    given = [problem(comm, case, boxes) for case in cases]
    solvers = [PoissonSolver(one.hierarchy, tolerance=FULL, backend=backend) for one in given]
    units = [work_unit(comm, one.cells) for one in given]
    seconds: list[list[float]] = [[] for _ in cases]
    reports = [solver.solve(one.rho)[1] for one, solver in zip(given, solvers, strict=True)]
    for _ in range(runs):
        for one, solver, taken in zip(given, solvers, seconds, strict=True):
            taken += timed(comm, 1, partial(solver.solve, one.rho))[0]
    for case, one, unit, taken, report in zip(cases, given, units, seconds, reports, strict=True):
        facts = {"cycles": report.cycles, "converged": report.converged, "residual": report.residuals[-1]}
        label = name(case, boxes, comm.size)
        yield Record(label, taken, facts=facts, **unit.record_fields(one.cells))


def by_each_backend(comm: MPI.Comm, case: str, boxes: int, runs: int) -> Iterator[Record]:
    """Yield solves from a zero guess by all backends, in turns with each other, in CPU time."""
    given = problem(comm, case, boxes)
    solvers = [PoissonSolver(given.hierarchy, tolerance=FULL, backend=backend) for backend in BACKENDS]
    works = [partial(solver.solve, given.rho, boundary_values=given.walls) for solver in solvers]
    reports = [work()[1] for work in works]
    for backend, report, seconds in zip(BACKENDS, reports, turns_of(works, runs), strict=True):
        facts = {"cycles": report.cycles, "converged": report.converged}
        yield Record(name(case, boxes, 1, f"by {backend}"), seconds, cells=given.cells, facts=facts)


def rank_by_rank(comm: MPI.Comm, case: str, boxes: int, backend: str, runs: int) -> Iterator[Record]:
    """Yield solves from a zero guess by one rank alone and by all ranks, in turns as `in_turns`. Collective.

    While one rank solves, the others sleep.
    """
    together = problem(comm, case, boxes)
    alone = problem(MPI.COMM_SELF, case, boxes) if comm.rank == 0 else None
    own: dict[int, Callable[[], object]] = {}
    seconds: dict[int, list[float]] = {1: [], comm.size: []}
    for given in filter(None, (alone, together)):
        solver = PoissonSolver(given.hierarchy, tolerance=FULL, backend=backend)
        own[given.hierarchy.comm.size] = partial(solver.solve, given.rho, boundary_values=given.walls)
        own[given.hierarchy.comm.size]()
    for _ in range(runs):
        if alone is not None:
            seconds[1] += timed(MPI.COMM_SELF, 1, own[1])[0]
        _sleep_until_all_come(comm)
        seconds[comm.size] += timed(comm, 1, own[comm.size])[0]
    for ranks, taken in seconds.items():
        yield Record(name(case, boxes, ranks, IN_TURNS), comm.bcast(taken), cells=together.cells)


def _sleep_until_all_come(comm: MPI.Comm) -> None:
    request = comm.Ibarrier()
    while not request.Test():
        time.sleep(1e-3)


def tolerance_text(tolerance: Tolerance) -> str:
    return tolerance if isinstance(tolerance, str) else f"{tolerance:g}"


# ---- compressed rows ----


def assembly(comm: MPI.Comm, case: str, boxes: int, runs: int) -> Record:
    """Return the time of assembling the eight operators of all levels as compressed rows. Collective."""
    given = problem(comm, case, boxes)
    seconds = []
    for _ in range(runs):
        solver = PoissonSolver(given.hierarchy)
        seconds += timed(comm, 1, partial(solver.operators, 0))[0]
    return Record(assembly_name(case, boxes), seconds, cells=given.cells)


def assembly_name(case: str, boxes: int) -> str:
    return f"assembly, {case}, boxes {boxes}"


# ---- a mesh that follows ----


def following(comm: MPI.Comm, case: str, boxes: int, backend: str, runs: int) -> Iterator[Record]:
    """Yield what a regrid of a refined case costs next to a solve on the new mesh, its charge moved by a base cell. Collective.

    A regrid: tags from the charge, boxes from tags, φ carried over, the solver set up with what can be reused.
    """
    given = problem(comm, case, boxes)
    follow, step = follower(given, backend), float(given.hierarchy.domain.spacing[0])
    seconds: dict[str, list[float]] = {what: [] for what in ("boxes", "carry over", "set-up")}
    for _ in range(runs):
        solver: PoissonSolver | None = None  # gone before its successor comes
        clock = Laps(comm)
        mesh, guess, solver = follow(partial(clock.note, seconds))
    rho = amrpic.Field(mesh).fill(lambda x, y, z: given.density(x - step, y, z))
    cells = sum(mesh.cells(level) for level in range(mesh.levels))
    common = work_unit(comm, cells).record_fields(cells)
    cycles = {}
    assert solver is not None
    solver.solve(rho, boundary_values=given.walls)
    for what, start in (("zero", None), ("carried-over", guess)):
        taken, (_, report) = timed(comm, runs, partial(solver.solve, rho, guess=start, boundary_values=given.walls))
        cycles[what] = report.cycles
        yield Record(
            following_name(case, boxes, f"1e-06 from {what} φ"), taken, facts={"cycles": report.cycles}, **common
        )
    for what, taken in seconds.items():
        yield Record(following_name(case, boxes, what), taken, **common)
    whole = [sum(parts) for parts in zip(*seconds.values(), strict=True)]
    yield Record(following_name(case, boxes, "regrid"), whole, **common)


def follower(
    given: Problem, backend: str = BACKEND
) -> Callable[[Callable[[str], object]], tuple[amrpic.Hierarchy, amrpic.Field, PoissonSolver]]:
    """Return a function that regrids once, after `given`'s charge has moved by a base cell. Collective, and so is the function.

    It calls what it gets after each of its parts, by name, and returns the new mesh, φ on it and its solver.
    """
    kept = PoissonSolver(given.hierarchy, tolerance=1e-6, backend=backend)
    phi, _ = kept.solve(given.rho, boundary_values=given.walls)
    step = float(given.hierarchy.domain.spacing[0])
    moved = amrpic.Field(given.hierarchy).fill(lambda x, y, z: given.density(x - step, y, z))
    thresholds = [share * moved.max_abs() for share in (1e-3, 2e-2)]
    settings = Regridding(max_levels=given.hierarchy.levels)

    def follow(done: Callable[[str], object]) -> tuple[amrpic.Hierarchy, amrpic.Field, PoissonSolver]:
        tags = [np.abs(moved.array(level)) > threshold for level, threshold in enumerate(thresholds)]
        mesh = regrid(given.hierarchy, tags, settings)
        done("boxes")
        guess = carry_over(phi, mesh)
        done("carry over")
        solver = PoissonSolver(mesh, tolerance=1e-6, backend=backend, reuse=kept.base_setup)
        done("set-up")
        return mesh, guess, solver

    return follow


def following_name(case: str, boxes: int, what: str) -> str:
    return f"regrid, {case}, boxes {boxes}, {what}"


class Laps:
    """A clock that all ranks read together."""

    def __init__(self, comm: MPI.Comm) -> None:
        self.comm = comm
        comm.Barrier()
        self.start = time.perf_counter()

    def lap(self) -> float:
        """Return the seconds since the latest call, on the slowest rank. Collective."""
        seconds = self.comm.allreduce(time.perf_counter() - self.start, op=MPI.MAX)
        self.start = time.perf_counter()
        return seconds

    def note(self, taken: dict[str, list[float]], what: str) -> None:
        """Append such a lap to what was taken. Collective."""
        taken[what].append(self.lap())


# ---- memory ----


def memory_of(comm: MPI.Comm, case: str, boxes: int, backend: str) -> Record:
    """Return what the solver takes beyond ρ and φ at its peak, in bytes per cell, of one rank. For a process of its own.

    The resident set before the solver is made is taken from the highest one until it has solved.
    """
    given = problem(comm, case, boxes)
    PoissonSolver(problem(comm, "uniform 16", boxes).hierarchy, backend=backend)  # libraries are loaded
    rho, first = given.rho, amrpic.Field(given.hierarchy)
    for level in range(given.hierarchy.levels):
        first.array(level)[:] = 0.0  # its pages exist
    before = resident("VmRSS")
    reset_peak()
    start = time.perf_counter()
    solver = PoissonSolver(given.hierarchy, tolerance=FULL, backend=backend)
    made = resident("VmRSS")
    solver.solve(rho, guess=first)
    seconds = time.perf_counter() - start
    copy = 8 * given.cells  # the potential that the solve returns is a copy of the guess
    taken = {"peak": resident("VmHWM") - before - copy, "set up": made - before}
    facts = {f"bytes per cell, {what}": size / given.cells for what, size in taken.items()}
    return Record(f"memory, {case}, boxes {boxes}", [seconds], cells=given.cells, facts=facts)


# ---- growth ----


def growth(comm: MPI.Comm, backend: str, runs: int, n: int = 64) -> Iterator[Record]:
    """Yield solves on meshes that differ in one thing: the number of levels, of boxes, of cells. Collective.

    n³ cells on the base, and on each level where there are several; bases up to twice as fine where cells are varied.
    """
    for levels in (1, 2, 3, 4, 5):
        domain = amrpic.Domain((0, 0, 0), (1, 1, 1), (n,) * 3, boundary="dirichlet")
        nested = [[(((2**k - 1) * n // 2,) * 3, ((2**k + 1) * n // 2 - 1,) * 3)] for k in range(1, levels)]
        hierarchy = amrpic.Hierarchy(comm, domain, nested, max_grid_size=32)
        charge = Problem(hierarchy, problem(comm, "uniform 8", 8).density)
        yield from grown(charge, f"levels {levels}", backend, runs)
    for size in sorted({max(8, n // parts) for parts in (1, 2, 4, 8)}):
        yield from grown(problem(comm, f"uniform {n}", size), f"boxes of {size}", backend, runs)
    for size in (n // 2, n, 3 * n // 2, 2 * n):
        yield from grown(problem(comm, f"static {size}", 32), f"base {size}", backend, runs)


def grown(given: Problem, what: str, backend: str, runs: int) -> Iterator[Record]:
    for record in solves(given, what, backend, runs, (FULL,)):
        record.name = record.name.replace("solve, ", "growth, ")
        yield record


# ---- what is measured ----


def everything(comm: MPI.Comm, backend: str, quick: bool, runs: int) -> Iterator[Record]:
    """Yield all records of so many ranks: all on one and two, on more the cycles of a few. Collective."""
    sizes, boxes = ((64,), (24, 32)) if quick else ((64, 128), BOXES)
    if comm.size > 2:
        for case, size in itertools.product(("static 64", "bunch 64"), (24, 32)):
            yield from solves(problem(comm, case, size), case, backend, 1, (FULL,))
        return
    for n, family, size in itertools.product(sizes, FAMILIES, boxes):
        more: tuple[Tolerance, ...] = (1e-6, "discretization") if size >= 32 else ()
        yield from solves(problem(comm, f"{family} {n}", size), f"{family} {n}", backend, runs, (FULL, *more))
    if comm.size == 2:
        # Single ratios scatter by a fifth: one rank is disturbed otherwise than two.
        yield from rank_by_rank(comm, f"static {sizes[-1]}", 32, backend, 3 * runs)
    if comm.size == 1:
        yield from over_dst(comm, OVER_DST[: 4 if quick else 5], backend, TURNS)
        yield from in_turns(comm, [f"{cells} 64" for cells in STRETCHED], 32, backend, runs)
        yield from following(comm, "bunch 64", 24, backend, runs)
        yield assembly(comm, "bunch 64", 24, runs)
        yield from by_each_backend(comm, *EACH_BACKEND, runs)
        if not quick:
            yield from growth(comm, backend, runs)


def run(
    backend: Backend = BACKEND,
    runs: Runs = 5,
    quick: Quick = False,
    memory: Annotated[str | None, "measure the memory of this case alone, boxes of 32"] = None,
) -> Iterator[Record]:
    """All cases, or the memory of one. Collective."""
    comm = MPI.COMM_WORLD
    if memory is None:
        yield from everything(comm, backend, quick, runs)
    else:
        yield memory_of(comm, memory, 32, backend)

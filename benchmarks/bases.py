"""Time solves on bases of any extent beside those of the nearest 2^k or 3·2^k, in CPU time. A worker of `bench`.

Each base is measured in a process of its own, in turns with its reference; one that takes too long is skipped, and the table
says so.
"""

from __future__ import annotations

import math
import statistics
from collections.abc import Callable, Iterator, Mapping
from functools import partial
from typing import Annotated

from mpi4py import MPI

from amrpic.errors import AmrpicError
from amrpic.stages.poisson import PoissonSolver
from cases import problem
from measuring import Record, Runs, in_turns, launch_or_skip, timed
from solving import FULL

BASES = (72, 81, 88, 96, 100, 120, 125, 127, 144, 160, 176, 192, 200, 250, 251)
SMOOTH = sorted({factor << k for factor in (1, 3) for k in range(3, 10)})
TURNS = 7
LIMIT = 120.0  # s, for a base and its reference together


def nearest(n: int) -> int:
    """Return the 2^k or 3·2^k next to `n` as a ratio, other than itself."""
    return min((m for m in SMOOTH if m != n), key=lambda m: abs(math.log(m / n)))


def measure(n: int, turns: int, seconds: float) -> Iterator[Record]:
    """Yield the solves of a base and of its reference, in as many turns as fit into about so many seconds, at least one."""
    sizes = (n, nearest(n))
    works: list[Callable] = []
    reports, first = [], 0.0
    for size in sizes:
        given = problem(MPI.COMM_SELF, f"uniform {size}", 64)
        solver = PoissonSolver(given.hierarchy, tolerance=FULL)
        works.append(partial(solver.solve, given.rho))
        taken, (_, report) = timed(MPI.COMM_SELF, 1, works[-1])
        first += taken[0]
        reports.append(report)
    times = in_turns(works, min(turns, int(seconds / first)))
    for label, size, taken, report in zip((base_name(n), beside_name(n)), sizes, times, reports, strict=True):
        yield Record(label, taken, cells=size**3, facts={"cycles": report.cycles, "base": size})


def base_name(n: int) -> str:
    return f"base, {n}"


def beside_name(n: int) -> str:
    return f"base, {n}, beside {nearest(n)}"


def is_base(record: Record) -> bool:
    return record.keys[0] == "base" and len(record.keys) == 2


def base_of(record: Record) -> int:
    return int(record.keys[1])


def base_ratio(records: Mapping[str, Record], record: Record) -> float:
    """Return the time per cell over that of the reference, the median of the turns; infinite if it was skipped."""
    if record.skipped:
        return math.inf
    other = records[beside_name(base_of(record))]
    turns = zip(record.seconds, other.seconds, strict=True)
    return statistics.median(one / record.cells / (two / other.cells) for one, two in turns)


def rows(records: Mapping[str, Record]) -> list[tuple[str, ...]]:
    """Return the table: the base, its reference, cycles, ns per cell, and the ratio."""
    out: list[tuple[str, ...]] = [("base", "beside", "cycles", "per cell", "over the other's", "turns")]
    for record in filter(is_base, records.values()):
        n = base_of(record)
        if record.skipped:
            out.append((f"{n}³", f"{nearest(n)}³", "–", "–", record.skipped, "0"))
            continue
        each = f"{1e9 * record.median / record.cells:.3g} ns"
        ratio = f"{base_ratio(records, record):.2f}×"
        out.append((f"{n}³", f"{nearest(n)}³", str(record.facts["cycles"]), each, ratio, str(len(record.seconds))))
    return out


def run(
    bases: tuple[int, ...] = BASES,
    runs: Runs = TURNS,
    limit: Annotated[float, "seconds for a base"] = LIMIT,
    alone: Annotated[bool, "measure the only base in this process"] = False,
) -> Iterator[Record]:
    """Each base, in a process of its own."""
    records: list[Record] = []
    for n in bases:
        if alone:
            try:
                records += measure(n, runs, limit / 2)
            except AmrpicError as refused:
                records.append(Record(base_name(n), [math.nan], facts={"skipped": f"refused: {refused}", "base": n}))
            continue
        arguments = ["--alone", "--bases", str(n), "--runs", str(runs), "--limit", str(limit)]
        records += launch_or_skip("bases", arguments, base_name(n), limit)
    if not alone:
        for row in rows({record.name: record for record in records}):
            print("  ".join(row), flush=True)
    yield from records

"""What every benchmark shares: records of what was measured, the work unit, workers on ranks, and paths."""

from __future__ import annotations

import contextlib
import ctypes
import functools
import json
import math
import os
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Annotated, Any, get_args

import numpy as np
from mpi4py import MPI

from amrpic import _native
from amrpic.scene import solver_options
from sine import Yardstick

ROOT = Path(__file__).parents[1]
RUNNER = [sys.executable, str(ROOT / "benchmarks")]  # followed by the name of what is measured
BACKENDS = get_args(solver_options.Backend)
BACKEND: str = solver_options.SolverOptions().backend
CORE = "share of a core"
Backend = Annotated[
    str, "how the operators are executed", BACKENDS
]  # options of what is measured, as __main__ reads them
Runs = Annotated[int, "runs of each"]
Quick = Annotated[bool, "few and small cases"]
ENVIRONMENT = {
    "OMPI_ALLOW_RUN_AS_ROOT": "1",
    "OMPI_ALLOW_RUN_AS_ROOT_CONFIRM": "1",
    "OMPI_MCA_rmaps_base_oversubscribe": "1",
    "OMPI_MCA_mpi_yield_when_idle": "1",  # a rank that waits leaves its core to others
    "OMP_NUM_THREADS": "1",
}


@dataclass(frozen=True)
class WorkUnit:
    """What times are given in, measured for an array of so many cells that all ranks divide and pass over at a time.

    It is the time of one plain 7-point apply, or, if that is less, of moving its 24 bytes per cell at the bandwidth of a
    triad out of cache.
    """

    seconds: float  # of the slowest rank
    apply: float  # s, of the plain apply
    triad: float  # bytes per second of all ranks, out of cache

    def record_fields(self, cells: int) -> dict[str, Any]:
        """The fields of a record of so many cells that belong to its unit."""
        return {"unit": self.seconds, "apply": self.apply, "triad": self.triad, "cells": cells}


def work_unit(comm: MPI.Comm, cells: int) -> WorkUnit:
    """Return the work unit of so many cells. Collective."""
    comm.Barrier()
    own = _native.measure_work_unit(max(1, cells // comm.size))
    return WorkUnit(
        comm.allreduce(own.seconds, op=MPI.MAX),
        comm.allreduce(own.apply_seconds, op=MPI.MAX),
        comm.allreduce(own.triad_throughput),
    )


@dataclass
class Record:
    """Something that was timed several times. `name` tells it from all others: keys, as what, case, and what was varied."""

    name: str
    seconds: list[float]  # of each run, of the slowest rank
    unit: float = 0.0  # s, the work unit measured beside it; 0 if none was
    cells: int = 0
    particles: int = 0
    facts: dict[str, Any] = field(default_factory=dict)  # cycles, seconds of stages, bytes per cell and the like
    apply: float = 0.0  # s, of a plain apply on as many cells
    triad: float = 0.0  # bytes per second of a triad out of cache
    dst: list[float] = field(
        default_factory=list
    )  # s per cell of the sine transform on 128³ cells, in turns with the runs

    @property
    def keys(self) -> tuple[str, ...]:
        """What its name is made of."""
        return tuple(self.name.split(", "))

    @property
    def median(self) -> float:
        return statistics.median(self.seconds)

    @property
    def units(self) -> float:
        """Median in work units; nan without one."""
        return self.median / self.unit if self.unit else float("nan")

    @property
    def over_dst(self) -> float:
        """Time per cell over that of the sine transform on 128³ cells, the median of the turns; nan without one."""
        turns = zip(self.seconds, self.dst, strict=True) if self.dst else ()
        return statistics.median(one / self.cells / other for one, other in turns) if self.dst else float("nan")

    @property
    def skipped(self) -> str:
        """Why it was not measured; empty if it was."""
        return str(self.facts.get("skipped", ""))


def figure(value: float) -> str:
    """Return a number with three digits, or all of its whole ones."""
    return f"{value:.0f}" if abs(value) >= 100 else f"{value:.3g}"


def printed(record: Record) -> str:
    """A line about a record."""
    if record.skipped or not record.seconds:
        return f"{record.name}: {record.skipped or 'left out'}"
    units = f", {record.units:.0f} work units" if record.unit else ""
    over_dst = f", {record.over_dst:.2f} DST" if record.dst else ""
    facts = "".join(f", {what} {value:.4g}" for what, value in record.facts.items() if isinstance(value, int | float))
    return f"{record.name}: {record.median:.4g} s{units}{over_dst}{facts}"


# For ratios on one rank: wall time counts how long a rank waits for its core where others use it as well.
CPU_TIME = time.process_time


def in_turns(works: Sequence[Callable[[], Any]], turns: int) -> list[list[float]]:
    """Return the CPU seconds of each of some works of this process, which take turns."""
    times: list[list[float]] = [[] for _ in works]
    for _ in range(max(1, turns)):
        for work, mine in zip(works, times, strict=True):
            mine += timed(MPI.COMM_SELF, 1, work, CPU_TIME)[0]
    return times


def timed(
    comm: MPI.Comm, runs: int, work: Callable[[], Any], clock: Callable[[], float] = time.perf_counter
) -> tuple[list[float], Any]:
    """Return the seconds of each run on the slowest rank, and what the last run gave. Collective."""
    seconds: list[float] = []
    out = None
    for _ in range(runs):
        out = None  # gone before its successor comes
        comm.Barrier()
        start = clock()
        out = work()
        seconds.append(comm.allreduce(clock() - start, op=MPI.MAX))
    return seconds, out


@functools.cache
def yardstick() -> Yardstick:
    return Yardstick()


def timed_beside_unit(
    comm: MPI.Comm, runs: int, cells: int, work: Callable[[], Any]
) -> tuple[list[float], dict[str, Any], Any]:
    """Return what `timed` does, and what a record says of the work unit and, on one rank, of the sine transform. Collective.

    Both take turns with the runs; the unit is the median one.
    """
    dst: list[float] = []
    seconds: list[float] = []
    units: list[WorkUnit] = []
    out = None
    for _ in range(runs):
        units.append(work_unit(comm, cells))
        out = None
        if comm.size == 1:
            dst.append(yardstick().seconds_per_cell())
        taken, out = timed(comm, 1, work)
        seconds += taken
    unit = sorted(units, key=lambda unit: unit.seconds)[len(units) // 2]
    return seconds, {**unit.record_fields(cells), "dst": dst}, out


@contextlib.contextmanager
def watched(facts: dict[str, Any]) -> Iterator[None]:
    """Note in `facts` what part of a core this rank had while a block ran: less than all where the machine did other work."""
    start, own = time.perf_counter(), time.process_time()
    yield
    facts[CORE] = (time.process_time() - own) / (time.perf_counter() - start)


def share_of_core(records: Sequence[Record]) -> float:
    """Return the part of a core that half of what was watched on one rank had at most; 1 if nothing was."""
    shares = [record.facts[CORE] for record in records if CORE in record.facts and " ranks" not in record.name]
    return statistics.median(shares) if shares else 1.0


def slowest(comm: MPI.Comm, stages: dict[str, float]) -> dict[str, float]:
    """Return seconds per stage on the rank that took longest for each. Collective; the same stages on all ranks."""
    values = np.array(list(stages.values()))
    comm.Allreduce(MPI.IN_PLACE, values, op=MPI.MAX)
    return dict(zip(stages, (float(value) for value in values), strict=True))


def resident(which: str) -> int:
    """Return a line of /proc/self/status in bytes, after memory that was freed has been given back."""
    if which == "VmRSS":
        ctypes.CDLL(None).malloc_trim(0)
    lines = dict(line.split(":", 1) for line in Path("/proc/self/status").read_text().splitlines())
    return int(lines[which].split()[0]) * 1024


def reset_peak() -> None:
    """Let the highest resident set start from the present one."""
    Path("/proc/self/clear_refs").write_text("5")


def launch(name: str, ranks: int, arguments: Sequence[str], limit: float | None = None, isa: str = "") -> list[Record]:
    """Return the records that `python benchmarks NAME` writes, run on so many ranks with `arguments` and `--output FILE`.

    `isa`: the instruction set of its kernels, if not the best one.

    One that starts ranks of its own cannot be under mpiexec; it is run by itself for `ranks` = 0.
    Raises CalledProcessError if it fails; what it prints is seen. One by itself is killed after `limit` seconds, with
    TimeoutExpired.
    """
    with tempfile.TemporaryDirectory() as folder:
        found = Path(folder) / "records.json"
        worker = [*RUNNER, name, *arguments, "--output", str(found)]
        command = ["mpiexec", "-n", str(ranks), *worker] if ranks else worker
        chosen = {"AMRPIC_ISA": isa} if isa else {}
        subprocess.run(command, env={**os.environ, **ENVIRONMENT, **chosen}, check=True, timeout=limit)
        return read(found)


def launch_or_skip(worker: str, arguments: Sequence[str], name: str, limit: float) -> list[Record]:
    """Return the records that a worker on one rank writes; one under `name` that says why, if it fails or takes too long."""
    try:
        return launch(worker, 0, arguments, limit)
    except subprocess.TimeoutExpired:
        why = f"not done within {limit:.0f} s"
    except subprocess.CalledProcessError as ended:
        why = f"ended with {ended.returncode}"
    print(f"{name}: {why}", flush=True)
    return [Record(name, [math.nan], facts={"skipped": why})]


def write(path: Path, records: Sequence[Record], **about: Any) -> None:
    """Write records, and what is known about them, as JSON."""
    content = {**about, "records": [asdict(record) for record in records]}
    path.write_text(json.dumps(content, indent=1), encoding="utf-8")


def read(path: Path) -> list[Record]:
    """Return the records of a file that `write` wrote."""
    return [Record(**record) for record in json.loads(path.read_text(encoding="utf-8"))["records"]]

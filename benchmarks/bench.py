"""Measure how fast the code is, next to its peers and to its goals: `make bench`, or `make bench ARGS=--quick`.

Each part runs in processes of its own, on the ranks that it needs. Ends with the table of goals; writes a JSON of all that was
measured and charts, with `--publish` docs/reports/performance.md. The exit status is 1 if a part failed; a goal that is missed
is reported, not an error.
"""

from __future__ import annotations

import importlib
import importlib.metadata
import importlib.util
import os
import platform
import subprocess
import sys
import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

import bases
import charts
import gamma
import performance
from goals import goals, printed, table
from growth import laws, rows
from measuring import BACKEND, ROOT, Backend, Record, launch, share_of_core, write

MEMORY_CASES = ("static 128", "bunch 64")
QUIET = 0.9  # of a core, below which a run is reported as disturbed


@dataclass(frozen=True)
class Part:
    """A worker, on how many ranks, with which arguments."""

    name: str
    script: str  # `python benchmarks SCRIPT`
    ranks: int  # 0: not under mpiexec, it starts ranks of its own
    arguments: tuple[str, ...]
    isa: str = ""  # the instruction set of the kernels, if not the best one


def parts(backend: str, quick: bool, runs: int) -> list[Part]:
    """Return what is run, in order."""
    options = ("--backend", backend, "--runs", str(runs))
    repeats, repeats_of_gamma = ("--repeats", str(runs)), ("--runs", str(runs))
    small = ("--quick",) if quick else ()
    peers = ("--cells", "64") if quick else ("--cells", "64", "128")
    counts = ("1e6",) if quick else ("1e5", "1e6", "1e7")
    shapes = () if quick else ("nearest-grid-point", "triangular-shaped-cloud")
    memory, rank_counts, walls = (("bunch 64",), (1, 2), ()) if quick else (MEMORY_CASES, (1, 2, 3, 4), (1,))
    return [
        *(Part("solver", "solving", ranks, (*options, *small)) for ranks in rank_counts),
        *(Part("memory", "solving", 1, (*options, "--memory", case)) for case in memory),
        Part("memory", "particles", 1, ("--memory", "--particles", "1e6")),
        Part("peers", "peers", 0, (*options, *peers)),
        Part("particles", "particles", 1, (*repeats, "--particles", *counts, "--shape", "cloud-in-cell")),
        *(Part("particles", "particles", 1, (*repeats, "--particles", "1e6", "--shape", shape)) for shape in shapes),
        Part("particles", "particles", 1, (*repeats, "--by-kokkos"), isa="v3" if "v3" in instructions() else ""),
        *(
            Part("step", "pic_step", ranks, (*options, *(("--walls", "dirichlet") if quick else ())))
            for ranks in (1, 2)
        ),
        *(Part("walls", "walls", ranks, options) for ranks in walls),
        Part(
            "electrodes",
            "electrodes",
            1,
            (*repeats_of_gamma, *(("--scenes", "sphere 64 and 2 levels") if quick else ())),
        ),
        Part("orders", "orders", 1, ("--cells", "64") if quick else repeats_of_gamma),
        Part("bases", "bases", 0, ("--bases", "72", "100", "--runs", "3") if quick else ()),
        *(() if quick else (Part("gamma", "gamma", 0, repeats_of_gamma),)),
        Part("least squares", "least_squares", 1, repeats_of_gamma),
        *(Part("points", "points", ranks, (*repeats_of_gamma, *small)) for ranks in (1, 2)),
        Part("boxes", "regridding", 1, ("--boxes", "5000") if quick else ()),
        Part("agreement", "agreement", 1, small),
    ]


def measure(chosen: Sequence[Part]) -> tuple[list[Record], list[str]]:
    """Return the records of all parts, and a sentence for each that failed."""
    records: list[Record] = []
    failed = []
    for part in chosen:
        start = time.perf_counter()
        try:
            records += launch(part.script, part.ranks, part.arguments, isa=part.isa)
        except subprocess.CalledProcessError as ended:
            failed.append(
                f"{part.script} {' '.join(part.arguments)} on {part.ranks} ranks ended with {ended.returncode}"
            )
        print(f"-- {part.script}, {part.ranks or 'its own'} ranks: {time.perf_counter() - start:.0f} s", flush=True)
    return records, failed


def machine() -> dict[str, Any]:
    """Return what the figures depend on."""
    model = [line for line in Path("/proc/cpuinfo").read_text().splitlines() if line.startswith("model name")]
    commit = subprocess.run(
        ["git", "rev-parse", "--short", "HEAD"], cwd=ROOT, capture_output=True, text=True, check=False
    )
    return {
        "processor": model[0].split(":", 1)[1].strip() if model else platform.processor(),
        "instructions": instructions(),
        "cores": os.cpu_count(),
        "load": os.getloadavg()[0],
        "time": time.strftime("%Y-%m-%d %H:%M:%S %Z"),
        "commit": commit.stdout.strip(),
        "versions": {name: importlib.metadata.version(name) for name in ("amrpic", "numpy", "scipy")},
    }


def instructions() -> str:
    """Return the instruction set that the kernels use: as the package reports it, else the widest that the processor has,
    which a native build compiles for."""
    if importlib.util.find_spec("amrpic.isa") is not None:
        return str(importlib.import_module("amrpic.isa").description())
    lines = (line for line in Path("/proc/cpuinfo").read_text().splitlines() if line.startswith("flags"))
    flags = next(lines, "").split()
    return next((name for flag, name in (("avx512f", "AVX-512"), ("avx2", "AVX2")) if flag in flags), "without AVX2")


PARTS = tuple(dict.fromkeys(part.name for part in parts("", False, 1)))


def run(
    quick: Annotated[bool, "few of the cases: under 2 minutes"] = False,
    backend: Backend = BACKEND,
    runs: Annotated[int, "of each measurement; it reports medians"] = 5,
    only: Annotated[tuple[str, ...], "parts to run", PARTS] = PARTS,
    output: Annotated[Path, "folder of the JSON and the charts"] = ROOT / "runs" / "bench",
    publish: Annotated[bool, "write docs/reports/performance.md, after a whole run"] = False,
) -> int:
    """Run the parts, and print tables; 1 if one failed."""
    if publish and (quick or len(only) < len(PARTS)):
        sys.exit("only a whole run is published; leave out --quick and --only")
    output.mkdir(parents=True, exist_ok=True)
    about: dict[str, Any] = {"machine": machine(), "quick": quick, "backend": backend, "runs": runs}
    start = time.perf_counter()
    chosen = [part for part in parts(backend, quick, runs) if part.name in only]
    print("{processor}, {cores} cores, {instructions}, commit {commit}".format_map(about["machine"]), flush=True)
    records, failed = measure(chosen)
    write(output / "bench.json", records, **about, minutes=(time.perf_counter() - start) / 60)
    charts.draw(records, output)
    print(printed(table(goals(records))))
    known = {record.name: record for record in records}
    for more in (bases.rows(known), gamma.rows(known)):
        if len(more) > 1:
            print("\n" + printed(more))
    if (found := laws(records)) != []:
        print("\n" + printed(rows(found)))
    if publish and not failed:
        print(performance.write(output / "bench.json", ROOT / "docs" / "reports"))
    if (share := share_of_core(records)) < QUIET:
        print(f"The machine did other work: a rank had {share:.0%} of a core, so times are too long.")
    for sentence in failed:
        print(sentence, file=sys.stderr)
    return int(bool(failed))

"""Time whole particle-in-cell steps, stage by stage, and ImpactX on the same task in the same run.

The task: a ball of charge, 64³ cells three times as wide as it, one level refined around it, 1e6 particles, cloud-in-cell, a
solve to 1e-7 in every step. Ours matches fluxes between the levels and meets the tolerance on both at once; ImpactX solves
level by level. The walls are grounded in both; with open ones, ours is timed beside ImpactX's FFT solver as well.
"""

from __future__ import annotations

import importlib.util
import json
import subprocess
import tempfile
from collections.abc import Iterator
from functools import partial
from pathlib import Path
from statistics import median
from typing import Annotated

from mpi4py import MPI

from amrpic.pic.step import advance, begin
from amrpic.scene.scene import Scene
from measuring import BACKEND, RUNNER, Backend, Record, Runs, slowest, timed, work_unit

HERE = Path(__file__).parent
RELATIVE_TOLERANCE = 1e-7  # of the solve in every step; ImpactX's own default
RADIUS = 1e-3  # m, of the ball
IMPACTX_WALLS = {"dirichlet": "multigrid", "open": "fft"}  # its solver that has such walls


def scene(cells: int, particles: int, walls: str, backend: str) -> Scene:
    """The ball at rest, as the frame of a bunch sees it, in cells of a third of ImpactX's relative width."""
    box = [1.1 * RADIUS] * 3
    return Scene.model_validate(
        {
            "domain": {"lower": [-3 * RADIUS] * 3, "upper": [3 * RADIUS] * 3, "cells": cells, "boundary": walls},
            "bunches": [
                {
                    "distribution": "sphere",
                    "species": "electron",
                    "radius": RADIUS,
                    "charge": -1e-12,
                    "particles": particles,
                }
            ],
            "refinement": {
                "levels": 1,
                "regrid_every": 0,
                "rule": {"kind": "static", "boxes": [{"level": 1, "lower": [-x for x in box], "upper": box}]},
            },
            "motion": {"kind": "leapfrog", "dt": 2e-12},
            "solver": {"tolerance": RELATIVE_TOLERANCE, "backend": backend},
            "output": {"write": []},
        }
    )


def ours(comm: MPI.Comm, cells: int, particles: int, walls: str, backend: str, runs: int) -> Record:
    """Return the record of whole steps, with the median seconds of each stage. Collective."""
    state, setup = begin(comm, scene(cells, particles, walls, backend))
    state = advance(state, setup)  # the first step makes what lasts
    stages: dict[str, list[float]] = {}
    taken: list[float] = []
    for _ in range(runs):
        seconds, state = timed(comm, 1, partial(advance, state, setup))
        taken += seconds
        for stage, spent in slowest(comm, state.seconds).items():
            stages.setdefault(stage, []).append(spent)
    mesh = state.hierarchy
    size = sum(mesh.cells(level) for level in range(mesh.levels))
    unit = work_unit(comm, size)
    facts = {
        "stages": {stage: median(spent) for stage, spent in stages.items()},
        "cycles": state.report.cycles,
    }
    name = step_name("amrpic", cells, particles, walls, comm.size)
    return Record(name, taken, particles=particles, facts=facts, **unit.record_fields(size))


def impactx(cells: int, particles: int, walls: str, runs: int) -> Record:
    """Return the record of ImpactX's steps, from a process of its own: it starts and ends AMReX."""
    with tempfile.TemporaryDirectory() as folder:
        found = Path(folder) / "seconds.json"
        task: dict[str, object] = {
            "--cells": cells,
            "--particles": particles,
            "--runs": runs,
            "--solver": IMPACTX_WALLS[walls],
        }
        task["--tolerance"] = RELATIVE_TOLERANCE
        arguments = [str(part) for pair in task.items() for part in pair]
        command = [*RUNNER, "impactx_peer", *arguments, str(found)]
        subprocess.run(command, check=True, stdout=subprocess.DEVNULL)
        taken = json.loads(found.read_text(encoding="utf-8"))
    return Record(step_name("ImpactX", cells, particles, walls), taken, particles=particles)


def step_name(who: str, cells: int, particles: int, walls: str, ranks: int = 1) -> str:
    return f"step, {who}, {cells}³ cells, {particles:.0e} particles, {walls}, {ranks} rank{'s' * (ranks > 1)}"


def run(
    backend: Backend = BACKEND,
    runs: Runs = 5,
    cells: Annotated[int, "along an axis of the base"] = 64,
    particles: float = 1e6,
    walls: Annotated[tuple[str, ...], "kinds", IMPACTX_WALLS] = tuple(IMPACTX_WALLS),
) -> Iterator[Record]:
    """Steps of ours and, on one rank, of ImpactX. Collective."""
    comm, peer = MPI.COMM_WORLD, importlib.util.find_spec("impactx") is not None
    if comm.rank == 0 and not peer:
        print("ImpactX is left out; to have it: pip install impactx-noacc", flush=True)
    for kind in walls:
        yield ours(comm, cells, int(particles), kind, backend, runs)
        if comm.size == 1 and peer:
            yield impactx(cells, int(particles), kind, runs)


def printed(record: Record) -> str:
    return f"{record.name}: {record.median:.4g} s {record.facts.get('stages', '')}"

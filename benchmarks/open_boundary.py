"""What the open boundary of an example costs, stage by stage: `python benchmarks open_boundary --base 144`.

Also under mpiexec. `measure` is the interface; it makes the mesh and the charge of a scene as a run does at its start, and
solves nothing. Its stages are `plan` (who does what, once per mesh) and `total` (the potential at all ghosts, in each
solve). A work unit is one 7-point apply on as many cells as the hierarchy has, shared equally by the ranks.
"""

from __future__ import annotations

import json
import time
from collections.abc import Callable
from pathlib import Path
from typing import Annotated, Any

from mpi4py import MPI

import amrpic
from amrpic import _native
from amrpic.particles.particles import concatenate
from amrpic.pic.adapt import follow, make_base
from amrpic.pic.frames import first_frames
from amrpic.pic.initial_particles import make_bunches
from amrpic.pic.meshed import MeshedParticles, deposit
from amrpic.pic.setup import resolved, set_up
from amrpic.stages.migrate import migrate

EXAMPLES = Path(__file__).parents[1] / "examples"


def measure(
    base: int,
    example: str = "ten_bunches",
    overrides: tuple[str, ...] = (),
    repeats: int = 5,
    comm: MPI.Comm = MPI.COMM_WORLD,
) -> dict[str, Any]:
    """Return what the open boundary costs in an example on base³ cells. Collective; the same on all ranks.

    `cells`: per level; `ghosts`: of refined cells at the walls; `work_unit`: s; `seconds` and `work_units`: of each stage, the
    fastest of `repeats`, each as long as the slowest rank takes; `first`: s, the first time of all, with the tables of the
    lattice Green's function.
    """
    rho = density(comm, base, example, overrides)
    hierarchy = rho.hierarchy
    cells = [hierarchy.cells(level) for level in range(hierarchy.levels)]
    spaces: list[Any] = []
    stages: dict[str, Callable[[], Any]] = {
        "plan": lambda: spaces.insert(0, _native.FreeSpace(hierarchy.native)),
        "total": lambda: spaces[0].walls(rho.native),
    }
    trials = [{name: slowest(comm, work) for name, work in stages.items()} for _ in range(repeats + 1)]
    first = sum(trials[0].values())
    best = {name: min(trial[name] for trial in trials[1:]) for name in stages}
    unit = comm.allreduce(_native.measure_work_unit(sum(cells) // comm.size).seconds, op=MPI.MAX)
    return {
        "example": example,
        "ranks": comm.size,
        "cells": cells,
        "ghosts": comm.allreduce(sum(len(values) for _, _, values in spaces[0].walls(rho.native)[1:])),
        "work_unit": unit,
        "seconds": best,
        "work_units": {stage: seconds / unit for stage, seconds in best.items()},
        "first": first,
    }


def density(comm: MPI.Comm, base: int, example: str, overrides: tuple[str, ...]) -> amrpic.Field:
    """Return the charge density of a scene at its start, on the mesh that its rule asks for. Collective."""
    changes = [f"domain.cells={base}", "output.write=[]", *overrides]
    setup = set_up(comm, amrpic.Scene.from_toml(EXAMPLES / f"{example}.toml", changes))
    mesh = make_base(comm, setup.scene)
    bunches = make_bunches(comm, setup.scene)
    setup = resolved(setup, bunches)
    particles, _ = migrate(concatenate(bunches), mesh)
    return deposit(follow(MeshedParticles(particles, mesh, first_frames(particles, setup)), None, setup), setup)


def slowest(comm: MPI.Comm, work: Callable[[], Any]) -> float:
    """Return the seconds that the slowest rank takes. Collective."""
    comm.Barrier()
    start = time.perf_counter()
    work()
    return comm.allreduce(time.perf_counter() - start, op=MPI.MAX)


def run(
    base: Annotated[int, "cells of the base along each axis"] = 144,
    example: Annotated[str, "a scene of examples/"] = "ten_bunches",
    set: Annotated[tuple[str, ...], "KEY=VALUE of the scene"] = (),
    repeats: int = 5,
) -> None:
    """Measure and print, as JSON. Collective."""
    found = measure(base, example, set, repeats)
    if MPI.COMM_WORLD.rank == 0:
        print(json.dumps(found, indent=2))

"""What the open boundary of an example costs, stage by stage: `python benchmarks/open_boundary.py --base 144`.

Also under mpiexec. `measure` is the interface; it makes the mesh and the charge of a scene as a run does at its start, and
solves nothing. Its stages are those of `FreeSpace`: `charges` (leaves, moments, tree), `walls` (ghosts of the base), `refined`
(ghosts of refined cells at the walls), and their sum `total`. A work unit is one 7-point apply on as many cells as the
hierarchy has, shared equally by the ranks.
"""

from __future__ import annotations

import argparse
import json
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from mpi4py import MPI

import amrpic
from amrpic import _native
from amrpic.particles.particles import concatenate
from amrpic.run.adapt import follow, make_base
from amrpic.run.initial_particles import make_bunches
from amrpic.run.particle_fields import ParticleFields
from amrpic.run.plan import Plan
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

    `cells`: per level; `ghosts`: of refined cells at the walls; `work_unit`: s; `seconds` and `work_units`: of each stage and
    in `total`, the fastest of `repeats`, each as long as the slowest rank takes; `first`: s, the first time of all, with the
    tables of the lattice Green's function.
    """
    rho = density(comm, base, example, overrides)
    hierarchy = rho.hierarchy
    cells = [hierarchy.cells(level) for level in range(hierarchy.levels)]
    positions, levels = refined_ghosts(rho)
    open_walls = [kind == "open" for pair in hierarchy.domain.boundary for kind in pair]

    domain = hierarchy.domain
    start = time.perf_counter()
    space = _native.FreeSpace(comm.py2f(), list(domain.lower), list(hierarchy.spacing(0)), list(domain.cells))
    made = comm.allreduce(time.perf_counter() - start, op=MPI.MAX)
    stages: dict[str, Callable[[], Any]] = {
        "charges": lambda: space.set_density(rho.native),
        "walls": lambda: space.wall_planes(open_walls),
        "refined": lambda: space.potential(positions, levels),
    }
    trials = [{name: slowest(comm, work) for name, work in stages.items()} for _ in range(repeats + 1)]
    first = made + sum(trials[0].values())
    best = {name: min(trial[name] for trial in trials[1:]) for name in stages}
    best["total"] = sum(best.values())
    unit = comm.allreduce(_native.measure_work_unit(sum(cells) // comm.size).seconds, op=MPI.MAX)
    return {
        "example": example,
        "ranks": comm.size,
        "cells": cells,
        "ghosts": comm.allreduce(len(levels)),
        "work_unit": unit,
        "seconds": best,
        "work_units": {stage: seconds / unit for stage, seconds in best.items()},
        "first": first,
    }


def density(comm: MPI.Comm, base: int, example: str, overrides: tuple[str, ...]) -> amrpic.Field:
    """Return the charge density of a scene at its start, on the mesh that its rule asks for. Collective."""
    changes = [f"domain.cells={base}", "output.write=[]", *overrides]
    plan = Plan(comm, amrpic.Scene.from_toml(EXAMPLES / f"{example}.toml", changes))
    mesh = make_base(plan)
    bunches = make_bunches(comm, plan.scene)
    plan.settle_interface(bunches)
    particles, _ = migrate(concatenate(bunches), mesh)
    return follow(ParticleFields(particles, mesh, plan)).rho


def refined_ghosts(field: amrpic.Field) -> tuple[np.ndarray, np.ndarray]:
    """Return positions (n, 3) in m and levels (n,) of the ghosts behind open walls of this rank's refined cells."""
    domain, hierarchy = field.hierarchy.domain, field.hierarchy
    positions, levels = [np.zeros((0, 3))], [np.zeros(0, np.int32)]
    for patch in field.patches:
        if patch.level == 0:
            continue
        spacing = np.array(hierarchy.spacing(patch.level))
        size = np.array(domain.cells) << patch.level
        for axis in range(3):
            for side, wall in enumerate((0, size[axis] - 1)):
                if domain.boundary[axis][side] != "open" or (patch.lower, patch.upper)[side][axis] != wall:
                    continue
                ranges = [np.arange(a, b + 1) for a, b in zip(patch.lower, patch.upper, strict=True)]
                ranges[axis] = np.array([wall + (1 if side else -1)])
                cells = np.stack(np.meshgrid(*ranges, indexing="ij"), -1).reshape(-1, 3)
                positions.append(np.array(domain.lower) + (cells + 0.5) * spacing)
                levels.append(np.full(len(cells), patch.level, np.int32))
    return np.ascontiguousarray(np.concatenate(positions)), np.concatenate(levels)


def slowest(comm: MPI.Comm, work: Callable[[], Any]) -> float:
    """Return the seconds that the slowest rank takes. Collective."""
    comm.Barrier()
    start = time.perf_counter()
    work()
    return comm.allreduce(time.perf_counter() - start, op=MPI.MAX)


def main() -> None:
    """Measure what the arguments ask for; rank 0 prints it as JSON."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--base", type=int, default=144, help="cells of the base along each axis")
    parser.add_argument("--example", default="ten_bunches", help="a scene of examples/")
    parser.add_argument("--set", action="append", default=[], metavar="KEY=VALUE", help="change a value of the scene")
    parser.add_argument("--repeats", type=int, default=5)
    args = parser.parse_args()
    found = measure(args.base, args.example, tuple(args.set), args.repeats)
    if MPI.COMM_WORLD.rank == 0:
        print(json.dumps(found, indent=2))


if __name__ == "__main__":
    main()

"""A call of `amrpic.SpaceCharge` beside the stages that it is made of: `python benchmarks space_charge`, on one rank.

A normal bunch drifts by a thousandth of its size between calls. Native stages are migrate, deposit, solve and gather, of
particles that stay sorted from one call to the next, as in a step; callers bring arrays, once in the order in which particles
lie on the mesh, and once in an order that has nothing to do with where they are. All take turns, on the same mesh.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from functools import partial
from statistics import median
from typing import Annotated, Any

import numpy as np
from mpi4py import MPI

import amrpic
from amrpic.mesh.field import Field
from amrpic.particles.particles import Particles
from amrpic.particles.species import Species, SpeciesTable
from amrpic.stages.deposit import deposit
from amrpic.stages.gather import compensate, gather
from amrpic.stages.migrate import migrate
from amrpic.stages.poisson import PoissonSolver, SolveReport
from measuring import CPU_TIME, Record, Runs

SIZE, CHARGE = 1e-3, 1e-9  # m, C
NATIVE, SORTED, SHUFFLED = "native stages", "sorted caller", "shuffled caller"


class NativeStages:
    """Migrate, deposit, solve and gather of particles on the mesh of a SpaceCharge, whose clouds it takes."""

    def __init__(self, like: Any, places: np.ndarray) -> None:
        self.hierarchy, self.clouds, self.options = like.hierarchy, like._memory.clouds, like._memory.options
        self.solver = PoissonSolver(self.hierarchy, options=self.options)
        species = SpeciesTable((Species("charge", charge=1.0, mass=1.0),))
        count = len(places)
        weight = np.broadcast_to(CHARGE / count, count)
        self.particles = Particles(places - like.centre, np.zeros((count, 3)), weight, np.arange(count), species)
        self.servers: np.ndarray | None = None
        self.phi: Field | None = None
        self.report: SolveReport | None = None
        self()

    def move(self, by: np.ndarray) -> None:
        self.particles = self.particles.replace(position=self.particles.position + by)

    def __call__(self) -> np.ndarray:
        self.particles, _ = migrate(self.particles, self.hierarchy, self.servers)
        assert self.particles.sorting is not None
        self.servers = self.particles.sorting.servers
        rho = deposit(self.particles, self.hierarchy, self.clouds)
        self.phi, self.report = self.solver.solve(rho, self.phi, last=self.report, deposited=CHARGE)
        efield = self.solver.deferred_field(self.phi, covered=self.clouds.covered)
        compensate(efield, rho, self.clouds, self.options.stretch)
        return gather(efield, self.particles, self.clouds)


def run(
    particles: Annotated[int, "of the bunch"] = 1_000_000,
    cells: Annotated[int, "base cells along an axis"] = 64,
    levels: Annotated[int, "refined levels"] = 1,
    runs: Runs = 15,
) -> Iterator[Record]:
    """Yield the CPU seconds of each; `ratio` is that to the native stages, the median of the turns."""
    rng = np.random.default_rng(0)
    shuffled = rng.normal(size=(3, particles)) * SIZE
    settings: dict[str, Any] = {"cells": cells, "levels": levels, "regrid_every": 0, "comm": MPI.COMM_SELF}
    callers = {name: amrpic.SpaceCharge(**settings) for name in (SORTED, SHUFFLED)}
    field_of(callers[SHUFFLED], shuffled)
    native = NativeStages(callers[SHUFFLED], shuffled.T)
    columns = {SORTED: np.ascontiguousarray(shuffled[:, native.particles.id]), SHUFFLED: shuffled}
    for name, caller in callers.items():
        field_of(caller, columns[name])

    seconds: dict[str, list[float]] = {name: [] for name in (NATIVE, SORTED, SHUFFLED)}
    for _ in range(runs):
        drift = rng.normal(size=3) * 1e-3 * SIZE
        native.move(drift)
        seconds[NATIVE].append(timed_once(native))
        for name, caller in callers.items():
            columns[name] = columns[name] + drift[:, None]
            seconds[name].append(timed_once(partial(field_of, caller, columns[name])))
    mesh_cells = native.hierarchy.cells()
    for name, taken in seconds.items():
        ratio = median(mine / stages for mine, stages in zip(taken, seconds[NATIVE], strict=True))
        yield Record(f"space charge, {name}", taken, cells=mesh_cells, particles=particles, facts={"ratio": ratio})


def field_of(caller: Any, columns: np.ndarray) -> np.ndarray:
    x, y, z = columns
    return caller.field(x, y, z, CHARGE / columns.shape[1])


def timed_once(work: Callable[[], Any]) -> float:
    """Return the CPU seconds that a call takes, of which the result is dropped."""
    start = CPU_TIME()
    work()
    return CPU_TIME() - start

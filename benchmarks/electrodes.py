"""What electrodes take of time beside the same mesh without them: `python benchmarks electrodes`. A worker of `bench`."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import partial
from typing import Annotated

import numpy as np
from mpi4py import MPI

import amrpic
from amrpic import shapes
from amrpic.stages.poisson import PoissonSolver
from measuring import Record, Runs, in_turns

TOLERANCE = 1e-10
STAGES = ("residual", "cycle", "correction")  # of a cycle


@dataclass(frozen=True)
class Scene:
    """Metal on so many base cells along each axis of a grounded box from −1 to 1."""

    electrodes: Callable[[float], list[amrpic.Electrode]]  # of the width of a cell
    cells: int
    levels: int = 0  # refined, at surfaces


def _sphere(h: float) -> list[amrpic.Electrode]:
    return [amrpic.Electrode("ball", shapes.Sphere((0.013, -0.02, 0.03), 0.5), voltage=1)]


def _foil(h: float) -> list[amrpic.Electrode]:
    foil: shapes.Shape = shapes.Box((-2, -2, 0.3 * h), (2, 2, 0.3 * h + 1e-4))
    for x in (-0.5, 0, 0.5):
        foil = foil - shapes.Box((x - 0.05, -0.8, -1), (x + 0.05, 0.8, 1))
    return [amrpic.Electrode("foil", foil, voltage=1)]


def _lens(h: float) -> list[amrpic.Electrode]:
    def ring(lower: float, upper: float) -> shapes.Shape:
        return shapes.Revolved([(lower, 0.4), (upper, 0.4), (upper, 0.5), (lower, 0.5)])

    ends = {"entrance": (-0.8, -0.33, 0.0), "lens": (-0.25, 0.25, 5.0), "exit": (0.33, 0.8, 0.0)}
    return [amrpic.Electrode(name, ring(lower, upper), voltage=volts) for name, (lower, upper, volts) in ends.items()]


def _wires(h: float) -> list[amrpic.Electrode]:
    """Of 0.64 cells at a pitch of four, which coarse cells miss."""
    most = round(0.8 / (4 * h))
    grid = _wire(0.1 - 4 * most, h)
    for m in range(1 - most, most + 1):
        grid = grid | _wire(4 * m + 0.1, h)
    return [amrpic.Electrode("grid", grid, voltage=1)]


def _wire(place: float, h: float) -> shapes.Shape:
    return shapes.Cylinder((place * h, -3, 0.2 * h), (place * h, 3, 0.2 * h), 0.64 * h)


WIRES = "wire grid 128"
SCENES = {
    "sphere 128": Scene(_sphere, 128),
    "foil with slits 128": Scene(_foil, 128),
    "einzel lens 128": Scene(_lens, 128),
    WIRES: Scene(_wires, 128),
    "sphere 64 and 2 levels": Scene(_sphere, 64, 2),
}


def name(scene: str, metal: bool, what: str) -> str:
    return f"electrodes, {scene}, {'with' if metal else 'without'}, {what}"


def beside(scene: str, runs: int) -> Iterator[Record]:
    """Yield solves to 1e-10 from zero, their cycles, and set-ups, in CPU time, with metal and without in turns."""
    of = SCENES[scene]
    domain = amrpic.Domain(-1, 1, of.cells, "dirichlet")
    electrodes = of.electrodes(2 / of.cells)
    mesh = amrpic.Hierarchy.around(MPI.COMM_SELF, domain, electrodes, of.levels, edges=0, max_grid_size=64)
    rho = amrpic.Field(mesh).fill(_charge)
    metals = {False: [], True: electrodes}
    solvers = {metal: PoissonSolver(mesh, tolerance=TOLERANCE, electrodes=held) for metal, held in metals.items()}
    cycles = {
        metal: solver.solve(rho)[1].cycles for metal, solver in solvers.items()
    }  # pages and tables come into being
    shares: dict[bool, list[float]] = {metal: [] for metal in metals}  # of a cycle in the time of a solve

    def solve(metal: bool) -> None:
        begun = time.perf_counter()
        report = solvers[metal].solve(rho)[1]
        whole = (time.perf_counter() - begun) * report.cycles
        shares[metal].append(sum(report.seconds[stage] for stage in STAGES) / whole)

    solves = in_turns([partial(solve, metal) for metal in metals], runs)
    set_ups = in_turns([partial(PoissonSolver, mesh, electrodes=held) for held in metals.values()], runs)
    count = sum(mesh.cells(level) for level in range(mesh.levels))
    for metal, of_solve, of_set_up in zip(metals, solves, set_ups, strict=True):
        yield Record(name(scene, metal, "solve"), of_solve, cells=count, facts={"cycles": cycles[metal]})
        yield Record(
            name(scene, metal, "cycle"), [a * b for a, b in zip(of_solve, shares[metal], strict=True)], cells=count
        )
        yield Record(name(scene, metal, "set-up"), of_set_up, cells=count)


def _charge(x: np.ndarray, y: np.ndarray, z: np.ndarray) -> np.ndarray:
    """C/m³, that changes from cell to cell."""
    return 1e-10 * np.sin(91 * x + 53 * y + 77 * z + 1)


def run(
    runs: Runs = 5, scenes: Annotated[tuple[str, ...], "what to time", tuple(SCENES)] = tuple(SCENES)
) -> Iterator[Record]:
    """All scenes."""
    for scene in scenes:
        yield from beside(scene, runs)

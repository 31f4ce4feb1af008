"""The constants of this machine: small runs on one rank and on all cores, and messages between two ranks.

Constants are fitted to what the plan of each run says that its ranks do, and to the medians of its steps.
"""

from __future__ import annotations

import os
import platform
import statistics
import sys
import tempfile
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
from mpi4py import MPI

from amrpic.scaling.measure import UNCOUNTED
from amrpic.scaling.measured import Measured, MeasuredRun
from amrpic.scaling.study import grown, launch
from amrpic.scene.scene import Scene

from .machine import Machine, Network, Work
from .model import OF_NEW, OF_WORK, PARTS, STAGES, Amounts, constants_of, fitted, network_time, row_of
from .plan import Plan, Planner

SCENE = """
name = "calibration"
[domain]
lower = "-20 mm"
upper = "20 mm"
cells = {cells}
boundary = "open"
[[bunches]]
distribution = "gaussian"
count = {bunches}
spacing = [0, 0, "20 mm"]
species = "electron"
sigma = "2 mm"
charge = "-10 pC"
particles = {particles}
momentum_spread = 1e-24
[refinement]
levels = {levels}
max_grid_size = {boxes}
regrid_every = {regrid_every}
rule = {{ kind = "charge-density", relative = 1e-3 }}
[solver]
tolerance = {tolerance}
[motion]
{motion}
[output]
write = ["series"]
"""
LEAPFROG, WALK = 'kind = "leapfrog"\ndt = "20 ps"', 'kind = "random-walk"\namplitude = "{amplitude} mm"'
SMALL, LARGE = WALK.format(amplitude=0.1), WALK.format(amplitude=0.5)  # compared with bricks
TO_MESH = '"discretization"'
VARIED = "cells", "boxes", "levels", "bunches", "particles", "tolerance", "motion", "regrid_every"
NONE = 'kind = "none"'
SIZES = (
    (48, 32, 0, 1, 20_000, 1e-3, LEAPFROG, 0),
    (48, 16, 1, 1, 100_000, 1e-9, SMALL, 2),
    (96, 16, 0, 2, 10_000, 1e-7, LARGE, 0),
    (96, 32, 0, 1, 1_000_000, TO_MESH, LEAPFROG, 0),
    (64, 16, 1, 1, 300_000, 1e-5, LARGE, 2),
    (64, 16, 1, 2, 100_000, 1e-8, LEAPFROG, 0),
    (64, 32, 2, 1, 1_000_000, TO_MESH, LEAPFROG, 0),
    (64, 16, 2, 1, 600_000, TO_MESH, LARGE, 2),
    (128, 16, 1, 1, 500_000, TO_MESH, LEAPFROG, 0),
    (128, 32, 1, 2, 50_000, TO_MESH, LARGE, 3),
    (80, 16, 2, 2, 500_000, TO_MESH, LARGE, 4),
    (96, 16, 1, 1, 800_000, TO_MESH, NONE, 0),
    (96, 32, 2, 1, 100_000, TO_MESH, NONE, 0),
    (48, 24, 3, 2, 400_000, TO_MESH, LARGE, 4),
    (112, 24, 2, 1, 200_000, TO_MESH, SMALL, 4),
)
STEPS = 8


def calibrate(
    launcher: str, clock: str = "wall", repeat: int = 2, say: Callable[[str], None] = lambda text: None
) -> Machine:
    """Return this machine: constants of one rank, of as many as it has cores, and of its messages. Raises InputError if ranks
    cannot be started."""
    cores = max(len(os.sched_getaffinity(0)), 2)
    with tempfile.TemporaryDirectory(dir=Path.cwd()) as folder:
        runs = list(_runs(Path(folder), launcher, cores, clock, repeat, say))
        say("messages between two ranks")
        output = Path(folder) / "network.txt"
        launch(launcher, 2, ["scaling_model.calibrate", str(output)], "a calibration")
        latency, per_byte, collective = np.loadtxt(output)
        network = Network(float(latency), float(cores / per_byte), cores, float(collective))
        found = measured(runs, [Path(folder) / f"scene_{number}.toml" for number in range(len(SIZES))], say)
    blank = Machine(
        platform.node() or "this machine",
        f"measured by amrpic scaling --calibrate on {cores} cores of {_processor()}, ranks on one node: medians of steps by "
        f"{'the clock on the wall' if clock == 'wall' else 'that of the processor'}",
        network,
        {},
        {},
        _cache(),
    )
    alone = fits(found[1], blank, {})
    return replace(blank, stages=fits(found[cores], blank, alone), alone=alone)


def _runs(
    folder: Path, launcher: str, cores: int, clock: str, repeat: int, say: Callable[[str], None]
) -> Iterator[MeasuredRun]:
    """Yield runs of scenes of all sizes on one rank and on all cores, in turns; they are named by the number of their size."""
    for turn in range(repeat):
        for number, size in enumerate(SIZES):
            scene = folder / f"scene_{number}.toml"
            scene.write_text(SCENE.format(**dict(zip(VARIED, size, strict=True))), encoding="utf-8")
            for ranks in (1, cores):
                say(f"run {turn + 1} of {repeat}, size {number + 1} of {len(SIZES)}, {ranks} ranks")
                output = folder / f"{turn}_{number}_{ranks}.json"
                arguments = [output, scene, "strong", number, STEPS, clock, "apart", *_for(scene, ranks)]
                launch(launcher, ranks, ["amrpic.scaling.measure", *map(str, arguments)], "a calibration")
                yield MeasuredRun.read(output)


def middle(one: Measured) -> int:
    """Return the middle of the steps of runs that were measured."""
    return UNCOUNTED + (one.steps // one.runs + 1) // 2


def least_disturbed(runs: Sequence[MeasuredRun]) -> list[Measured]:
    """Return the medians of the fastest run of each number of ranks, with each stage from the run in which it was fastest.

    Others may use the machine for as long as a run takes, and the system may have to find memory for some of its stages.
    """
    found = []
    for ranks in sorted({run.ranks for run in runs}):
        each = sorted((Measured.of([run]) for run in runs if run.ranks == ranks), key=lambda one: one.seconds)
        names = dict.fromkeys(name for one in each for name in one.stages)
        stages = {
            name: min((one.stages[name] for one in each if name in one.stages), key=lambda s: s.most) for name in names
        }
        found.append(replace(each[0], stages=stages))
    return found


def _for(scene: Path, ranks: int) -> list[str]:
    """Return overrides that give each of more ranks what it has of two."""
    return grown(Scene.from_toml(scene), ranks / 2) if ranks > 2 else []


def measured(
    runs: Sequence[MeasuredRun], scenes: Sequence[Path], say: Callable[[str], None]
) -> dict[int, list[tuple[Measured, Plan]]]:
    """Return by ranks the medians of runs, which are named by the numbers of their scenes, with plans of these."""
    found: dict[int, list[tuple[Measured, Plan]]] = {}
    for number, scene in enumerate(scenes):
        for one in least_disturbed([run for run in runs if run.scene == f"{number}"]):
            plan = Planner(Scene.from_toml(scene, _for(scene, one.ranks)), say, middle(one)).plan(one.ranks)
            found.setdefault(one.ranks, []).append((one, plan))
    return found


def _processor() -> str:
    lines = Path("/proc/cpuinfo").read_text(encoding="utf-8").splitlines()
    return next((line.split(":", 1)[1].strip() for line in lines if line.startswith("model name")), platform.machine())


def _cache() -> float:
    """Return the bytes of the last level of cache; 0 if the system does not say."""
    units, size = {"K": 2**10, "M": 2**20, "": 1}, 0
    for path in Path("/sys/devices/system/cpu/cpu0/cache").glob("index*/size"):
        text = path.read_text(encoding="utf-8").strip()
        size = max(size, int(text.rstrip("KM")) * units[text.lstrip("0123456789")])
    return float(size)


def fits(found: Sequence[tuple[Measured, Plan]], machine: Machine, least: Mapping[str, Work]) -> dict[str, Work]:
    """Return the constants of each stage that come nearest to what runs measured on plans of their ranks.

    None is below that of `least`: a rank among others does nothing faster than one alone.
    """
    taken: dict[str, list[tuple[dict[str, float], float]]] = {}
    for one, plan in found:
        for stage in (*STAGES, *OF_NEW):
            amounts = amounts_of(one, plan, machine, stage in OF_NEW)
            seconds = one.stages[stage].most if stage in one.stages else 0.0
            seconds -= sum(network_time(stage, plan, machine.network, amounts))
            if seconds > 0:
                taken.setdefault(constants_of(stage, plan), []).append((row_of(stage, plan, amounts), seconds))
    out = {}
    for name, rows in taken.items():
        parts = PARTS[name]
        matrix = np.array([[1.0, *(row[what] for what in parts)] for row, _ in rows])
        constants = ["call", *(OF_WORK[what] for what in parts)]
        bound = np.array([getattr(least.get(name, Work()), constant) for constant in constants])
        each = fitted(matrix, np.array([seconds for _, seconds in rows]), bound).tolist()
        out[name] = Work(**dict(zip(constants, each, strict=True)))
    return out


def amounts_of(one: Measured, plan: Plan, machine: Machine, on_new: bool = False) -> Amounts:
    """Return what a run had to do with the cycles that were measured, in steps that left the mesh as it was or in others."""
    cycles = statistics.median(plan.all_cycles(cycles) for cycles in one.of_solves)
    return Amounts.with_all(plan, machine, cycles, (one.new_cells if on_new else one.cells) / float(plan.cells.sum()))


def ping_pong(comm: MPI.Comm, seconds: float = 0.3) -> tuple[float, float, float]:
    """Return the latency of a message (s), the time of a byte (s) and that of an Allreduce per doubling of the ranks.

    Collective, on two ranks: shortest of many, since others may use the machine.
    """
    taken = []
    for size in (8, 2**20):
        there, least, end = np.zeros(size, dtype=np.uint8), np.inf, time.perf_counter() + seconds
        while comm.bcast(time.perf_counter() < end):
            start = time.perf_counter()
            for _ in range(10):
                if comm.rank == 0:
                    comm.Send(there, 1)
                    comm.Recv(there, 1)
                else:
                    comm.Recv(there, 0)
                    comm.Send(there, 0)
            least = min(least, (time.perf_counter() - start) / 20)
        taken.append(least)
    least, value, end = np.inf, np.zeros(1), time.perf_counter() + seconds
    while comm.bcast(time.perf_counter() < end):
        start = time.perf_counter()
        for _ in range(10):
            comm.Allreduce(MPI.IN_PLACE, value)
        least = min(least, (time.perf_counter() - start) / 10)
    return taken[0], taken[1] / 2**20, least / np.log2(comm.size)


if __name__ == "__main__":
    taken = ping_pong(MPI.COMM_WORLD)
    if MPI.COMM_WORLD.rank == 0:
        np.savetxt(sys.argv[1], taken)

"""The constants of this machine: a few small runs on one rank and on all cores at once, and messages between two ranks.

Constants are fitted to the work of each run by its plan, the medians of steps by the clock of the processor.
"""

from __future__ import annotations

import os
import platform
import shlex
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
from mpi4py import MPI

from ..errors import InputError
from ..scene.scene import Scene
from .machine import Machine, Network, Work
from .measured import Measured, Run, medians
from .model import OF_WORK, STAGES, Amounts, fitted, parts_of
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
species = "electron"
sigma = "2 mm"
charge = "-10 pC"
particles = {particles}
momentum_spread = 1e-24
[refinement]
levels = {levels}
regrid_every = 0
rule = {{ kind = "charge-density", relative = 1e-3 }}
[solver]
tolerance = {tolerance}
[motion]
kind = "leapfrog"
dt = "20 ps"
[output]
write = ["series"]
"""
SIZES = (  # cells, levels, particles, tolerance: each varied against the others
    (48, 0, 20_000, 1e-3),
    (96, 0, 20_000, 1e-7),
    (96, 0, 1_000_000, '"discretization"'),
    (64, 1, 300_000, 1e-5),
    (64, 2, 1_000_000, '"discretization"'),
    (128, 1, 500_000, 1e-5),
    (128, 1, 100_000, '"discretization"'),
)
STEPS = 8
CLOCK = "processor"


def calibrate(launcher: str, repeat: int = 2, say: Callable[[str], None] = lambda text: None) -> Machine:
    """Return this machine. Raises InputError if ranks cannot be started."""
    cores = len(os.sched_getaffinity(0))
    with tempfile.TemporaryDirectory(dir=Path.cwd()) as folder:
        found: dict[int, list[Run]] = {1: [], cores: []}
        plans: list[Plan] = []
        for turn in range(repeat):
            for number, size in enumerate(SIZES):
                cells, levels, particles, tolerance = size
                scene = Path(folder) / f"scene_{number}.toml"
                text = SCENE.format(cells=cells, levels=levels, particles=particles, tolerance=tolerance)
                scene.write_text(text, encoding="utf-8")
                if turn == 0:
                    plans.append(Planner(Scene.from_toml(scene)).plan(1))
                for ranks in found:
                    say(f"run {turn + 1} of {repeat}, size {number + 1} of {len(SIZES)}, {ranks} at once")
                    output = Path(folder) / f"{turn}_{number}_{ranks}.json"
                    _start(launcher, ranks, "measure", output, scene, "alone", f"{number}", STEPS, CLOCK)
                    found[ranks].append(Run.read(output))
        say("messages between two ranks")
        output = Path(folder) / "network.txt"
        _start(launcher, 2, "calibrate", output)
        latency, per_byte, collective = np.loadtxt(output)
    return Machine(
        platform.node() or "this machine",
        f"measured by amrpic scaling --calibrate on {cores} cores of {_processor()}, ranks on one node",
        Network(float(latency), float(cores / per_byte), cores, float(collective)),
        _fits(found[cores], plans),
        _fits(found[1], plans),
    )


def _start(launcher: str, ranks: int, module: str, *arguments: object) -> None:
    command = [*shlex.split(launcher.format(ranks=ranks)), sys.executable, "-m", f"amrpic.scaling.{module}"]
    try:
        done = subprocess.run(
            [*command, *map(str, arguments)], env=dict(os.environ), stdout=subprocess.DEVNULL, check=False
        )
    except OSError as reason:
        raise InputError(f"{command[0]} cannot be started ({reason.strerror}); choose another --launcher") from None
    if done.returncode != 0:
        raise InputError(
            f"a calibration on {ranks} ranks ended with status {done.returncode}; correct what it says above"
        )


def _processor() -> str:
    lines = Path("/proc/cpuinfo").read_text(encoding="utf-8").splitlines()
    return next((line.split(":", 1)[1].strip() for line in lines if line.startswith("model name")), platform.machine())


def _fits(runs: Sequence[Run], plans: Sequence[Plan]) -> dict[str, Work]:
    """Return the constants of each stage that come nearest to the medians of runs, named by the numbers of their plans."""
    found = [
        (int(name), medians([run for run in runs if run.scene == name])[0]) for name in {run.scene for run in runs}
    ]
    out = {}
    for stage in STAGES:
        parts = parts_of(stage)
        taken = [
            (amounts_of(one, plans[number]), one.stages[stage].most) for number, one in found if stage in one.stages
        ]
        taken = [(amounts, seconds) for amounts, seconds in taken if seconds > 0]
        if taken:
            rows = np.array([[1.0, *(getattr(amounts, what) for what in parts)] for amounts, _ in taken])
            call, *each = fitted(rows, np.array([seconds for _, seconds in taken])).tolist()
            out[stage] = Work(call, **{OF_WORK[what]: value for what, value in zip(parts, each, strict=True)})
    return out


def amounts_of(one: Measured, plan: Plan) -> Amounts:
    """Return what a run had to do, on the mesh and with the cycles that were measured."""
    of_plan = Amounts.of(plan, one.cycles)
    grown = one.cells / float(plan.cells.sum())
    return replace(of_plan, cells=of_plan.cells * grown, swept=of_plan.swept * grown)


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
    measured = ping_pong(MPI.COMM_WORLD)
    if MPI.COMM_WORLD.rank == 0:
        np.savetxt(sys.argv[1], measured)

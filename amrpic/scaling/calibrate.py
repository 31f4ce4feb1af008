"""The constants of this machine: a few small runs on one rank and on all cores at once, and messages between two ranks."""

from __future__ import annotations

import os
import platform
import shlex
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np
from mpi4py import MPI

from ..errors import InputError
from .machine import Machine, Network, Work
from .measured import Run
from .model import STAGES, fitted

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
    (96, 0, 20_000, 1e-3),
    (96, 0, 20_000, 1e-7),
    (96, 0, 1_000_000, 1e-3),
    (64, 1, 300_000, 1e-5),
    (64, 2, 1_000_000, 1e-3),
    (128, 1, 500_000, 1e-5),
)
STEPS = 6


def calibrate(launcher: str, repeat: int = 2, say: Callable[[str], None] = lambda text: None) -> Machine:
    """Return this machine. Raises InputError if ranks cannot be started."""
    cores = len(os.sched_getaffinity(0))
    with tempfile.TemporaryDirectory(dir=Path.cwd()) as folder:
        found: dict[int, list[Run]] = {1: [], cores: []}
        for turn in range(repeat):
            for number, size in enumerate(SIZES):
                cells, levels, particles, tolerance = size
                scene = Path(folder) / f"scene_{number}.toml"
                text = SCENE.format(cells=cells, levels=levels, particles=particles, tolerance=tolerance)
                scene.write_text(text, encoding="utf-8")
                for ranks in found:
                    say(f"run {turn + 1} of {repeat}, size {number + 1} of {len(SIZES)}, {ranks} at once")
                    output = Path(folder) / f"{turn}_{number}_{ranks}.json"
                    _start(launcher, ranks, "measure", output, scene, "alone", f"{number}", STEPS)
                    found[ranks].append(Run.read(output))
        say("messages between two ranks")
        output = Path(folder) / "network.txt"
        _start(launcher, 2, "calibrate", output)
        latency, per_byte, collective = np.loadtxt(output)
    return Machine(
        platform.node() or "this machine",
        f"measured by amrpic scaling --calibrate on {cores} cores of {_processor()}, ranks on one node",
        Network(float(latency), float(cores / per_byte), cores, float(collective)),
        _fits(found[cores]),
        _fits(found[1]),
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


def _fits(runs: Sequence[Run]) -> dict[str, Work]:
    """Return the constants of each stage that come nearest to the shortest that runs of several sizes took."""
    sizes = [[run for run in runs if run.scene == name] for name in sorted({run.scene for run in runs})]
    out = {}
    for stage in STAGES:
        seconds = np.array([shortest(of, stage) for of in sizes])
        taken = seconds > 0
        if taken.any():
            amounts = np.array([_amounts(of[0], stage) for of in sizes])
            out[stage] = Work(*fitted(amounts[taken], seconds[taken]).tolist())
    return out


def shortest(runs: Sequence[Run], stage: str) -> float:
    """Return the least seconds of a stage on its slowest rank over all steps: others may have used the machine in the rest."""
    return min((step[stage].most for run in runs for step in run.steps if stage in step), default=0.0)


def _amounts(one: Run, stage: str) -> list[float]:
    """Return by what the constants of `Work` are multiplied; zero for those that have no part in a stage."""
    of_solve, at_walls = stage == "solve", stage == "open walls"
    return [
        1.0,
        0.0 if at_walls else float(one.cells),
        one.cells * float(np.median(one.cycles)) if of_solve else 0.0,
        0.0 if of_solve or at_walls else float(one.particles),
        float(one.wall_cells) if at_walls else 0.0,
    ]


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

"""Compare what `amrpic preview` foresees with what runs take: `python benchmarks forecasts [SCENE ...] [--ranks 1 2]`.

Each scene is forecast in five seconds, as the preview does, and run in a process of its own, as by `amrpic run`, to its end
or for the first `--steps`. Without a scene all examples are taken. The machine must be quiet. Exit status 1: a goal is missed.
"""

from __future__ import annotations

import argparse
import math
import tempfile
import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from mpi4py import MPI

import amrpic
from amrpic.commands.methods import scene_from
from amrpic.pic.forecast import forecast
from amrpic.pic.initial_particles import make_bunches
from amrpic.scene.any_scene import read_data
from amrpic.tables import columns
from goals import Goal
from measuring import ROOT, Record, launch, write

TRIED = 5.0  # s of trials, as the preview takes by default
FACTOR = 1.5  # by which a forecast may be off
FORESEEN, TAKEN = "foreseen", "taken"  # names of records, and of the two works


@dataclass(frozen=True)
class Compared:
    """Seconds of a scene as foreseen and as its run took: (up to the first solve, of the mean step)."""

    scene: str
    ranks: int
    steps: int
    source: str
    foreseen: tuple[float, float]
    taken: tuple[float, float]

    @property
    def ratios(self) -> tuple[float, float]:
        """Foreseen over taken; nan for the steps of a run of one solve."""
        start, step = (own / run if run else math.nan for own, run in zip(self.foreseen, self.taken, strict=True))
        return start, step

    @property
    def factor(self) -> float:
        """By how much the seconds per step, or those of the only solve, are off, at least 1."""
        return factor(self.ratios[1 if self.steps else 0])


def factor(ratio: float) -> float:
    """Return by how much a ratio is off 1 in either direction, at least 1."""
    return max(ratio, 1 / ratio)


def compare(path: Path, ranks: int, steps: int | None = None) -> Compared:
    """Forecast a scene and run it, one after the other, on ranks started for that. Raises CalledProcessError."""
    most = [] if steps is None else ["--steps", str(steps)]
    found, run = (launch("forecasts", ranks, [str(path), "--work", work, *most])[0] for work in (FORESEEN, TAKEN))
    pairs = [(start, step) for start, step in (found.seconds, run.seconds)]
    return Compared(path.stem, ranks, run.facts["steps"], found.facts["source"], *pairs)


# ---- on the ranks that are started ----


def foreseen(comm: MPI.Comm, scene: amrpic.Scene) -> Record:
    """Return the forecast of a scene, after a first look at its mesh as in the preview. Collective."""
    begun = time.perf_counter()
    make_bunches(comm, scene)
    made = comm.allreduce(time.perf_counter() - begun, op=MPI.MAX)
    seen = amrpic.Simulation(comm, scene)
    cells = sum(seen.hierarchy.cells(level) for level in range(seen.hierarchy.levels))
    del seen
    found = forecast(comm, scene, cells, made, TRIED)
    assert found is not None
    return Record(FORESEEN, [found.start, found.step], facts={"source": found.source})


def taken(comm: MPI.Comm, scene: amrpic.Scene) -> Record:
    """Run a scene and return what its series says of its start and of its mean step. Collective."""
    seconds = amrpic.Simulation(comm, scene).run(log="silent").series["seconds"]
    steps = scene.schedule.last_step
    return Record(TAKEN, [float(seconds[0]), float(seconds[1:].mean()) if steps else 0.0], facts={"steps": steps})


def worker(path: Path, work: str, steps: int | None, output: Path) -> None:
    """Do one of the two works on all ranks and write its record. Collective."""
    comm = MPI.COMM_WORLD
    scene = amrpic.Scene.from_toml(path)
    if steps is not None and steps < scene.schedule.last_step:
        scene = scene.replace(schedule={"steps": steps})
    with tempfile.TemporaryDirectory(prefix="amrpic-") as own:
        folder = comm.bcast(own)
        scene = scene.model_copy(update={"output": scene.output.model_copy(update={"directory": folder})})
        record = {FORESEEN: foreseen, TAKEN: taken}[work](comm, scene)
        comm.Barrier()
    if comm.rank == 0:
        write(output, [record])


# ---- the table ----


def rows(found: Sequence[Compared]) -> list[tuple[str, ...]]:
    """Return the comparison as rows of a table."""
    out: list[tuple[str, ...]] = [
        ("scene", "ranks", "start ms", "foreseen", "ratio", "step ms", "foreseen", "ratio", "from")
    ]
    for one in found:
        (start, step), (first, then) = one.taken, one.foreseen
        ratios = one.ratios
        steps = (f"{1e3 * step:.3g}", f"{1e3 * then:.3g}", f"{ratios[1]:.2f}") if one.steps else ("", "", "")
        begun = (f"{1e3 * start:.3g}", f"{1e3 * first:.3g}", f"{ratios[0]:.2f}")
        out.append((one.scene, str(one.ranks), *begun, *steps, one.source))
    return out


def verdicts(found: Sequence[Compared]) -> list[Goal]:
    """Return the goals: of each scene its seconds per step, or those of its only solve."""
    return [Goal(f"{one.scene} on {one.ranks}", one.factor, FACTOR) for one in found]


def has_bunches(path: Path) -> bool:
    """Whether a scene is particle-in-cell: previews foresee the time of no other."""
    return isinstance(scene_from(read_data(path), path), amrpic.Scene)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("scenes", nargs="*", type=Path, help="scene files; default all examples with bunches")
    parser.add_argument("--ranks", nargs="+", type=int, default=[1, 2], help="default 1 2")
    parser.add_argument("--steps", type=int, help="at most so many of each run")
    parser.add_argument("--work", choices=(FORESEEN, TAKEN), help=argparse.SUPPRESS)
    parser.add_argument("--output", type=Path, help=argparse.SUPPRESS)
    given = parser.parse_args()
    if given.work:
        return worker(given.scenes[0], given.work, given.steps, given.output)
    scenes = given.scenes or [path for path in sorted((ROOT / "examples").glob("*.toml")) if has_bunches(path)]
    found = [compare(path, ranks, given.steps) for ranks in given.ranks for path in scenes]
    print(*columns(rows(found)), sep="\n")
    missed = [goal for goal in verdicts(found) if goal.verdict == "missed"]
    for goal in missed:
        print(f"{goal.what}: off by a factor of {goal.measured:.3g}, {goal.bound(goal.must)}: missed")
    raise SystemExit(1 if missed else 0)

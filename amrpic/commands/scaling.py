"""amrpic scaling: how a scene's steps speed up with ranks; the same scene on more ranks, and scenes that grow with them.

`study` starts one run per number of ranks by a launcher (mpiexec, srun) and collects what each measured; `python -m
amrpic.commands.scaling` is such a run.
"""

from __future__ import annotations

import argparse
import json
import os
import shlex
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from mpi4py import MPI

from ..errors import InputError, OutputError
from ..failure import Meeting, sentence
from ..mesh.boxes import scaled_cells
from ..run.plan import Plan
from ..run.step import advance, begin
from ..scene.scene import Scene
from .arguments import Commands, command, count, scene_arguments, scene_of

if TYPE_CHECKING:
    from matplotlib.figure import Figure

KINDS = ("strong", "weak")
LAUNCHER = "mpiexec -n {ranks}"


@dataclass(frozen=True)
class Measured:
    """Steps of a scene on so many ranks. Seconds are medians over the steps, each of the slowest rank."""

    kind: str
    ranks: int
    cells: int  # of all levels
    particles: int
    seconds: float  # of a step
    stages: dict[str, float]  # s, of each stage of a step
    traffic: dict[str, dict[str, float]]  # of each stage of a step: messages, bytes and collectives of the busiest rank

    @property
    def work(self) -> float:
        """Cells and particles of a rank."""
        return (self.cells + self.particles) / self.ranks


def efficiency(first: Measured, other: Measured) -> float:
    """Return the part of a rank's speed, in cells and particles per second, that is left of that with fewest ranks."""
    return (other.work / other.seconds) / (first.work / first.seconds)


# ---- one run ----


def measure(comm: MPI.Comm, scene: Scene, kind: str, steps: int) -> Measured:
    """Return what so many steps take, after a first one that is not counted. Collective; nothing is written."""
    plan = Plan(comm, scene)
    state = advance(begin(plan), plan)
    taken: list[float] = []
    stages: dict[str, list[float]] = {}
    passed: dict[str, dict[str, list[float]]] = {}
    for _ in range(steps):
        comm.Barrier()
        start = time.perf_counter()
        state = advance(state, plan)
        taken.append(comm.allreduce(time.perf_counter() - start, op=MPI.MAX))
        for stage, spent in state.spent.items():
            stages.setdefault(stage, []).append(comm.allreduce(spent.seconds, op=MPI.MAX))
            for what, number in asdict(spent.traffic).items():
                most = comm.allreduce(number, op=MPI.MAX)
                passed.setdefault(stage, {}).setdefault(what, []).append(most)
    mesh = state.hierarchy
    return Measured(
        kind,
        comm.size,
        sum(mesh.cells(level) for level in range(mesh.levels)),
        state.particles.global_count(comm),
        statistics.median(taken),
        {stage: statistics.median(spent) for stage, spent in stages.items()},
        {stage: {what: statistics.median(n) for what, n in each.items()} for stage, each in passed.items()},
    )


def grown(scene: Scene, factor: float) -> list[str]:
    """Return the overrides that give a scene so many times its particles and, nearly, its cells: a finer mesh.

    Along axes whose cells are a multiple of the blocking factor they stay one.
    """
    cells = scaled_cells(scene.domain.value.cells, factor ** (1 / 3), scene.refinement.blocking_factor)
    bunches = scene.to_dict()["bunches"]
    counts = [
        0 if "file" in bunch else bunch.get("particles", 0) for bunch in bunches
    ]  # those of a file are what they are
    more = [f"bunches.{number}.particles={round(count * factor)}" for number, count in enumerate(counts) if count]
    return [f"domain.cells={list(cells)}", *more]


# ---- the study ----


def study(
    path: str | Path,
    overrides: Sequence[str] = (),
    ranks: Sequence[int] = (1, 2),
    kinds: Sequence[str] = KINDS,
    steps: int = 5,
    launcher: str = LAUNCHER,
) -> Iterator[Measured]:
    """Yield what each run measures: for each kind the numbers of ranks in ascending order.

    `strong`: the scene as it is; `weak`: particles and cells in proportion to the ranks, the scene as it is on the fewest.
    `launcher` is the command that starts {ranks} ranks, put before the program. Not for ranks that run already: it starts
    its own. Raises InputError if a run cannot be started or fails, after what it said itself.
    """
    if "{ranks}" not in launcher:
        raise InputError(f'launcher is "{launcher}"; name the number of ranks in it as {{ranks}}, as in "{LAUNCHER}"')
    if MPI.COMM_WORLD.size > 1:
        raise InputError(f"scaling starts ranks of its own, but is on {MPI.COMM_WORLD.size}; start it without mpiexec")
    counts = sorted(set(ranks))
    changes = ["output.write=[]", *overrides]
    scene = Scene.from_toml(path, changes)
    for kind in kinds:
        for number in counts:
            more = grown(scene, number / counts[0]) if kind == "weak" else []
            yield _launched(launcher, number, [str(path), kind, str(steps), *changes, *more])


def _launched(launcher: str, ranks: int, arguments: Sequence[str]) -> Measured:
    with tempfile.TemporaryDirectory(dir=Path.cwd()) as folder:  # here, where all nodes of a cluster see it
        found = Path(folder) / "measured.json"
        command = [
            *shlex.split(launcher.format(ranks=ranks)),
            sys.executable,
            "-m",
            "amrpic.commands.scaling",
            str(found),
        ]
        try:
            # os.environ is what this process started with; MPI has added to its own that it is a rank of a run
            status = subprocess.run([*command, *arguments], env=dict(os.environ), check=False).returncode
        except OSError as reason:
            raise InputError(f"{command[0]} cannot be started ({reason.strerror}); choose another --launcher") from None
        if status != 0 or not found.exists():
            raise InputError(f"the run on {ranks} ranks ended with status {status}; correct what it says above")
        return Measured(**json.loads(found.read_text(encoding="utf-8")))


# ---- what is shown ----


def table(found: Sequence[Measured]) -> str:
    """Return the runs as lines of text, each kind against its run on the fewest ranks."""
    lines = [f"{'':8}{'ranks':>6}{'cells':>13}{'particles':>12}{'s/step':>11}{'faster':>9}{'efficiency':>12}"]
    for kind, runs in by_kind(found).items():
        first = runs[0]
        lines += [
            f"{kind:8}{one.ranks:6}{one.cells:13}{one.particles:12}{one.seconds:11.4g}{first.seconds / one.seconds:9.2f}"
            f"{efficiency(first, one):12.0%}"
            for one in runs
        ]
    return "\n".join(lines)


def stage_table(one: Measured) -> str:
    """Return what the stages of a step take and send on the slowest and on the busiest rank, as lines of text."""
    lines = [f"{one.kind}, {one.ranks} ranks{'ms':>11}{'messages':>12}{'kB':>9}{'collectives':>14}  of a step"]
    width = len(lines[0].split(" ranks")[0]) + 6
    for stage, seconds in one.stages.items():
        sent = one.traffic[stage]
        lines.append(
            f"  {stage:{width - 2}}{1e3 * seconds:11.3g}{sent['messages']:12.0f}{sent['bytes'] / 1e3:9.0f}"
            f"{sent['collectives']:14.0f}"
        )
    return "\n".join(lines)


def by_kind(found: Sequence[Measured]) -> dict[str, list[Measured]]:
    """Return the runs of each kind, fewest ranks first."""
    kinds = dict.fromkeys(one.kind for one in found)
    return {kind: sorted((o for o in found if o.kind == kind), key=lambda one: one.ranks) for kind in kinds}


def write(found: Sequence[Measured], folder: Path) -> list[Path]:
    """Write scaling.json and scaling.png into a folder; return their paths. Raises OutputError."""
    try:
        folder.mkdir(parents=True, exist_ok=True)
        (folder / "scaling.json").write_text(json.dumps([asdict(one) for one in found], indent=1), encoding="utf-8")
        draw(found).savefig(folder / "scaling.png", dpi=110)
    except OSError as reason:
        raise OutputError(f"cannot write into {folder}: {reason.strerror}; choose another --output") from None
    return [folder / "scaling.json", folder / "scaling.png"]


def draw(found: Sequence[Measured]) -> Figure:
    """Return the efficiency over ranks, and where the time of a rank's work goes, kind by kind."""
    from matplotlib.figure import Figure

    kinds = by_kind(found)
    figure = Figure(figsize=(4.2 * (1 + len(kinds)), 3.6), layout="constrained")
    left, *panels = figure.subplots(1, 1 + len(kinds))
    for kind, runs in kinds.items():
        left.plot([one.ranks for one in runs], [efficiency(runs[0], one) for one in runs], "o-", label=kind)
    left.axhline(1, color="black", linewidth=0.8, linestyle="--")
    left.set(xlabel="ranks", ylabel="efficiency", xscale="log", ylim=(0, None))
    left.set_xticks(sorted({one.ranks for one in found}), [str(n) for n in sorted({one.ranks for one in found})])
    left.minorticks_off()
    left.legend(frameon=False)
    names = list(dict.fromkeys(stage for one in found for stage in one.stages))
    for panel, (kind, runs) in zip(panels, kinds.items(), strict=True):
        labels = [str(one.ranks) for one in runs]
        bottom = np.zeros(len(runs))
        for stage in names:
            parts = np.array([1e9 * one.stages.get(stage, 0.0) / one.work for one in runs])
            panel.bar(labels, parts, bottom=bottom, label=stage, width=0.6)
            bottom += parts
        panel.set(title=kind, xlabel="ranks", ylabel="ns per cell and particle of a rank")
    panels[-1].legend(fontsize=8, frameon=False, loc="center left", bbox_to_anchor=(1, 0.5))
    return figure


# ---- the command ----


def add(commands: Commands) -> None:
    """Add the command to the parser."""
    scaling = command(
        commands, "scaling", _scaling, "measure how steps of a scene speed up with ranks, which it starts"
    )
    scene_arguments(scaling)
    scaling.add_argument("--ranks", type=count, nargs="+", default=[1, 2], metavar="N", help="numbers of ranks")
    scaling.add_argument(
        "--kind",
        choices=KINDS,
        help="strong: the same scene on all; weak: cells and particles grow with the ranks; default both",
    )
    scaling.add_argument("--steps", type=count, default=5, metavar="N", help="steps of a run; it reports medians")
    scaling.add_argument(
        "--launcher",
        default=LAUNCHER,
        metavar="COMMAND",
        help='what starts the ranks, such as "srun -n {ranks}"',
    )
    scaling.add_argument("--output", metavar="DIR", help="where to write; default runs/<scene>")


def _scaling(chosen: argparse.Namespace) -> int:
    folder = scene_of(chosen).directory
    kinds = KINDS if chosen.kind is None else (chosen.kind,)
    found = []
    for measured in study(chosen.scene, chosen.set, chosen.ranks, kinds, chosen.steps, chosen.launcher):
        found.append(measured)
        print(f"{measured.kind}, {measured.ranks} ranks: {measured.seconds:.4g} s/step", flush=True)
    print(table(found))
    for runs in by_kind(found).values():
        print(stage_table(runs[-1]))
    print(*write(found, folder), sep="\n")
    return 0


def _main() -> int:
    parser = argparse.ArgumentParser(prog="python -m amrpic.commands.scaling")
    for name in ("output", "scene", "kind"):
        parser.add_argument(name)
    parser.add_argument("steps", type=int)
    parser.add_argument("overrides", nargs="*")
    given = parser.parse_args()
    comm = MPI.COMM_WORLD
    meeting = Meeting(comm)
    try:
        found = measure(comm, Scene.from_toml(given.scene, given.overrides), given.kind, given.steps)
    except Exception as failure:
        return meeting.report(failure, sentence(failure))
    if comm.rank == 0:
        Path(given.output).write_text(json.dumps(asdict(found)), encoding="utf-8")
    return 0


if __name__ == "__main__":
    sys.exit(_main())

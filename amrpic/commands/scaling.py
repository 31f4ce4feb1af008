"""amrpic scaling: how a scene's steps speed up with ranks, measured on those there are and planned for any number."""

from __future__ import annotations

import argparse
import shlex
import sys
import time
from collections.abc import Callable, Sequence
from pathlib import Path

from ..errors import InputError
from ..scaling.measure import CLOCKS
from ..scaling.measured import Measured, by_kind, medians
from ..scaling.show import page, stage_table, table, write
from ..scaling.study import KINDS, LAUNCHER, Study
from .arguments import Commands, command, count, pic_scene_of, scene_arguments, scene_of
from .text_table import columns


def add(commands: Commands) -> None:
    """Add the command to the parser."""
    scaling = command(
        commands,
        "scaling",
        _scaling,
        "measure how steps of a scene speed up with ranks, or plan it for any number of them",
        "measuring and planning",
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
        "--repeat", type=count, default=1, metavar="N", help="starts of each number of ranks, which take turns"
    )
    scaling.add_argument(
        "--launcher",
        default=LAUNCHER,
        metavar="COMMAND",
        help='what starts the ranks, such as "srun -n {ranks}"',
    )
    scaling.add_argument(
        "--sbatch",
        metavar="OPTIONS",
        help='write a batch job for each number of ranks in place of starting it, with options of sbatch, such as "-t 30"',
    )
    scaling.add_argument(
        "--collect",
        action="store_true",
        help="show what earlier starts and batch jobs have measured, and start nothing",
    )
    scaling.add_argument(
        "--clock",
        choices=CLOCKS,
        default="wall",
        help="measure by the clock on the wall, or by that of the processor where others use the machine",
    )
    scaling.add_argument(
        "--apart",
        action="store_true",
        help="let all ranks begin each stage of a step together, so that the time they wait for each other is shown by itself; "
        "--predict does so too",
    )
    scaling.add_argument(
        "--predict", metavar="NAME", help="show the model with the constants of a machine beside what was measured"
    )
    scaling.add_argument(
        "--plan", type=_list, metavar="N,N,...", help="count and model a step on so many ranks that need not exist"
    )
    scaling.add_argument(
        "--machine",
        action="append",
        metavar="NAME",
        help="constants of the model of --plan: aries, slingshot, two_cores or a TOML file; several if repeated; default aries",
    )
    scaling.add_argument(
        "--targets", type=Path, metavar="FILE", help="a TOML file with goals for the plans, shown beside their results"
    )
    scaling.add_argument(
        "--page",
        type=Path,
        metavar="FILE",
        help="where the text of --plan goes, as Markdown; default plan.md in --output",
    )
    scaling.add_argument(
        "--cycles",
        type=float,
        metavar="N",
        help="of a solve, on average, for --plan; default 2, and about 1 where solves start from extrapolated potentials",
    )
    scaling.add_argument("--calibrate", metavar="FILE", help="measure the constants of this machine into a TOML file")
    scaling.add_argument("--output", metavar="DIR", help="where to write; default runs/<scene>")


def _list(text: str) -> list[int]:
    return sorted({count(part) for part in text.split(",") if part.strip()})


def _scaling(chosen: argparse.Namespace) -> int:
    folder = scene_of(chosen).directory
    if chosen.calibrate is not None:
        return _calibrate(chosen.launcher, chosen.clock, Path(chosen.calibrate))
    if chosen.plan is not None:
        return _plan(chosen, folder)
    kinds = KINDS if chosen.kind is None else (chosen.kind,)
    apart = chosen.apart or chosen.predict is not None
    study = Study(
        chosen.scene, folder, chosen.set, chosen.ranks, kinds, chosen.steps, chosen.launcher, chosen.clock, apart
    )
    if chosen.sbatch is not None:
        for path in study.write_jobs(chosen.sbatch, chosen.repeat):
            print(f"sbatch {path}")
        return 0
    if not chosen.collect:
        for run in study.start(chosen.repeat):
            print(f"{run.kind}, {run.ranks} ranks: {sorted(run.seconds)[len(run.seconds) // 2]:.4g} s/step", flush=True)
    found = medians(study.runs())
    if not found:
        raise InputError(
            f"{study.folder} holds no run of {study.name}; start some without --collect, or give --set, --clock and --apart as "
            "they were started with"
        )
    print(*columns(table(found)), sep="\n")
    for runs in by_kind(found).values():
        print(f"\n{runs[-1].kind}, {runs[-1].ranks} ranks", *columns(stage_table(runs[-1])), sep="\n")
    compared = [] if chosen.predict is None else [_predict(chosen, found)]
    print(*write(found, page(found, study.name, compared), folder), sep="\n")
    return 0


def _predict(chosen: argparse.Namespace, found: Sequence[Measured]) -> tuple[str, list[list[str]]]:
    """Print the model beside what was measured; return what is said of it, and its table."""
    from ..scaling.machine import Machine
    from ..scaling.predict import LEAST, predicted

    machine, strong = Machine.read(chosen.predict), [one for one in found if one.kind == "strong"]
    rows, worst = predicted(pic_scene_of(chosen), strong, machine, _progress())
    print(f"\nmodelled on {machine.name}", *columns(rows), f"largest error {worst:.0%}", sep="\n")
    said = (
        f"## Modelled on {machine.name}\n\nConstants: {machine.source}. Mesh and cycles are those of the runs; stages begin "
        f"together. Of stages above {LEAST:.0%} of a step the largest error is {worst:.0%}."
    )
    return said, rows


def _calibrate(launcher: str, clock: str, path: Path) -> int:
    from ..scaling.calibrate import calibrate  # no other command needs its imports

    calibrate(launcher, clock, say=_progress()).write(path)
    print(path)
    return 0


def _plan(chosen: argparse.Namespace, folder: Path) -> int:
    from ..scaling.machine import Machine
    from ..scaling.plan import Planner, cycles_per_solve
    from ..scaling.report import write_plans
    from ..scaling.targets import Targets

    targets = None if chosen.targets is None else Targets.read(chosen.targets)
    machines = [Machine.read(name) for name in chosen.machine or ["aries"]]
    say = _progress()
    planner = Planner(pic_scene_of(chosen), say)
    plans = list(planner.plans(chosen.plan))
    cycles = cycles_per_solve(planner.scene) if chosen.cycles is None else chosen.cycles
    text, paths = write_plans(planner, plans, machines, cycles, folder, chosen.page, targets, _said(chosen))
    say("")
    print(text)
    print(*paths, sep="\n")
    return 0


def _said(chosen: argparse.Namespace) -> str:
    """Return the command that makes a plan, as it is shown."""
    changes = [part for change in chosen.set for part in ("--set", change)]
    machines = [part for name in chosen.machine or [] for part in ("--machine", name)]
    cycles = [] if chosen.cycles is None else ["--cycles", f"{chosen.cycles:g}"]
    targets = [] if chosen.targets is None else ["--targets", str(chosen.targets)]
    plan = ["--plan", ",".join(map(str, chosen.plan))]
    return shlex.join(["amrpic", "scaling", str(chosen.scene), *changes, *plan, *machines, *cycles, *targets])


def _progress() -> Callable[[str], None]:
    """Return what says how far a long command is: on stderr, on one line where that is a terminal, else every ten seconds."""
    latest = [0.0]

    def say(text: str) -> None:
        terminal, now = sys.stderr.isatty(), time.monotonic()
        if terminal:
            print(f"\r{text:<79}" + ("" if text else "\r"), end="", file=sys.stderr, flush=True)
        elif text and now - latest[0] > 10:
            latest[0] = now
            print(text, file=sys.stderr, flush=True)

    return say

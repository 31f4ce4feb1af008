"""`python benchmarks scaling_model`: plan a scene for ranks that need not exist, measure a machine, compare both."""

from __future__ import annotations

import argparse
import os
import shlex
import sys
import time
from collections.abc import Callable, Sequence
from pathlib import Path

from amrpic.scaling.measure import CLOCKS
from amrpic.scaling.measured import medians
from amrpic.scaling.show import as_markdown, page, write
from amrpic.scaling.study import LAUNCHER, Study
from amrpic.scene.scene import Scene
from amrpic.tables import columns

from .calibrate import calibrate
from .machine import Machine
from .plan import Planner, cycles_per_solve
from .predict import LEAST, predicted
from .report import write_plans
from .targets import Targets


def arguments() -> argparse.ArgumentParser:
    """The options."""
    parser = argparse.ArgumentParser("python benchmarks scaling_model", description=__doc__)
    parser.add_argument("scene", metavar="SCENE", help="a TOML file")
    parser.add_argument("--set", action="append", default=[], metavar="KEY=VALUE", help="override a value of the scene")
    act = parser.add_mutually_exclusive_group(required=True)
    act.add_argument("--plan", type=_list, metavar="N,N,...", help="count and model a step on so many ranks")
    act.add_argument("--predict", metavar="NAME", help="measure the scene and show the model of a machine beside it")
    act.add_argument(
        "--calibrate", metavar="FILE", type=Path, help="measure the constants of this machine into a TOML file"
    )
    parser.add_argument(
        "--machine",
        action="append",
        metavar="NAME",
        help="constants for --plan: aries, slingshot, two_cores or a TOML file; several if repeated; default aries",
    )
    parser.add_argument(
        "--targets", type=Path, metavar="FILE", help="a TOML file with goals for plans, shown beside them"
    )
    parser.add_argument(
        "--page", type=Path, metavar="FILE", help="where a plan's text goes; default plan.md in --output"
    )
    parser.add_argument(
        "--cycles",
        type=float,
        metavar="N",
        help="of a solve, on average, for --plan; default 2, and about 1 where solves start from extrapolated potentials",
    )
    parser.add_argument("--ranks", type=int, nargs="+", default=[1, 2], metavar="N", help="for --predict")
    parser.add_argument("--steps", type=int, default=5, metavar="N", help="of a run, for --predict")
    parser.add_argument(
        "--repeat", type=int, default=1, metavar="N", help="starts of each number of ranks, for --predict"
    )
    parser.add_argument("--launcher", default=LAUNCHER, metavar="COMMAND", help='such as "srun -n {ranks}"')
    parser.add_argument("--clock", choices=CLOCKS, default="wall", help="on the wall, or of the processor")
    parser.add_argument("--output", type=Path, metavar="DIR", help="where to write; default runs/<scene>")
    return parser


def _list(text: str) -> list[int]:
    return sorted({int(part) for part in text.split(",") if part.strip()})


def main(words: Sequence[str] | None = None) -> None:
    """Run the command."""
    words = sys.argv[1:] if words is None else words
    chosen = arguments().parse_args(words)
    os.environ["PYTHONPATH"] = str(Path(__file__).parents[1])  # of ranks that are started
    if chosen.calibrate is not None:
        calibrate(chosen.launcher, chosen.clock, say=progress()).write(chosen.calibrate)
        print(chosen.calibrate)
        return
    scene = Scene.from_toml(chosen.scene, chosen.set)
    folder = scene.directory if chosen.output is None else chosen.output
    if chosen.plan is not None:
        _plan(chosen, scene, folder, words)
    else:
        _predict(chosen, scene, folder)


def _plan(chosen: argparse.Namespace, scene: Scene, folder: Path, words: Sequence[str]) -> None:
    targets = None if chosen.targets is None else Targets.read(chosen.targets)
    machines = [Machine.read(name) for name in chosen.machine or ["aries"]]
    say = progress()
    planner = Planner(scene, say)
    plans = list(planner.plans(chosen.plan))
    cycles = cycles_per_solve(planner.scene) if chosen.cycles is None else chosen.cycles
    command = shlex.join(["python", "benchmarks", "scaling_model", *_shown(words)])
    text, paths = write_plans(planner, plans, machines, cycles, folder, chosen.page, targets, command)
    say("")
    print(text)
    print(*paths, sep="\n")


def _shown(words: Sequence[str]) -> list[str]:
    """The options that make a plan, without those that say where it goes."""
    places = [n for n, word in enumerate(words) if word in ("--output", "--page")]
    return [word for n, word in enumerate(words) if n not in places and n - 1 not in places]


def _predict(chosen: argparse.Namespace, scene: Scene, folder: Path) -> None:
    study = Study(
        chosen.scene, folder, chosen.set, chosen.ranks, ("strong",), chosen.steps, chosen.launcher, chosen.clock, True
    )
    for run in study.start(chosen.repeat):
        print(f"{run.ranks} ranks: {sorted(run.seconds)[len(run.seconds) // 2]:.4g} s/step", flush=True)
    measured, machine = medians(study.runs()), Machine.read(chosen.predict)
    rows, worst = predicted(scene, [run for run in measured if run.kind == "strong"], machine, progress())
    print(f"\nmodelled on {machine.name}", *columns(rows), f"largest error {worst:.0%}", sep="\n")
    about = (
        f"## Modelled on {machine.name}\n\nConstants: {machine.source}. Mesh and cycles are those of the runs; stages begin "
        f"together. Of stages above {LEAST:.0%} of a step the largest error is {worst:.0%}."
    )
    text = "\n\n".join([page(measured, study.name), about, as_markdown(rows)])
    print(*write(measured, text, folder), sep="\n")


def progress() -> Callable[[str], None]:
    """What says how far a long command is: on stderr, on one line where that is a terminal, else every ten seconds."""
    latest = [0.0]

    def say(text: str) -> None:
        terminal, now = sys.stderr.isatty(), time.monotonic()
        if terminal:
            print(f"\r{text:<79}" + ("" if text else "\r"), end="", file=sys.stderr, flush=True)
        elif text and now - latest[0] > 10:
            latest[0] = now
            print(text, file=sys.stderr, flush=True)

    return say

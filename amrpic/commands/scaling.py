"""amrpic scaling: how a scene's steps speed up with ranks, measured on those there are."""

from __future__ import annotations

import argparse

from ..errors import InputError
from ..scaling.measure import CLOCKS
from ..scaling.measured import by_kind, medians
from ..scaling.show import page, stage_table, table, write
from ..scaling.study import KINDS, LAUNCHER, Study
from ..tables import columns
from .arguments import Commands, command, count, scene_arguments, scene_of


def add(commands: Commands) -> None:
    """Add the command to the parser."""
    scaling = command(
        commands,
        "scaling",
        _scaling,
        "measure how steps of a scene speed up with ranks",
        "measuring",
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
        help="let all ranks begin each stage of a step together, so that the time they wait for each other is shown by itself",
    )
    scaling.add_argument("--output", metavar="DIR", help="where to write; default runs/<scene>")


def _scaling(chosen: argparse.Namespace) -> int:
    folder = scene_of(chosen).directory
    kinds = KINDS if chosen.kind is None else (chosen.kind,)
    study = Study(
        chosen.scene, folder, chosen.set, chosen.ranks, kinds, chosen.steps, chosen.launcher, chosen.clock, chosen.apart
    )
    if chosen.sbatch is not None:
        for path in study.write_jobs(chosen.sbatch, chosen.repeat):
            print(f"sbatch {path}")
        return 0
    if not chosen.collect:
        for run in study.start(chosen.repeat):
            print(f"{run.kind}, {run.ranks} ranks: {sorted(run.seconds)[len(run.seconds) // 2]:.4g} s/step", flush=True)
    measured = medians(study.runs())
    if not measured:
        raise InputError(
            f"{study.folder} holds no run of {study.name}; start some without --collect, or give --set, --clock and --apart as "
            "they were started with"
        )
    print(*columns(table(measured)), sep="\n")
    for runs in by_kind(measured).values():
        print(f"\n{runs[-1].kind}, {runs[-1].ranks} ranks", *columns(stage_table(runs[-1])), sep="\n")
    print(*write(measured, page(measured, study.name), folder), sep="\n")
    return 0

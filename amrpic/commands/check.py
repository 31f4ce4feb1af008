"""amrpic check: whether a scene can run, or whether what a run wrote is whole."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

from ..errors import InputError
from ..failure import BAD_INPUT
from ..io import integrity
from ..mpi import MPI
from ..parallel import from_rank_0
from ..scene.complaints import RefusedScene
from .arguments import Commands, command, count, scene_arguments, scene_of
from .methods import method_of


def add(commands: Commands) -> None:
    """Add the command to the parser."""
    purpose = "check whether a scene can run, without running it, or whether what a run wrote is whole"
    check = command(commands, "check", _check, purpose, "checking")
    scene_arguments(check, "a scene file in TOML, a file or checkpoint that a run wrote, or the folder of a run")
    check.add_argument("--ranks", type=count, default=1, metavar="N", help="number of ranks it is meant for")
    check.add_argument("--resolved", action="store_true", help="print the scene with all defaults filled in, as TOML")


def _check(chosen: argparse.Namespace) -> int:
    """Return the exit status of a check, which rank 0 does alone. Collective."""
    path = Path(chosen.scene)
    summary = from_rank_0(
        MPI.COMM_WORLD, lambda: _of_output(path) if integrity.is_output(path) else _of_scene(chosen), InputError
    )
    if MPI.COMM_WORLD.rank == 0:
        for stream, lines in ((sys.stdout, summary.lines), (sys.stderr, summary.notes)):
            print(*lines, sep="\n", end="\n" if lines else "", file=stream)
    return summary.status


class Found(NamedTuple):
    """What a check found: the exit status, and lines for standard output and standard error."""

    status: int
    lines: Sequence[str] = ()
    notes: Sequence[str] = ()


def _of_output(path: Path) -> Found:
    try:
        number = integrity.require_whole(path)
    except InputError as damaged:
        return Found(BAD_INPUT, notes=[str(damaged)])
    return Found(0, [f"{path} is whole" + (f": {number} files and checkpoints" if number > 1 else "")])


def _of_scene(chosen: argparse.Namespace) -> Found:
    try:
        scene = scene_of(chosen)
    except RefusedScene as refused:
        return Found(BAD_INPUT, notes=refused.problems)
    metal = method_of(scene).check(scene, chosen.ranks)
    lines = [scene.to_toml()] if chosen.resolved else [scene.summary(), *metal]
    return Found(0, lines, [f"note: {remark}" for remark in scene.remarks()])

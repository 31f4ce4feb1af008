"""amrpic check: whether a scene can run, or whether what a run wrote is whole."""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

from mpi4py import MPI

from ..errors import InputError
from ..failure import BAD_INPUT
from ..io import integrity
from ..parallel import from_rank_0
from ..run.limits import check_scene
from ..scene.complaints import RefusedScene
from .arguments import Commands, command, count, scene_arguments, scene_of


def add(commands: Commands) -> None:
    """Add the command to the parser."""
    what = "check whether a scene can run, without running it, or whether what a run wrote is whole"
    check = command(commands, "check", _check, what)
    scene_arguments(check, "a scene file in TOML, a file or checkpoint that a run wrote, or the folder of a run")
    check.add_argument("--ranks", type=count, default=1, metavar="N", help="number of ranks it is meant for")
    check.add_argument("--resolved", action="store_true", help="print the scene with all defaults filled in, as TOML")


def _check(chosen: argparse.Namespace) -> int:
    """Return the exit status of a check, which rank 0 does alone. Collective."""
    path = Path(chosen.scene)
    return from_rank_0(
        MPI.COMM_WORLD, lambda: _check_output(path) if integrity.is_output(path) else _check_scene(chosen), InputError
    )


def _check_output(path: Path) -> int:
    try:
        number = integrity.require_whole(path)
    except InputError as damaged:
        print(damaged, file=sys.stderr)
        return BAD_INPUT
    print(f"{path} is whole" + (f": {number} files and checkpoints" if number > 1 else ""))
    return 0


def _check_scene(chosen: argparse.Namespace) -> int:
    try:
        scene = scene_of(chosen)
    except RefusedScene as refused:
        print("\n".join(refused.problems), file=sys.stderr)
        return BAD_INPUT
    check_scene(scene, chosen.ranks)
    print(scene.to_toml() if chosen.resolved else scene.summary())
    for remark in scene.remarks():
        print(f"note: {remark}", file=sys.stderr)
    return 0

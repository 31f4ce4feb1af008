"""amrpic check: whether a scene can run."""

from __future__ import annotations

import argparse
import sys

from ..failure import BAD_INPUT
from ..run.limits import check_scene
from ..scene.complaints import RefusedScene
from .arguments import Commands, command, count, scene_arguments, scene_of


def add(commands: Commands) -> None:
    """Add the command to the parser."""
    check = command(commands, "check", _check, "check whether a scene can run, without running it")
    scene_arguments(check)
    check.add_argument("--ranks", type=count, default=1, metavar="N", help="number of ranks it is meant for")
    check.add_argument("--resolved", action="store_true", help="print the scene with all defaults filled in, as TOML")


def _check(chosen: argparse.Namespace) -> int:
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

"""The examples that tests go through."""

from __future__ import annotations

from pathlib import Path

import amrpic
from amrpic.commands.methods import scene_from
from amrpic.scene.any_scene import read_data

EXAMPLES = Path(__file__).parents[2] / "examples"


def with_bunches() -> list[Path]:
    """Return the scenes that are particle-in-cell."""
    paths = sorted(EXAMPLES.glob("*.toml"))
    return [path for path in paths if isinstance(scene_from(read_data(path), path), amrpic.Scene)]

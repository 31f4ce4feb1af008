"""amrpic schema: what a scene may hold, for editors and for people."""

from __future__ import annotations

import argparse
import json
from pathlib import Path

from ..errors import OutputError
from ..scene.json_schema import scene_reference, scene_schema
from .arguments import Commands, command
from .methods import MPM, method_named


def add(commands: Commands) -> None:
    """Add the command to the parser."""
    schema = command(commands, "schema", _schema, "print what a scene may hold, as a JSON schema for editors")
    schema.add_argument("--markdown", action="store_true", help="as a reference for people, in Markdown")
    schema.add_argument("--method", choices=(MPM,), help="of scenes of this method; default particle-in-cell")
    schema.add_argument("--output", metavar="FILE", help="write it into a file")


def _schema(chosen: argparse.Namespace) -> int:
    method = method_named(chosen.method)
    text = (
        scene_reference(method.scene, method.title)
        if chosen.markdown
        else json.dumps(scene_schema(method.scene), indent=2, ensure_ascii=False) + "\n"
    )
    if chosen.output is None:
        print(text, end="")
        return 0
    try:
        Path(chosen.output).write_text(text, encoding="utf-8")
    except OSError as reason:
        raise OutputError(f"cannot write {chosen.output}: {reason.strerror}; choose another --output") from None
    return 0

"""Speed against error: what settings of a scene cost, and how far they are from its exact field, as tables on a page."""

from __future__ import annotations

import re
from collections.abc import Iterable
from pathlib import Path

from .table import Table

OPENING = (
    "# Verification\n\nWritten by `make verify`; `make verify PUBLISH=1` writes it into `docs/reports`, `amrpic verify SCENE "
    "--output FOLDER` the tables of a scene. A goal stands in brackets behind each measured value that has one; a missed goal "
    "is marked and fails the command.\n"
)


def write(tables: Iterable[Table], folder: Path) -> Path:
    """Write `verification.md` and its pictures into a folder; return its path. OSError if that is not possible.

    Tables that the file holds already and that were not measured now stay in it.
    """
    pictures, path = folder / "pictures", folder / "verification.md"
    pictures.mkdir(parents=True, exist_ok=True)
    parts = _parts(path)
    for table in tables:
        part = f"## {table.title}\n\n{table.about}\n\n{table.markdown()}\n"
        if table.picture is not None:
            name = f"verify_{'_'.join(re.findall(r'[a-z0-9]+', table.title.lower()))}.png"
            table.picture(pictures / name)
            part += f"\n![{table.title}: {table.upwards}](pictures/{name})\n"
        parts[table.title] = part
    path.write_text("\n".join([OPENING, *parts.values()]), encoding="utf-8")
    return path


def _parts(path: Path) -> dict[str, str]:
    """The parts of a page by their titles."""
    if not path.exists():
        return {}
    _, *parts = re.split(r"^(?=## )", path.read_text(encoding="utf-8"), flags=re.MULTILINE)
    return {part.splitlines()[0].removeprefix("## "): part.rstrip("\n") + "\n" for part in parts}

"""amrpic scan: a scene for all combinations of some of its values."""

from __future__ import annotations

import argparse
from pathlib import Path

from ..drivers.evaluate import assignments
from ..drivers.scans import PICTURE, SHOWN, TABLE, Row, combinations, drawn, scan, values_of
from ..errors import InputError
from ..mpi import MPI
from ..scene.any_scene import read_data
from ..tables import columns
from .arguments import Commands, command, count
from .methods import scene_from

FAILED = 1  # exit status, if a run has failed


def add(commands: Commands) -> None:
    """Add the command to the parser."""
    added = command(
        commands, "scan", _scan, "run a scene for all combinations of some of its values", "at work on the scan"
    )
    added.add_argument("scene", metavar="SCENE", help="a scene file in TOML")
    added.add_argument(
        "--set",
        action="append",
        default=[],
        metavar="KEY=VALUE,…",
        help="values that a key takes in turn, such as bunches.0.charge=1e-12,2e-12; several if repeated",
    )
    added.add_argument("--output", metavar="DIR", help="folder of the scan; default runs/<scene>_scan")
    added.add_argument("--ranks", type=count, default=1, metavar="N", help="MPI ranks of each run")
    added.add_argument(
        "--show",
        action="append",
        metavar="COLUMN",
        help="of series.csv or beam.csv, in picture and table; several if repeated",
    )


def _scan(chosen: argparse.Namespace) -> int:
    """Return 0 if all runs have ended well. On one rank: it starts those of the runs."""
    if MPI.COMM_WORLD.size > 1:
        raise InputError("amrpic scan starts the ranks of its runs itself; leave mpiexec out, and use --ranks")
    values = _values(chosen)
    folder = Path(chosen.output or f"runs/{Path(chosen.scene).stem}_scan")
    rows: list[Row] = []
    for row in scan(chosen.scene, values, folder, chosen.ranks):
        rows.append(row)
        print(
            ", ".join(f"{key} = {value}" for key, value in row.inputs.items()),
            row.failure or "ended",
            sep=": ",
            flush=True,
        )
    shown = chosen.show or [name for name in SHOWN if any(row.numbers.get(name) for row in rows)]
    columns_of_runs = dict.fromkeys(name for row in rows for name in row.numbers)
    if columns_of_runs and (unknown := [name for name in shown if name not in columns_of_runs]):
        raise InputError(f"--show {unknown[0]}: no run has such a column; choose among {', '.join(columns_of_runs)}")
    head = [*values, *shown]
    print(*columns([head, *([*row.inputs.values(), *(_brief(row, name) for name in shown)] for row in rows)]), sep="\n")
    if columns_of_runs:
        drawn([row for row in rows if row.numbers], shown).savefig(folder / PICTURE, dpi=120)
        print(f"{folder / TABLE} has all numbers, {PICTURE} beside it a picture")
    return FAILED if any(row.failure for row in rows) else 0


def _values(chosen: argparse.Namespace) -> dict[str, list[str]]:
    """Return the values of each key. InputError or SceneError for those that the scene cannot have."""
    values: dict[str, list[str]] = {}
    for key, several in map(values_of, chosen.set):
        if key in values:
            raise InputError(f"--set {key} is given twice; write all its values into one, such as {key}=1,2")
        values[key] = several
    if not values:
        raise InputError("nothing is set; give --set KEY=VALUE,VALUE,… for at least one key")
    for inputs in combinations(values):
        scene_from(read_data(chosen.scene, assignments(inputs)), chosen.scene)
    return values


def _brief(row: Row, name: str) -> str:
    return f"{row.numbers[name]:.6g}" if name in row.numbers else "–"

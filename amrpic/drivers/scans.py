"""A scene run for all combinations of some of its values."""

from __future__ import annotations

import csv
import itertools
import os
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from ..errors import AmrpicError, InputError
from ..io.atomic_files import temporary
from .evaluate import last_of, run

if TYPE_CHECKING:
    from matplotlib.figure import Figure

TABLE, PICTURE = "scan.csv", "scan.png"
SHOWN = ("rms_x", "rms_y", "rms_z", "emittance_x", "emittance_y", "emittance_z", "lost_particles")


@dataclass(frozen=True)
class Row:
    """A run of a scan: what was set, and its numbers, or why it failed."""

    inputs: Mapping[str, str]
    folder: str = ""  # its name in that of the scan
    numbers: Mapping[str, float] = field(default_factory=dict)
    failure: str = ""


def values_of(assignment: str) -> tuple[str, list[str]]:
    """Return key and values of KEY=VALUE,VALUE,…; commas in brackets and quotes separate nothing."""
    key, equals, text = assignment.partition("=")
    values, depth, quote, start = [], 0, "", 0
    for place, letter in enumerate(text):
        if quote:
            quote = "" if letter == quote else quote
        elif letter in "\"'":
            quote = letter
        elif letter in "[{":
            depth += 1
        elif letter in "]}":
            depth -= 1
        elif letter == "," and depth == 0:
            values.append(text[start:place].strip())
            start = place + 1
    values.append(text[start:].strip())
    if not equals or not key.strip() or not all(values):
        raise InputError(f"--set {assignment}: is no list of values; write it as --set bunches.0.charge=1e-12,2e-12")
    return key.strip(), values


def combinations(values: Mapping[str, Sequence[str]]) -> list[dict[str, str]]:
    """Return all combinations of values, the last key's changing fastest."""
    return [dict(zip(values, chosen, strict=True)) for chosen in itertools.product(*values.values())]


def scan(
    scene: str | os.PathLike[str], values: Mapping[str, Sequence[str]], folder: Path, ranks: int = 1
) -> Iterator[Row]:
    """Yield the runs of all combinations of values, each when it has ended; those that had ended before are not repeated.

    After each the table in the folder is written anew.
    """
    rows: list[Row] = []
    for inputs in combinations(values):
        try:
            own = run(inputs, scene, folder, ranks)
            row = Row(inputs, own.name, last_of(own))
        except AmrpicError as failure:
            row = Row(inputs, failure=str(failure))
        rows.append(row)
        write_table(rows, folder / TABLE)
        yield row


def write_table(rows: Sequence[Row], path: Path) -> None:
    """Write what was set, the folder and the numbers of runs, a row each."""
    path.parent.mkdir(parents=True, exist_ok=True)
    names = list(dict.fromkeys(name for row in rows for name in row.numbers))
    with open(temporary(path), "w", encoding="utf-8", newline="") as file:
        table = csv.writer(file)
        table.writerow([*rows[0].inputs, *names, "folder", "failure"])
        for row in rows:
            numbers = [row.numbers.get(name, "") for name in names]
            table.writerow([*row.inputs.values(), *numbers, row.folder, row.failure])
    os.replace(temporary(path), path)


def drawn(rows: Sequence[Row], shown: Sequence[str] = SHOWN) -> Figure:
    """Return a picture: numbers against the value that was set first, a curve for each combination of the others."""
    from matplotlib.figure import Figure  # takes long to import

    key = next(iter(rows[0].inputs))
    names = [name for name in shown if any(row.numbers.get(name) for row in rows)] or list(rows[0].numbers)[:4]
    abscissa, ticks = _abscissa([row.inputs[key] for row in rows])
    figure = Figure(figsize=(8, 0.8 + 2.0 * len(names)), layout="constrained")
    axes = np.atleast_1d(figure.subplots(max(len(names), 1), 1, sharex=True))
    settings = list(dict.fromkeys(tuple(list(row.inputs.items())[1:]) for row in rows))
    for axis, name in zip(axes, names, strict=False):
        for other in settings:
            points = [
                (x, row.numbers.get(name, np.nan))
                for x, row in zip(abscissa, rows, strict=True)
                if tuple(list(row.inputs.items())[1:]) == other
            ]
            axis.plot(*zip(*points, strict=True), "o-", label=", ".join(f"{k} = {v}" for k, v in other))
        axis.set_ylabel(name)
    if any(settings[0]):
        axes[0].legend(fontsize="small")
    axes[-1].set_xlabel(key)
    if ticks:
        axes[-1].set_xticks(range(len(ticks)), ticks)
    return figure


def _abscissa(values: Sequence[Any]) -> tuple[list[float], list[str]]:
    """Return places of values along an axis, and what to write there where they are no numbers."""
    try:
        return [float(value) for value in values], []
    except ValueError:
        ticks = list(dict.fromkeys(map(str, values)))
        return [float(ticks.index(str(value))) for value in values], ticks

"""Is it right? Measured against exact answers, topic by topic, each value beside its goal."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from mpi4py import MPI

from ..errors import InputError
from . import conservation, convergence, hard, openboundary, peers, selfforce, stopping
from .table import Table

if TYPE_CHECKING:
    from matplotlib.axes import Axes

TOPICS: Mapping[str, Callable[[MPI.Comm], Iterator[Table]]] = {
    "convergence": convergence.tables,
    "open-boundary": openboundary.tables,
    "peers": peers.tables,
    "self-force": selfforce.tables,
    "stopping": stopping.tables,
    "conservation": conservation.tables,
    "hard-cases": hard.tables,
}


def verify(comm: MPI.Comm, topics: Sequence[str] = ()) -> Iterator[tuple[str, Table]]:
    """Topic by topic, or those named, each table as it is measured; the same on all ranks. Collective.

    Raises InputError for a topic that does not exist.
    """
    for topic in topics:
        if topic not in TOPICS:
            raise InputError(f'verify knows no topic "{topic}"; use {", ".join(TOPICS)}')
    for topic in topics or TOPICS:
        for table in TOPICS[topic](comm):
            yield topic, table


def write(found: Sequence[tuple[str, Table]], folder: Path) -> Path:
    """Write `verification.md` and its pictures into a folder; return its path. OSError if that is not possible."""
    pictures = folder / "pictures"
    pictures.mkdir(parents=True, exist_ok=True)
    parts = [
        "# Verification\n\nWritten by `amrpic verify --output docs` (`make verify`). A goal stands in brackets behind each "
        "measured value that has one; a missed goal is marked and fails the command.\n"
    ]
    for _, table in found:
        parts.append(f"## {table.title}\n\n{table.about}\n\n{table.markdown()}\n")
        if table.curves:
            name = f"verify_{table.title.lower().replace(' ', '_')}.png"
            draw(table, pictures / name)
            parts.append(f"![{table.title}: {table.upwards}](pictures/{name})\n")
    path = folder / "verification.md"
    path.write_text("\n".join(parts), encoding="utf-8")
    return path


def draw(table: Table, path: Path) -> None:
    """Draw the curves of a table, both axes logarithmic over resolutions, with the slope of second order beside them."""
    import matplotlib

    matplotlib.use("Agg")
    from matplotlib import pyplot

    figure, axes = pyplot.subplots(figsize=(8, 4.5), layout="constrained")
    markers = "os^vD<>phX*"
    for number, (name, (at, values)) in enumerate(table.curves.items()):
        axes.plot(at, values, marker=markers[number % len(markers)], markersize=4, linewidth=1, label=name)
    axes.set_yscale("log")
    if table.across.startswith("base cells"):
        _mark_resolutions(axes, table)
    axes.set(xlabel=table.across, ylabel=table.upwards, title=table.title)
    axes.grid(which="major", alpha=0.3)
    axes.legend(loc="center left", bbox_to_anchor=(1.0, 0.5), frameon=False)
    figure.savefig(path, dpi=110)
    pyplot.close(figure)


def _mark_resolutions(axes: Axes, table: Table) -> None:
    from matplotlib.ticker import NullFormatter

    every = sorted({int(c) for cells, _ in table.curves.values() for c in cells})
    top = max(error[0] for _, error in table.curves.values())
    axes.plot(every, [top * 1.5 * (every[0] / c) ** 2 for c in every], "k--", linewidth=1, label="second order")
    axes.set_xscale("log")
    axes.set_xticks(every, [str(c) for c in every])
    axes.xaxis.set_minor_formatter(NullFormatter())

"""Is it right? Measured against exact answers, topic by topic, each value beside its goal."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path

from mpi4py import MPI

from ..errors import InputError
from . import conservation, convergence, hard, openboundary, peers
from .table import Table

TOPICS: Mapping[str, Callable[[MPI.Comm], Iterator[Table]]] = {
    "convergence": convergence.tables,
    "open-boundary": openboundary.tables,
    "peers": peers.tables,
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
            parts.append(f"![{table.title}: {table.curve}](pictures/{name})\n")
    path = folder / "verification.md"
    path.write_text("\n".join(parts), encoding="utf-8")
    return path


def draw(table: Table, path: Path) -> None:
    """Draw the curves of a table: error over cells per axis, with the slope of second order beside them."""
    import matplotlib

    matplotlib.use("Agg")
    from matplotlib import pyplot
    from matplotlib.ticker import NullFormatter, ScalarFormatter

    figure, axes = pyplot.subplots(figsize=(8, 4.5), layout="constrained")
    markers = "os^vD<>phX*"
    for number, (name, (cells, error)) in enumerate(table.curves.items()):
        axes.loglog(cells, error, marker=markers[number % len(markers)], markersize=5, linewidth=1, label=name)
    every = sorted({int(c) for cells, _ in table.curves.values() for c in cells})
    top = max(error[0] for _, error in table.curves.values())
    axes.loglog(every, [top * 1.5 * (every[0] / c) ** 2 for c in every], "k--", linewidth=1, label="second order")
    axes.set_xticks(every, [str(c) for c in every])
    axes.xaxis.set_major_formatter(ScalarFormatter())
    axes.xaxis.set_minor_formatter(NullFormatter())
    axes.set(xlabel="base cells per axis", ylabel=f"relative error of {table.curve}", title=table.title)
    axes.grid(which="major", alpha=0.3)
    axes.legend(loc="center left", bbox_to_anchor=(1.0, 0.5), frameon=False)
    figure.savefig(path, dpi=110)
    pyplot.close(figure)

"""Pictures of tables."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING

from .table import Table

if TYPE_CHECKING:
    from matplotlib.axes import Axes

MARKERS = "os^vD<>phX*"
STYLES = ("-", "--", ":")


@contextmanager
def picture(path: Path, title: str, across: str, upwards: str) -> Iterator[Axes]:
    """Axes to draw on, with a legend beside them; written as a PNG at the end. OSError if that is not possible."""
    import matplotlib

    matplotlib.use("Agg")
    from matplotlib import pyplot

    figure, axes = pyplot.subplots(figsize=(8, 4.5), layout="constrained")
    yield axes
    axes.set(xlabel=across, ylabel=upwards, title=title)
    axes.grid(which="major", alpha=0.3)
    axes.legend(loc="center left", bbox_to_anchor=(1.0, 0.5), frameon=False)
    lines = len(axes.get_legend_handles_labels()[1])
    figure.set_size_inches(8, max(4.5, 0.23 * lines))  # room for all lines of the legend
    figure.savefig(path, dpi=110)
    pyplot.close(figure)


def draw_curves(table: Table, path: Path) -> None:
    """Draw the curves of a table; those over resolutions with both axes logarithmic and the slope of second order.

    Colours distinguish them; with `by_line`, the kind of line shows what follows the last comma of a name.
    """
    parts = {name: _parts(name) if table.by_line else (name, "") for name in table.curves}
    kinds, lines = (list(dict.fromkeys(part)) for part in zip(*parts.values(), strict=True))
    with picture(path, table.title, table.across, table.upwards) as axes:
        for name, (at, values) in table.curves.items():
            kind, line = (options.index(part) for options, part in zip((kinds, lines), parts[name], strict=True))
            axes.plot(
                at,
                values,
                color=f"C{kind}",
                marker=MARKERS[kind % len(MARKERS)],
                linestyle=STYLES[line % len(STYLES)],
                markersize=4,
                linewidth=1,
                label=name,
            )
        axes.set_yscale("log")
        if table.across in ("base cells per axis", "steps", "steps a turn"):
            _mark_resolutions(axes, table)


def _parts(name: str) -> tuple[str, str]:
    kind, _, line = name.rpartition(", ")
    return (kind, line) if kind else (line, "")


def _mark_resolutions(axes: Axes, table: Table) -> None:
    from matplotlib.ticker import NullFormatter

    every = sorted({int(c) for cells, _ in table.curves.values() for c in cells})
    top = max(error[0] for _, error in table.curves.values())
    axes.plot(every, [top * 1.5 * (every[0] / c) ** 2 for c in every], "k--", linewidth=1, label="second order")
    axes.set_xscale("log")
    axes.set_xticks(every, [str(c) for c in every])
    axes.xaxis.set_minor_formatter(NullFormatter())

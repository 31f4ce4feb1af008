"""Tables that are drawn: a line for each name."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

from amrpic.verify.table import MARKERS, Table, picture

if TYPE_CHECKING:
    from matplotlib.axes import Axes

STYLES = ("-", "--", ":")


@dataclass(frozen=True)
class Curves(Table):
    """A table beside a picture of curves: names, and where each has which values."""

    curves: Mapping[str, tuple[Sequence[float], Sequence[float]]] = field(default_factory=dict)
    across: str = "base cells per axis"  # what the curves are drawn over
    by_line: bool = False  # the kind of line shows what follows the last comma of a name

    def __post_init__(self) -> None:
        object.__setattr__(self, "picture", partial(_draw, self))


def _draw(table: Curves, path: Path) -> None:
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


def _mark_resolutions(axes: Axes, table: Curves) -> None:
    from matplotlib.ticker import NullFormatter

    every = sorted({int(c) for cells, _ in table.curves.values() for c in cells})
    top = max(error[0] for _, error in table.curves.values())
    axes.plot(every, [top * 1.5 * (every[0] / c) ** 2 for c in every], "k--", linewidth=1, label="second order")
    axes.set_xscale("log")
    axes.set_xticks(every, [str(c) for c in every])
    axes.xaxis.set_minor_formatter(NullFormatter())

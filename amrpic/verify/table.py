"""What a topic of the verification shows: tables whose cells know their goals, and pictures beside them."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from matplotlib.axes import Axes


@dataclass(frozen=True)
class Goal:
    """A measured value and the bound that it must keep."""

    measured: float
    bound: float
    least: bool = False  # the bound is the least value, otherwise the largest one

    @property
    def met(self) -> bool:
        return self.measured >= self.bound if self.least else self.measured <= self.bound  # a nan meets nothing

    def __str__(self) -> str:
        mark = "" if self.met else " MISSED"
        return f"{number(self.measured)} ({'≥' if self.least else '≤'} {number(self.bound)}){mark}"


Cell = str | float | Goal


@dataclass(frozen=True)
class Table:
    """Measured values under a title, a row per case."""

    title: str
    about: str  # what is measured and where the goals come from, a sentence or two
    columns: Sequence[str]
    rows: Sequence[Sequence[Cell]]
    upwards: str = ""  # what its picture shows
    picture: Callable[[Path], None] | None = None  # writes it

    def goals(self) -> Iterator[Goal]:
        return (cell for row in self.rows for cell in row if isinstance(cell, Goal))

    @property
    def met(self) -> bool:
        return all(goal.met for goal in self.goals())

    def markdown(self) -> str:
        """The table as GitHub shows it, its columns aligned for readers of the plain text too."""
        body = [[text(cell) for cell in row] for row in self.rows]
        widths = [max(len(row[c]) for row in [list(self.columns), *body]) for c in range(len(self.columns))]

        def line(cells: Sequence[str]) -> str:
            return "| " + " | ".join(cell.ljust(width) for cell, width in zip(cells, widths, strict=True)) + " |"

        rule = "|" + "|".join("-" * (width + 2) for width in widths) + "|"
        return "\n".join([line(self.columns), rule, *map(line, body)])


def number(value: float) -> str:
    """Three digits; whole numbers and orders as people write them."""
    if value == int(value) and abs(value) < 1e6 if value == value and abs(value) != float("inf") else False:
        return str(int(value))
    return f"{value:.2f}" if 0.1 <= abs(value) < 100 else f"{value:.1e}"


def text(cell: Cell) -> str:
    return number(cell) if isinstance(cell, (int, float)) else str(cell)


MARKERS = "os^vD<>phX*"


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

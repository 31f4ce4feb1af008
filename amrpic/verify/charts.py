"""Pictures beside tables."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from matplotlib.axes import Axes

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

"""Tables and pictures of what was measured."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING

from ..errors import OutputError
from .measured import END, Measured, by_kind, efficiency

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

MIB = 2**20


def table(runs: Sequence[Measured]) -> list[list[str]]:
    """Return a row per kind and number of ranks, under a head: each kind against its fewest ranks."""
    rows = []
    for kind, all_ in by_kind(runs).items():
        first = all_[0]
        for run in all_:
            rows.append(
                {
                    "": kind,
                    "ranks": f"{run.ranks}",
                    "cells": f"{run.cells}",
                    "particles": f"{run.particles}",
                    "cycles": f"{run.cycles:g}",
                    "ms per step": f"{1000.0 * run.seconds:.4g}",
                    "faster": f"{first.seconds / run.seconds:.2f}",
                    "efficiency": f"{efficiency(first, run):.0%}",
                    "of solve": f"{efficiency(first, run, 'solve'):.0%}" if "solve" in run.stages else "-",
                    "cells max/mean": f"{run.cell_imbalance:.2f}",
                    "particles max/mean": f"{run.particle_imbalance:.2f}",
                    "MiB per rank": f"{run.memory[2] / MIB:.0f}",
                    "steps": f"{run.steps}",
                }
            )
    return [list(rows[0]), *(list(row.values()) for row in rows)]


def stage_table(run: Measured) -> list[list[str]]:
    """Return what each stage of a step takes and sends: a row per stage, under a head."""
    rows = [["stage of a step", "ms least", "mean", "most", "messages", "kB", "collectives"]]
    for name, stage in run.stages.items():
        times = [f"{1e3 * seconds:.3g}" for seconds in (stage.least, stage.mean, stage.most)]
        label = "at the end of the run" if name == END else name
        rows.append([label, *times, f"{stage.messages:.0f}", f"{stage.bytes / 1e3:.0f}", f"{stage.collectives:.0f}"])
    return rows


def as_markdown(rows: Sequence[Sequence[str]]) -> str:
    """Return a table whose first row is its head."""
    head, *body = rows
    return "\n".join(["| " + " | ".join(row) + " |" for row in (head, ["---:"] * len(head), *body)])


def page(measured: Sequence[Measured], name: str) -> str:
    """Return what was measured of a scene as Markdown."""
    parts = [f"# Scaling: {name}", "![Time and efficiency over ranks](scaling.png)", as_markdown(table(measured))]
    for runs in by_kind(measured).values():
        for run in runs:
            parts += [f"## {run.kind}, {run.ranks} ranks", as_markdown(stage_table(run))]
    return "\n\n".join(parts)


def write(runs: Sequence[Measured], text: str, folder: Path) -> list[Path]:
    """Write scaling.md, which holds the text, scaling.json and scaling.png into a folder; return their paths.

    Raises OutputError.
    """
    paths = [folder / f"scaling.{kind}" for kind in ("md", "json", "png")]
    try:
        folder.mkdir(parents=True, exist_ok=True)
        paths[0].write_text(text + "\n", encoding="utf-8")
        paths[1].write_text(json.dumps([asdict(run) for run in runs], indent=1), encoding="utf-8")
        draw(runs).savefig(paths[2], dpi=110)
    except OSError as reason:
        raise OutputError(f"cannot write into {folder}: {reason.strerror}; choose another --output") from None
    return paths


def draw(runs: Sequence[Measured]) -> Figure:
    """Return the efficiency over ranks, and for each kind the time of a step by stage with the ideal line."""
    from matplotlib.figure import Figure

    kinds = by_kind(runs)
    figure = Figure(figsize=(4.4 * (1 + len(kinds)), 3.8), layout="constrained")
    left, *panels = figure.subplots(1, 1 + len(kinds))
    for kind, all_ in kinds.items():
        ranks = [run.ranks for run in all_]
        left.plot(ranks, [efficiency(all_[0], run) for run in all_], "o-", label=kind)
    left.axhline(1, color="black", linewidth=0.8, linestyle="--")
    left.set(xlabel="ranks", ylabel="efficiency of a step", ylim=(0, None))
    over_ranks(left, sorted({run.ranks for run in runs}))
    left.legend(frameon=False)
    for panel, (kind, all_) in zip(panels, kinds.items(), strict=True):
        times = {"step": [1e3 * run.seconds for run in all_]}
        for name in dict.fromkeys(name for run in all_ for name in run.stages if name != END):
            times[name] = [1e3 * run.stages[name].most if name in run.stages else 0.0 for run in all_]
        draw_times(panel, [run.ranks for run in all_], times, [run.work for run in all_])
        panel.set(title=kind, ylabel="ms per step, slowest rank")
    panels[-1].legend(fontsize=8, frameon=False, loc="center left", bbox_to_anchor=(1, 0.5))
    return figure


def draw_times(panel: Axes, ranks: Sequence[int], times: dict[str, list[float]], work: Sequence[float]) -> None:
    """Draw times by stage over ranks; that of the first entry, the step, with the ideal line, in proportion to the work of a
    rank."""
    for number, (name, values) in enumerate(times.items()):
        heavy = {"color": "black", "linewidth": 2.0} if number == 0 else {"linewidth": 1.2}
        panel.plot(ranks, [value or float("nan") for value in values], "o-", markersize=4, label=name, **heavy)
    first = next(iter(times.values()))[0]
    panel.plot(ranks, [first * factor / work[0] for factor in work], "k--", linewidth=0.8, label="ideal")
    panel.set(
        yscale="log", ylim=(max(first * 1e-4, min(v for all_ in times.values() for v in all_ if v > 0) / 2), None)
    )
    over_ranks(panel, ranks)


def over_ranks(panel: Axes, ranks: Sequence[int]) -> None:
    """Give a panel an axis of numbers of ranks."""
    panel.set(xlabel="ranks", xscale="log")
    panel.set_xticks(list(ranks), [f"{n:,}" for n in ranks])
    panel.minorticks_off()

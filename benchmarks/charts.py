"""Pictures of what was measured."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path

import matplotlib
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import NullFormatter

from cases import FAMILIES
from goals import Goal, goals
from growth import Law, laws
from measuring import Record
from measuring import figure as figure_of
from peers import peer_name
from reference import MLMG
from reference import PARTICLES as REFERENCE_PARTICLES
from solving import BOXES, name

OURS, OTHERS, REFERENCE, GOOD, BAD = "#1f5fa8", "#b0b7c0", "#d98c2b", "#2e8b57", "#c0392b"
LEAST_SHOWN = 0.05  # of a goal; bars that end below it are off the chart
STAGES = matplotlib.colormaps["tab20"]


def draw(records: Sequence[Record], folder: Path, prefix: str = "") -> list[Path]:
    """Draw every chart that the records allow into a folder; return the files."""
    folder.mkdir(parents=True, exist_ok=True)
    out = []
    for title, chart in CHARTS.items():
        figure = chart({record.name: record for record in records})
        if figure is not None:
            out.append(folder / f"{prefix}{title}.png")
            figure.savefig(out[-1], dpi=110)
    return out


def standing(known: Mapping[str, Record]) -> Figure | None:
    """Return how each figure stands to its goal: bars to what was measured, over what must be."""
    reached = [goal for goal in goals(list(known.values())) if goal.must > 0 and not math.isnan(goal.measured)]
    measured = [goal for goal in reached if relative(goal, goal.measured) > LEAST_SHOWN]
    if not measured:
        return None
    figure = Figure(figsize=(9, 0.6 + 0.28 * len(measured)), layout="constrained")
    panel = figure.add_subplot()
    for row, goal in enumerate(reversed(measured)):
        color = BAD if goal.verdict == "missed" else GOOD
        panel.barh(row, relative(goal, goal.measured), color=color, height=0.62)
        value = f"{figure_of(goal.measured)}{goal.unit}"
        panel.annotate(value, (1.01, row), xycoords=("axes fraction", "data"), va="center", fontsize=8)
        if goal.aim is not None:
            panel.plot([relative(goal, goal.aim)] * 2, [row - 0.42, row + 0.42], color="black", linewidth=1.6)
    panel.axvline(1, color="black", linewidth=1, linestyle="--")
    panel.set_yticks(range(len(measured)), [goal.what for goal in reversed(measured)], fontsize=8)
    panel.set_xscale("log")
    panel.set_xlabel("time or amount over what it must be at most (dashed)\nblack ticks: aims")
    panel.margins(y=0.01)
    panel.set_xlim(left=LEAST_SHOWN)
    return figure


def relative(goal: Goal, value: float) -> float:
    """A value over its bound, so that less is better."""
    return goal.must / value if goal.at_least else value / goal.must


def solver(known: Mapping[str, Record]) -> Figure | None:
    """Return the work units of solves to 1e-10 by case and box size, with AMReX's beside them."""
    shown = [f"{family} {n}" for family in FAMILIES for n in (64, 128) if name(f"{family} {n}", 32, 1) in known]
    if not shown:
        return None
    figure = Figure(figsize=(9, 4), layout="constrained")
    panel = figure.add_subplot()
    sizes = [boxes for boxes in BOXES if any(name(case, boxes, 1) in known for case in shown)]
    width = 0.8 / len(sizes)
    for at, boxes in enumerate(sizes):
        places = np.arange(len(shown)) + (at - (len(sizes) - 1) / 2) * width
        records = [known.get(name(case, boxes, 1)) for case in shown]
        heights = [math.nan if record is None else record.units for record in records]
        panel.bar(
            places, heights, width * 0.92, color=OURS, alpha=0.4 + 0.6 * at / len(sizes), label=f"boxes of {boxes}"
        )
        peers = [MLMG.get((case, boxes), math.nan) for case in shown]
        label = "AMReX MLMG, same boxes" if boxes == 24 else "_"
        panel.hlines(peers, places - width / 2, places + width / 2, color=REFERENCE, linewidth=3, label=label)
    panel.set_xticks(range(len(shown)), shown)
    panel.set_ylabel("work units to 1e-10, one rank")
    panel.legend(fontsize=8, ncols=5, loc="upper center", bbox_to_anchor=(0.5, 1.13), frameon=False)
    return figure


def uniform(known: Mapping[str, Record]) -> Figure | None:
    """Return the time of all solvers on a uniform mesh."""
    n = max((n for n in (16, 32, 64, 128) if peer_name(n, "amrpic") in known), default=0)
    if n == 0:
        return None
    beginning = peer_name(n, "")
    mine = [r for r in known.values() if r.name.startswith(beginning) and not r.name.endswith("set-up")]
    bars = {r.name.removeprefix(beginning): (r.median, OURS if r.name.endswith("amrpic") else OTHERS) for r in mine}
    unit = known[peer_name(n, "amrpic")].unit
    if (reference := MLMG.get((f"uniform {n}", 64))) is not None:
        bars["AMReX MLMG (scaled)"] = (reference * unit, REFERENCE)
    setups = {who: r.median for who in bars if (r := known.get(f"{beginning}{who}, set-up")) is not None}
    ordered = sorted(bars, key=lambda who: -bars[who][0])
    figure = Figure(figsize=(8, 0.8 + 0.36 * len(bars)), layout="constrained")
    panel = figure.add_subplot()
    panel.barh(ordered, [bars[who][0] for who in ordered], color=[bars[who][1] for who in ordered])
    panel.plot(
        [setups.get(who, math.nan) for who in ordered], ordered, "|", color="black", markersize=12, label="set-up"
    )
    for row, who in enumerate(ordered):
        panel.annotate(f" {bars[who][0]:.3g} s", (bars[who][0], row), va="center", fontsize=8)
    panel.set_xscale("log")
    panel.margins(x=0.12)
    panel.set_xlabel(f"seconds, uniform {n}³ to 1e-10")
    panel.legend(fontsize=8, frameon=False)
    return figure


def stages(known: Mapping[str, Record]) -> Figure | None:
    """Return where the time of solves and of whole steps goes."""
    wanted = [name(case, 32, 1) for case in ("uniform 128", "static 64", "static 128", "bunch 64", "bunch 128")]
    shown = [known[one] for one in wanted if one in known]
    shown += [r for r in known.values() if r.keys[:2] == ("step", "amrpic")]
    shown = [record for record in shown if record.facts.get("stages")]
    if not shown:
        return None
    kinds = list(dict.fromkeys(stage for record in shown for stage in record.facts["stages"]))
    figure = Figure(figsize=(9, 1.2 + 0.42 * len(shown)), layout="constrained")
    panel = figure.add_subplot()
    labels = [record.name.replace("solve, ", "").replace(", 1e-10", "").replace(", 1 rank", "") for record in shown]
    left = np.zeros(len(shown))
    for at, stage in enumerate(kinds):
        parts = np.array([record.facts["stages"].get(stage, 0.0) / whole(record) for record in shown])
        panel.barh(labels, parts, left=left, label=stage, color=STAGES(at % 20), height=0.7)
        left += parts
    panel.invert_yaxis()
    panel.set_xlabel("share of the time")
    panel.set_xlim(0, 1.02 * max(1.0, float(left.max())))
    panel.legend(fontsize=7, ncols=1, loc="center left", bbox_to_anchor=(1.0, 0.5), frameon=False)
    return figure


def whole(record: Record) -> float:
    """Return the seconds that stages are a share of: the median, unless the stages, of another run, are longer."""
    return max(record.median, sum(record.facts["stages"].values()))


def growth(known: Mapping[str, Record]) -> Figure | None:
    """Return what was measured while one thing grows, with the power laws through it."""
    found = laws(list(known.values()))
    if not found:
        return None
    kinds = list(dict.fromkeys(one.of for one in found))
    figure = Figure(figsize=(3.2 * len(kinds), 3.4), layout="constrained")
    for panel, of in zip(np.ravel(figure.subplots(1, len(kinds), squeeze=False)), kinds, strict=True):
        for at, one in enumerate(one for one in found if one.of == of):
            draw_law(panel, one, f"C{at}")
        finish(panel, [one for one in found if one.of == of])
        panel.set_xlabel(of)
        panel.set_ylabel("seconds")
        panel.legend(fontsize=7, frameon=False)
    return figure


def draw_law(panel: Axes, one: Law, colour: str) -> None:
    sizes = np.geomspace(one.sizes[0], one.sizes[-1], 50)
    panel.loglog(one.sizes, one.seconds, "o", color=colour, markersize=4)
    panel.loglog(sizes, one.at(sizes), color=colour, linewidth=1, label=f"{one.what}: exponent {one.exponent:.2f}")


def finish(panel: Axes, shown: Sequence[Law]) -> None:
    """Give small ranges an axis of at least a decade, and few sizes ticks of their own."""
    seconds = [value for one in shown for value in one.seconds]
    middle = math.sqrt(min(seconds) * max(seconds))
    panel.set_ylim(min(min(seconds) / 1.5, middle / 4), max(max(seconds) * 2.5, middle * 4))
    panel.xaxis.set_minor_formatter(NullFormatter())
    panel.yaxis.set_minor_formatter(NullFormatter())
    if max(shown[0].sizes) / min(shown[0].sizes) < 10:
        panel.set_xticks(shown[0].sizes, [figure_of(size) for size in shown[0].sizes])


def particles(known: Mapping[str, Record]) -> Figure | None:
    """Return ns per particle of each stage, by shape and number of particles, with AMReX's figures."""
    mine = [record for record in known.values() if record.keys[0] == "particles"]
    if not mine:
        return None
    groups = list(dict.fromkeys(", ".join(record.keys[2:]) for record in mine))
    kinds = list(dict.fromkeys(record.keys[1] for record in mine))
    figure = Figure(figsize=(9, 3.6), layout="constrained")
    panel = figure.add_subplot()
    width = 0.8 / len(groups)
    for at, group in enumerate(groups):
        records = [known.get(f"particles, {stage}, {group}") for stage in kinds]
        heights = [1e9 * r.median / r.particles if r is not None else math.nan for r in records]
        panel.bar(np.arange(len(kinds)) + (at - (len(groups) - 1) / 2) * width, heights, width * 0.92, label=group)
    reference = [REFERENCE_PARTICLES.get(stage, math.nan) for stage in kinds]
    middles = np.arange(len(kinds))
    label = "AMReX, 1e+07, cloud-in-cell"
    panel.hlines(reference, middles - 0.42, middles + 0.42, color=REFERENCE, linewidth=2.5, label=label)
    panel.set_xticks(range(len(kinds)), kinds)
    panel.set_ylabel("ns per particle, one core")
    panel.legend(fontsize=8, frameon=False)
    return figure


Chart = Callable[[Mapping[str, Record]], Figure | None]
CHARTS: dict[str, Chart] = {
    "goals": standing,
    "solver": solver,
    "uniform": uniform,
    "stages": stages,
    "growth": growth,
    "particles": particles,
}

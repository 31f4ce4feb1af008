"""Plans as tables and pictures."""

from __future__ import annotations

import json
import os
import resource
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import asdict, replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from amrpic.errors import OutputError
from amrpic.scaling.show import MIB, as_markdown, draw_times, over_ranks

from .machine import Machine
from .model import NETWORK, OF_CELLS, STAGES, Amounts, efficiency, sensitivity, step_time, total
from .plan import Plan, Planner
from .targets import GIB, Targets
from .virtual_ranks import CALLS

if TYPE_CHECKING:
    from matplotlib.figure import Figure

Rows = list[list[str]]
BOUNDED = "deposit", "gather"  # calls whose messages go to ranks that own cells nearby


def write_plans(
    planner: Planner,
    plans: Sequence[Plan],
    machines: Sequence[Machine],
    cycles: float,
    folder: Path,
    page: Path | None = None,
    targets: Targets | None = None,
    command: str = "",
) -> tuple[str, list[Path]]:
    """Write the page, plan.md by default, with plan.json and a picture for each machine into a folder; return text and paths.

    `command` is what made them. Raises OutputError; InputError for targets of a machine that is not among these.
    """
    page = folder / "plan.md" if page is None else page
    pictures = {machine.name: folder / f"plan_{machine.name}.png" for machine in machines}
    text = markdown(planner, plans, machines, cycles, targets, command, _links(pictures, page.parent))
    values = folder / "plan.json"
    try:
        for one in (folder, page.parent):
            one.mkdir(parents=True, exist_ok=True)
        page.write_text(text + "\n", encoding="utf-8")
        values.write_text(json.dumps([_values(plan, machines, cycles) for plan in plans], indent=1), encoding="utf-8")
        for machine in machines:
            draw(plans, machine, cycles).savefig(pictures[machine.name], dpi=110)
    except OSError as reason:
        raise OutputError(f"cannot write into {folder}: {reason.strerror}; choose another --output") from None
    return text, [page, values, *pictures.values()]


def _links(pictures: Mapping[str, Path], folder: Path) -> dict[str, str]:
    """Return the paths of pictures as a page in a folder names them."""
    return {name: Path(os.path.relpath(path, folder)).as_posix() for name, path in pictures.items()}


def markdown(
    planner: Planner,
    plans: Sequence[Plan],
    machines: Sequence[Machine],
    cycles: float,
    targets: Targets | None = None,
    command: str = "",
    pictures: Mapping[str, str] | None = None,
) -> str:
    """Return all that is said of plans as Markdown: what was asked for beside what was found, and all tables."""
    mesh, first = planner.mesh, plans[0]
    levels = ", ".join(f"{len(mesh.boxes(l)):,} boxes of {mesh.cells(l):,} cells" for l in range(mesh.levels))
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * 1024.0
    made = f"Made by `{command}`" if command else "Made"
    parts = [
        f"# Scaling: plan of {planner.scene.name}",
        f"{made} in one process: {planner.seconds:.0f} s of the processor for mesh and bricks, "
        f"{_span([plan.seconds for plan in plans])} s for each number of ranks, {peak / GIB:.2g} GiB at its fullest. "
        "Boxes, owners, servers of particles, messages and memory are those of the code on ranks that need not exist; times "
        "are modelled.",
        f"Levels: {levels}; {planner.scene.particle_count():,} particles.",
        *(f"Note: {note}." for note in planner.notes),
        *([] if targets is None else [_asked(targets.beside(plans, machines, cycles, peak, planner.seconds))]),
        *(where(plan, machine, cycles) for machine in machines for plan in (first, *plans[1:][-1:])),
        *(f"![Modelled on {name}]({path})" for name, path in (pictures or {}).items()),
        *("## " + title + "\n\n" + as_markdown(rows) for title, rows in _held(plans)),
        _looked_at(plans),
    ]
    for machine in machines:
        parts += [
            f"## Modelled on {machine.name}, {cycles:g} cycles per solve",
            f"{machine.source}. {_of_estimates(first)}",
            as_markdown(_times(plans, machine, cycles)),
            "What each choice costs if it is switched off alone, ms per step:",
            as_markdown(_choices(plans, machine, cycles)),
            "Step with each constant halved and doubled, ms:",
            as_markdown(_sensitivity(plans, machine, cycles)),
        ]
    return "\n\n".join(parts)


def _of_estimates(plan: Plan) -> str:
    """Return how often a cycle more finds the error of the mesh."""
    return (
        f"In one of {1 / plan.estimates:g} solves a cycle more finds the error of the mesh." if plan.estimates else ""
    )


def _asked(rows: Iterable[tuple[str, str, bool]]) -> str:
    return as_markdown(
        [["target", "found", ""], *([what, found, "met" if met else "missed"] for what, found, met in rows)]
    )


def where(plan: Plan, machine: Machine, cycles: float) -> str:
    """Return a sentence on what the time of a step goes into."""
    times = step_time(plan, machine, cycles)
    longest = sorted(times.items(), key=lambda one: -one[1].total)[:3]
    parts = [
        f"{name} {_ms(time.total)} (work {_ms(time.work)}, messages {_ms(time.messages)}, collectives {_ms(time.collectives)})"
        for name, time in longest
    ]
    busiest = max(CALLS, key=lambda call: plan.most(call, "messages"))
    return (
        f"On {plan.ranks:,} ranks of {machine.name} a step of {_ms(total(times))} ms goes mostly into {'; '.join(parts)}. "
        f"The call of most messages is {busiest}: {plan.most(busiest, 'messages'):,.0f} from one rank."
    )


def _ms(seconds: float) -> str:
    return f"{1e3 * seconds:.3g}"


def _span(values: Sequence[float]) -> str:
    low, high = f"{min(values):.0f}", f"{max(values):.0f}"
    return low if low == high else f"{low} to {high}"


def _looked_at(plans: Sequence[Plan]) -> str:
    """Return which ranks' messages are counted, and how many others may send."""
    rows: Rows = [["ranks", "open walls", "all calls", *(f"{call}: most / of others" for call in BOUNDED)]]
    for plan in plans:
        bounds = [f"{plan.most(call, 'messages'):.0f} / {plan.at_most(call):.0f}" for call in BOUNDED]
        numbers = (plan.ranks, len(plan.walls), len(plan.looked_at))
        rows.append([*(f"{number:,}" for number in numbers), *bounds])
    return (
        "Cells, particles and memory are those of all ranks, and cycles are gone through for all; of particles that move, "
        "those that leave each node are counted. Open walls are gone through for all ranks or for many at even distances; "
        "all calls for the busiest ranks, for those with most of what they hold, for some at even distances and for busy "
        "nodes. How many that is, and what other ranks send at most if none sends more for each rank that it meets than the "
        "worst of those:\n\n" + as_markdown(rows)
    )


def _held(plans: Sequence[Plan]) -> list[tuple[str, Rows]]:
    levels = range(len(plans[0].cells))
    head = [
        "ranks",
        *(f"cells of level {l}, most" for l in levels),
        "Σ max/Σ mean",
        "particles, mean",
        "most",
        "most/mean",
    ]
    held = [
        [*head, "MiB, most", "MiB at the start, most", "writers", "MiB of a writer, most"],
        *(
            [
                f"{p.ranks:,}",
                *(f"{n:,}" for n in p.cells.max(axis=1)),
                f"{p.cell_imbalance:.2f}",
                f"{p.particles.mean():.3g}",
                f"{p.particles.max():.3g}",
                f"{p.particle_imbalance:.2f}",
                f"{p.memory.max() / MIB:,.0f}",
                f"{p.start_memory.max() / MIB:,.0f}",
                f"{len(p.checkpoint)}",
                f"{max(load.bytes for load in p.checkpoint) / MIB:,.0f}",
            ]
            for p in plans
        ),
    ]
    what = "messages", "kB", "collectives"
    sent: Rows = [["ranks", "neighbours", *(f"{call}" for call in CALLS)]]
    for p in plans:
        numbers = [[p.most(call, key) for key in ("messages", "bytes", "collectives")] for call in CALLS]
        sent.append(
            [f"{p.ranks:,}", f"{p.neighbours()}", *(f"{m:.0f} / {b / 1e3:.0f} / {c:.0f}" for m, b, c in numbers)]
        )
    return [("What a rank holds", held), (f"What the busiest rank sends by each call: {' / '.join(what)}", sent)]


def _times(plans: Sequence[Plan], machine: Machine, cycles: float) -> Rows:
    rows: Rows = [["ranks", *STAGES, "step, ms", "efficiency", "of solve"]]
    first = step_time(plans[0], machine, cycles)
    for plan in plans:
        times = step_time(plan, machine, cycles)
        part = [
            efficiency((plans[0].ranks, before), (plan.ranks, after))
            for before, after in ((total(first), total(times)), (first["solve"].total, times["solve"].total))
            if after > 0
        ]
        rows.append(
            [
                f"{plan.ranks:,}",
                *(f"{1000.0 * time.total:.3g}" for time in times.values()),
                f"{1000.0 * total(times):.3g}",
                *(f"{one:.0%}" for one in part),
            ]
        )
    return rows


def _choices(plans: Sequence[Plan], machine: Machine, cycles: float) -> Rows:
    """Return the step as it is, and with each choice switched off alone."""
    rows: Rows = [
        [
            "ranks",
            "as it is",
            "particles where their cells are",
            "whole boxes",
            "open walls' work on every rank",
            "deposit after all particles have come",
        ]
    ]
    for plan in plans:
        now = Amounts.of(plan, machine, cycles)
        uneven = plan.without.particles_with_cells / plan.particle_imbalance
        larger = plan.without.with_whole_boxes / plan.cell_imbalance
        without = (
            now,
            replace(now, particles=now.particles * uneven),
            replace(now, **{what: larger * getattr(now, what) for what in OF_CELLS}),
            replace(
                now,
                patches=now.patches * plan.ranks,
                interactions=now.interactions * plan.ranks,
                near=now.near * plan.ranks,
            ),
            replace(now, stayed=np.zeros(plan.ranks)),
        )
        rows.append(
            [f"{plan.ranks:,}", *(f"{1e3 * total(step_time(plan, machine, cycles, one)):.3g}" for one in without)]
        )
    return rows


def _sensitivity(plans: Sequence[Plan], machine: Machine, cycles: float) -> Rows:
    rows: Rows = [["ranks", "work", *NETWORK]]
    for plan in plans:
        found = sensitivity(plan, machine, cycles)
        rows.append([f"{plan.ranks:,}", *(f"{1e3 * low:.3g} to {1e3 * high:.3g}" for low, high in found.values())])
    return rows


def _values(plan: Plan, machines: Sequence[Machine], cycles: float) -> dict[str, object]:
    return {
        "ranks": plan.ranks,
        "cells_most": plan.cells.max(axis=1).tolist(),
        "cell_imbalance": plan.cell_imbalance,
        "boxes_most": plan.boxes.max(axis=1).tolist(),
        "particles_mean": float(plan.particles.mean()),
        "particles_most": float(plan.particles.max()),
        "memory_most": float(plan.memory.max()),
        "start_memory_most": float(plan.start_memory.max()),
        "checkpoint_most": {key: max(getattr(load, key) for load in plan.checkpoint) for key in ("bytes", "received")},
        "writers": len(plan.checkpoint),
        "swept_cells": plan.swept_cells,
        "walls_most": plan.wall_work,
        "without": asdict(plan.without),
        "neighbours": plan.neighbours(),
        "sent": {call: {key: plan.most(call, key) for key in ("messages", "bytes", "collectives")} for call in CALLS},
        "seconds": {
            machine.name: {name: time.total for name, time in step_time(plan, machine, cycles).items()}
            for machine in machines
        },
    }


def draw(plans: Sequence[Plan], machine: Machine, cycles: float) -> Figure:
    """Return the modelled time of a step by stage over ranks, and what a rank holds at most over the mean."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(9.5, 3.8), layout="constrained")
    left, right = figure.subplots(1, 2)
    ranks, modelled = [plan.ranks for plan in plans], [step_time(plan, machine, cycles) for plan in plans]
    times = {"step": [1e3 * total(times) for times in modelled]}
    times |= {name: values for name in STAGES if any(values := [1e3 * times[name].total for times in modelled])}
    draw_times(left, ranks, times, [1 / number for number in ranks])
    left.set(title=machine.name, ylabel="ms per step, modelled")
    left.legend(fontsize=8, frameon=False, loc="center left", bbox_to_anchor=(1, 0.5))
    for label, values in (
        ("cells, Σ max/Σ mean", [plan.cell_imbalance for plan in plans]),
        ("particles, max/mean", [plan.particle_imbalance for plan in plans]),
        ("GiB of the largest rank", [plan.memory.max() / 2**30 for plan in plans]),
    ):
        right.plot(ranks, np.array(values), "o-", markersize=4, label=label)
    over_ranks(right, ranks)
    right.set(yscale="log")
    right.legend(fontsize=8, frameon=False)
    return figure

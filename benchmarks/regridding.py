"""Time what regrid and set-up do with boxes alone, up to a million of them: `python benchmarks regridding`.

A base of n³ boxes with two refined levels around ten bunches, as the reference benchmark has them for n = 24; then all that is
refined moves by one block. Boxes are of 3³ blocks as there, but these of 2³ cells, not 8³, so that one rank can number all.
No field is held and no message sent: all ranks do the same with all boxes, so one process can stand for each of many. Tags are
given as boxes; what scans cells grows with a rank's own cells instead.
"""

from __future__ import annotations

import itertools
import time
from collections.abc import Callable
from dataclasses import dataclass, field
from functools import partial
from typing import Annotated, Any

import numpy as np
from mpi4py import MPI

import amrpic
from amrpic.pic.memory import run_memory
from amrpic.stages.regrid import Regridding, regrid
from amrpic.tables import columns
from goals import Goal
from growth import law

BOX, BLOCK, LEVELS = 6, 2, 3
BASES = (8, 12, 16, 24, 32, 48, 64, 96)  # boxes per axis
BUNCHES = np.stack(np.meshgrid([0.3, 0.7], [0.35, 0.65], [0.1, 0.5, 0.9], indexing="ij"), axis=-1).reshape(-1, 3)[:10]
REACH = {1: 0.047, 2: 0.039}  # of a bunch on each level, over the domain's length
MOST_EXPONENT, MOST_REGRID, MOST_BYTES = 1.1, 50e-3, 200  # s; bytes per box
AT = 16_000  # boxes for which the time of a regrid has a bound
STAGES = ("refine", "memory estimate", "regrid", "set-up")


@dataclass
class Timed:
    """Seconds of processor time of each stage, the least of some runs, for so many boxes; a regrid is the first two of them."""

    boxes: int
    refined: int
    bytes_per_box: float
    seconds: dict[str, float] = field(default_factory=dict)


def blocks(base: int, level: int) -> np.ndarray:
    """Return the blocks of a level within reach of the bunches as index boxes (n, 6)."""
    edge = base * BOX // BLOCK * 2**level  # blocks along an axis
    found = []
    for centre in BUNCHES:
        middle, radius = centre * edge, REACH[level] * edge
        axes = [np.arange(max(int(m - radius), 0), min(int(m + radius) + 1, edge)) for m in middle]
        all_ = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 3)
        found.append(all_[((all_ + 0.5 - middle) ** 2).sum(axis=1) <= radius**2])
    lower = np.unique(np.concatenate(found), axis=0) * BLOCK
    return np.hstack([lower, lower + BLOCK - 1]).astype(np.int32)


def measure(base: int, runs: int) -> Timed:
    """Return what set-up and a regrid take for a base of so many boxes per axis."""
    cells = base * BOX
    refinement = {"levels": 2, "max_grid_size": BOX, "blocking_factor": BLOCK}
    scene = amrpic.Scene.from_dict({"domain": {"lower": 0, "upper": 1, "cells": cells}, "refinement": refinement})
    settings = Regridding(LEVELS, efficiency=0.7)
    coarse = amrpic.Hierarchy(MPI.COMM_SELF, scene.domain.value, (), BOX, BLOCK)
    before = regrid(coarse, [], settings, [blocks(base, level) for level in (1, 2)])
    boxes = [before.boxes(level) for level in range(before.levels)]
    count = sum(map(len, boxes))
    moved = [level + np.array([0, 0, BLOCK, 0, 0, BLOCK]) for level in boxes[1:]]
    held = sum(before.native.metadata_bytes(level) for level in range(before.levels))
    out = Timed(count, count - len(boxes[0]), held / count)
    for _ in range(runs):
        made = _clocked(out, "refine", lambda: regrid(before, [], settings, moved))
        assert made is not before
        new = [made.boxes(level) for level in range(made.levels)]
        _clocked(out, "memory estimate", partial(run_memory, scene, new, 0, 1))
        _clocked(out, "set-up", lambda: amrpic.Hierarchy(MPI.COMM_SELF, scene.domain.value, boxes[1:], BOX, BLOCK))
    out.seconds["regrid"] = sum(out.seconds[stage] for stage in STAGES[:2])
    return out


def _clocked(out: Timed, stage: str, call: Callable[[], Any]) -> Any:
    start = time.process_time()
    result = call()
    out.seconds[stage] = min(out.seconds.get(stage, np.inf), time.process_time() - start)
    return result


def goals(found: list[Timed]) -> list[Goal]:
    """Return what was measured beside its bounds."""
    out = [Goal("bytes per box", max(one.bytes_per_box for one in found), MOST_BYTES, unit=" B")]
    for stage in STAGES:
        exponent = law(stage, "boxes", [(one.boxes, one.seconds[stage]) for one in found]).exponent
        out.append(Goal(f"exponent of {stage}", exponent, MOST_EXPONENT))
    sizes, seconds = [one.boxes for one in found], [one.seconds["regrid"] for one in found]
    if sizes[0] <= AT <= sizes[-1]:
        between = float(np.exp(np.interp(np.log(AT), np.log(sizes), np.log(seconds))))
        out.append(Goal(f"regrid at {AT} boxes", 1e3 * between, 1e3 * MOST_REGRID, unit=" ms"))
    return out


def rows(found: list[Timed]) -> list[tuple[str, ...]]:
    """Return the times as rows of a table."""
    out = [("boxes", "refined", "B per box", *(f"{stage} ms" for stage in STAGES))]
    for one in found:
        times = (f"{1e3 * one.seconds[stage]:.2f}" for stage in STAGES)
        out.append((str(one.boxes), str(one.refined), f"{one.bytes_per_box:.0f}", *times))
    return out


def run(
    boxes: Annotated[float, "most boxes of the base"] = 1e6,
    runs: Annotated[int, "runs of each, of which the least counts"] = 3,
) -> None:
    """Measure, and print the table and the goals."""
    found = [measure(base, runs) for base in itertools.takewhile(lambda n: n**3 <= boxes, BASES)]
    print(*columns(rows(found)), sep="\n")
    for goal in goals(found):
        print(f"{goal.what}: {goal.measured:.3g}{goal.unit}, {goal.bound(goal.must)}: {goal.verdict}")

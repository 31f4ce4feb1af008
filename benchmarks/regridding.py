"""Time what regrid and set-up do with boxes alone, up to a million of them: `python benchmarks regridding`.

A worker of `bench`. A base of n³ boxes with two refined levels around ten bunches, as the reference benchmark has them for
n = 24; then all that is refined moves by one block. Boxes are of 3³ blocks as there, but these of 2³ cells, not 8³, so that one
rank can number all. No field is held and no message sent: all ranks do the same with all boxes, so one process can stand for
each of many. Tags are given as boxes; what scans cells grows with a rank's own cells instead.
"""

from __future__ import annotations

import itertools
from collections.abc import Iterable, Iterator
from functools import partial
from typing import Annotated

import numpy as np
from mpi4py import MPI

import amrpic
from amrpic.pic.memory import run_memory
from amrpic.stages.regrid import Regridding, regrid
from measuring import Record, in_turns

BOX, BLOCK, LEVELS = 6, 2, 3
BASES = (8, 12, 16, 24, 32, 48, 64, 96)  # boxes per axis
BUNCHES = np.stack(np.meshgrid([0.3, 0.7], [0.35, 0.65], [0.1, 0.5, 0.9], indexing="ij"), axis=-1).reshape(-1, 3)[:10]
REACH = {1: 0.047, 2: 0.039}  # of a bunch on each level, over the domain's length
REGRIDDING = "regridding"
STAGES = ("refine", "memory estimate", "set-up")  # a regrid is the first two


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


def name(boxes: int, stage: str) -> str:
    return f"{REGRIDDING}, {boxes} boxes, {stage}"


def points(records: Iterable[Record], stage: str) -> list[tuple[float, float]]:
    """Return boxes and the least seconds of a stage for each mesh."""
    return [
        (record.facts["boxes"], min(record.seconds))
        for record in records
        if record.keys[0] == REGRIDDING and record.keys[-1] == stage
    ]


def measure(base: int, runs: int) -> Iterator[Record]:
    """Yield what each stage of set-up and of a regrid takes for a base of so many boxes per axis, in CPU time."""
    cells = base * BOX
    refinement = {"levels": 2, "max_grid_size": BOX, "blocking_factor": BLOCK}
    scene = amrpic.Scene.from_dict({"domain": {"lower": 0, "upper": 1, "cells": cells}, "refinement": refinement})
    settings = Regridding(LEVELS, efficiency=0.7)
    coarse = amrpic.Hierarchy(MPI.COMM_SELF, scene.domain.value, (), BOX, BLOCK)
    before = regrid(coarse, [], settings, [blocks(base, level) for level in (1, 2)])
    boxes = [before.boxes(level) for level in range(before.levels)]
    count = sum(map(len, boxes))
    moved = [level + np.array([0, 0, BLOCK, 0, 0, BLOCK]) for level in boxes[1:]]
    after = regrid(before, [], settings, moved)
    assert after is not before
    new = [after.boxes(level) for level in range(after.levels)]
    held = sum(before.native.metadata_bytes(level) for level in range(before.levels))
    facts = {"boxes": count, "refined": count - len(boxes[0]), "bytes per box": held / count}
    works = (
        partial(regrid, before, [], settings, moved),
        partial(run_memory, scene, new, 0, 1),
        partial(amrpic.Hierarchy, MPI.COMM_SELF, scene.domain.value, boxes[1:], BOX, BLOCK),
    )
    for stage, seconds in zip(STAGES, in_turns(works, runs), strict=True):
        yield Record(name(count, stage), seconds, facts=facts)


def run(
    boxes: Annotated[float, "most boxes of the base"] = 1e6,
    runs: Annotated[int, "runs of each, of which the least counts"] = 3,
) -> Iterator[Record]:
    """All meshes."""
    for base in itertools.takewhile(lambda n: n**3 <= boxes, BASES):
        yield from measure(base, runs)

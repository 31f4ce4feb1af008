"""How many other ranks each rank meets on a mesh, found for all at once, so that the busiest are not missed."""

from __future__ import annotations

import itertools

import numpy as np

from amrpic.mesh.boxes import Array
from amrpic.mesh.hierarchy import Hierarchy

OFFSETS = [d for d in itertools.product((-1, 0, 1), repeat=3) if d > (0, 0, 0)]  # one of each two opposite ones


def neighbours_of_ranks(mesh: Hierarchy) -> Array:
    """Return how many other ranks own cells of the same level within a block of each rank's, int64 (levels, ranks).

    A halo is no deeper than a block. What lies behind a periodic face does not count. Local.
    """
    return np.array([_of_level(mesh, level) for level in range(mesh.levels)])


def _of_level(mesh: Hierarchy, level: int) -> Array:
    ranks, owners = mesh.comm.size, _owners_of_blocks(mesh, level)
    pairs = [np.zeros(0, dtype=np.int64)]
    for offset in OFFSETS:
        here, there = (owners[tuple(_part(sign * d) for d in offset)] for sign in (1, -1))
        meet = (here != there) & (here >= 0) & (there >= 0)
        one, other = here[meet].astype(np.int64), there[meet].astype(np.int64)
        pairs += [np.unique(one * ranks + other), np.unique(other * ranks + one)]
    return np.bincount(np.unique(np.concatenate(pairs)) // ranks, minlength=ranks)


def _part(offset: int) -> slice:
    """Return all but the last place along an axis for +1, all but the first for -1, all for 0."""
    return {1: slice(None, -1), -1: slice(1, None), 0: slice(None)}[offset]


def _owners_of_blocks(mesh: Hierarchy, level: int) -> Array:
    """Return the owner of each block of a level in the box around all of its boxes, -1 where there is none, int32 (x, y, z)."""
    block, boxes = mesh.blocking_factor, mesh.boxes(level).astype(np.int64)
    first = boxes[:, :3].min(axis=0) // block
    lower, upper = boxes[:, :3] // block - first, boxes[:, 3:] // block - first + 1
    out = np.full(upper.max(axis=0), -1, dtype=np.int32)
    for owner, low, high in zip(mesh.owners(level).tolist(), lower.tolist(), upper.tolist(), strict=True):
        out[low[0] : high[0], low[1] : high[1], low[2] : high[2]] = owner
    return out

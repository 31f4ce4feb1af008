"""Arithmetic of boxes as rows of numbers: lower x, y, z, upper x, y, z, inclusive."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

Array = NDArray[Any]


def cells_of(boxes: Array) -> Array:
    """Return the number of cells of each box."""
    return np.prod(boxes[:, 3:].astype(np.int64) - boxes[:, :3] + 1, axis=1)


def equal_shares(boxes: Array, ranks: int) -> Array:
    """Return owners (n,) that give each rank consecutive boxes with about equally many cells."""
    cells = cells_of(boxes)
    middle = np.cumsum(cells) - cells / 2
    return np.minimum((middle * ranks / max(cells.sum(), 1)).astype(np.int64), ranks - 1)


def overlaps(boxes: Array, others: Array) -> tuple[Array, Array]:
    """Return the pairs (i, j) for which boxes[i] and others[j] share cells, in the order of i, then of j.

    Boxes are put into bins as wide as the largest of them, at most eight each, so the time grows with boxes and pairs alone.
    """
    if len(boxes) == 0 or len(others) == 0:
        return np.empty(0, dtype=np.int64), np.empty(0, dtype=np.int64)
    corners = np.concatenate([boxes, others]).astype(np.int64).reshape(-1, 2, 3)
    width = (corners[:, 1] - corners[:, 0]).max(axis=0) + 1
    corners -= corners.min(axis=(0, 1))
    strides = np.cumprod([1, *(corners.max(axis=(0, 1)) // width + 2)])[:3]
    first, last = (corners[:, k] // width for k in (0, 1))
    in_bin, box = [], []
    for step in np.ndindex(2, 2, 2):
        there = np.flatnonzero(np.all(first + step <= last, axis=1))
        in_bin.append((first[there] + step) @ strides)
        box.append(there)
    bins, members = np.concatenate(in_bin), np.concatenate(box)
    theirs = members >= len(boxes)
    order = np.argsort(bins[theirs], kind="stable")
    start, stop = (np.searchsorted(bins[theirs][order], bins[~theirs], side) for side in ("left", "right"))
    counts = stop - start
    i = np.repeat(members[~theirs], counts)
    j = members[theirs][order][np.arange(counts.sum()) + np.repeat(stop - np.cumsum(counts), counts)]
    lower = np.maximum(corners[i, 0], corners[j, 0])
    meet = np.all(lower <= np.minimum(corners[i, 1], corners[j, 1]), axis=1)
    meet &= lower // width @ strides == np.repeat(bins[~theirs], counts)  # once, in the bin of their first shared cell
    i, j = i[meet], j[meet] - len(boxes)
    order = np.lexsort((j, i))
    return i[order], j[order]


def scaled_cells(cells: tuple[int, int, int], factor: float, block: int) -> tuple[int, int, int]:
    """Return so many times the cells along each axis; along axes with a multiple of the block they stay one."""
    steps = [block if n % block == 0 else 1 for n in cells]
    return tuple(max(step * round(n * factor / step), step, 2) for n, step in zip(cells, steps, strict=True))  # type: ignore[return-value]


def outer_faces(boxes: Array, block: int) -> int:
    """Return the number of cell faces on the surface of the union of disjoint boxes.

    They are aligned to blocks of so many cells, except that those at the domain's upper faces may end with shorter ones.
    """
    if len(boxes) == 0:
        return 0
    corners = boxes.astype(np.int64) // block
    corners = corners - np.tile(corners[:, :3].min(axis=0), 2) + 1
    # to the next block along x, y and z, none beyond an edge
    strides = np.cumprod([1, *(corners.max(axis=0)[3:5] + 2)])
    blocks = np.concatenate([_numbers(box, strides) for box in corners])
    sizes = np.concatenate([_sizes(box, block) for box in boxes.astype(np.int64)])
    total = 0
    for axis, stride in enumerate(strides):
        faces = sizes[:, axis - 1] * sizes[:, axis - 2]  # a block has as many there as its neighbour
        total += 2 * int(faces.sum() - faces[np.isin(blocks + stride, blocks, assume_unique=True)].sum())
    return total


def _numbers(box: Array, strides: Array) -> Array:
    x, y, z = (np.arange(box[d], box[3 + d] + 1) * strides[d] for d in range(3))
    return (x[:, None, None] + y[:, None] + z).ravel()


def _sizes(box: Array, block: int) -> Array:
    """Return the cells of the blocks of a box along each axis, (blocks, 3)."""
    starts = [np.arange(box[d], box[3 + d] + 1, block) for d in range(3)]
    sizes = [np.minimum(block, box[3 + d] + 1 - starts[d]) for d in range(3)]
    return np.stack(np.meshgrid(*sizes, indexing="ij"), axis=-1).reshape(-1, 3)

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


def outer_faces(boxes: Array, block: int) -> int:
    """Return the number of cell faces on the surface of the union of disjoint boxes, aligned to blocks of so many cells."""
    if len(boxes) == 0:
        return 0
    corners = boxes.astype(np.int64) // block
    corners = corners - np.tile(corners[:, :3].min(axis=0), 2) + 1
    strides = np.cumprod(
        [1, *(corners.max(axis=0)[3:5] + 2)]
    )  # to the next block along x, y and z, none beyond an edge
    blocks = np.sort(np.concatenate([_numbers(box, strides) for box in corners]))
    shared = sum(int(np.isin(blocks + stride, blocks, assume_unique=True).sum()) for stride in strides)
    return int(6 * len(blocks) - 2 * shared) * block**2


def _numbers(box: Array, strides: Array) -> Array:
    x, y, z = (np.arange(box[d], box[3 + d] + 1) * strides[d] for d in range(3))
    return (x[:, None, None] + y[:, None] + z).ravel()

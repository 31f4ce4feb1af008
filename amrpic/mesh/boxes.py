"""Arithmetic of boxes as rows of numbers: lower x, y, z, upper x, y, z, inclusive."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from .. import _native

Array = NDArray[Any]


def cells_of(boxes: Array) -> Array:
    """Return the number of cells of each box."""
    return np.prod(boxes[:, 3:].astype(np.int64) - boxes[:, :3] + 1, axis=1)


def all_cells(boxes: Sequence[Array]) -> int:
    """Return how many cells the boxes of all levels have."""
    return sum(int(cells_of(level).sum()) for level in boxes)


def each_cell(boxes: Array) -> tuple[Array, Array]:
    """Return all cells of some boxes, x fastest: the row of the box of each, (m,), and their indices, (m, 3)."""
    sides = boxes[:, 3:].astype(np.int64) - boxes[:, :3] + 1
    count = sides.prod(axis=1)
    row = np.repeat(np.arange(len(boxes)), count)
    place = np.arange(len(row)) - np.repeat(np.cumsum(count) - count, count)
    place, x = np.divmod(place, sides[row, 0])
    z, y = np.divmod(place, sides[row, 1])
    return row, boxes[row, :3] + np.stack([x, y, z], axis=-1)


def equal_shares(boxes: Array, ranks: int) -> Array:
    """Return owners (n,) that give each rank consecutive boxes with about equally many cells."""
    cells = cells_of(boxes)
    middle = np.cumsum(cells) - cells / 2
    return np.minimum((middle * ranks / max(cells.sum(), 1)).astype(np.int64), ranks - 1)


def scaled_cells(cells: tuple[int, int, int], factor: float, block: int) -> tuple[int, int, int]:
    """Return so many times the cells along each axis; along axes with a multiple of the block they stay one."""
    steps = [block if n % block == 0 else 1 for n in cells]
    return tuple(max(step * round(n * factor / step), step, 2) for n, step in zip(cells, steps, strict=True))  # type: ignore[return-value]


def unique_rows(rows: Array) -> tuple[Array, Array]:
    """Return the different ones of rows (n, k) of integers in lexicographic order, and the place of each row among them, (n,).

    Rows become numbers, which are sorted much faster than `numpy.unique` sorts rows.
    """
    if not len(rows):
        return rows, np.zeros(0, dtype=np.int64)
    lower = rows.min(axis=0).astype(np.int64)
    extent = rows.max(axis=0) - lower + 1
    if np.prod(extent, dtype=float) >= 2**62:
        unique, inverse = np.unique(rows, axis=0, return_inverse=True)
        return unique, inverse.ravel()
    numbers, inverse = np.unique(np.ravel_multi_index(tuple((rows - lower).T), tuple(extent)), return_inverse=True)
    return np.stack(np.unravel_index(numbers, tuple(extent)), axis=1) + lower, inverse


def rows_of(boxes: Array) -> Array:
    """Return boxes, or cells, as native functions take them."""
    return np.ascontiguousarray(boxes, dtype=np.int32)


def table_of(boxes: Array) -> _native.BoxTable:
    """Return a look-up of disjoint boxes by their cells, for questions to all of them that do not compare all with all."""
    return _native.BoxTable(rows_of(boxes))

"""Cells beside edges and strongly curved parts of conductors, where fields are large: what refinement asks for."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
import scipy
from numpy.typing import ArrayLike

from ..shapes.spans import Floats, Ints
from .arms import Lattice, Walls, arms_of_boxes
from .conductor import Conductor

# Between places on the metal that are compared, in cells: around an edge these are at most √2 apart.
REACH = 1.5
# Cells whose arms may meet metal within the reach of an arm of a cell.
LAYERS = 4
# Metal between two centres is a sheet if its two normals point this much away from each other.
OPPOSITE = -0.5
BITS = 20  # of an index in a key
BLOCK = 4  # cells
CORNERS = np.array([(i, j, k) for i in (-1, 1) for j in (-1, 1) for k in (-1, 1)])


def edge_cells(
    electrodes: Sequence[Conductor], boxes: ArrayLike, origin: ArrayLike, spacing: ArrayLike, angle: float = 0.35
) -> list[Ints]:
    """Return the cells of each box, ascending, x fastest, beside which normals turn by more than `angle`, rad.

    That is so at edges, and where a radius of curvature is below about 1.5 cells over the angle; only where the metal
    bulges, as fields are weak in hollows. Around the rims of foils all cells at the rim are named.
    """
    rows = np.reshape(np.asarray(boxes, np.int64), (-1, 6))
    grown = rows + np.array([-LAYERS] * 3 + [LAYERS] * 3)
    arms, _ = arms_of_boxes(electrodes, grown, origin, spacing)
    walls = distinct(arms.crossings(electrodes, grown, origin, spacing))
    places = walls.place / Lattice.of(origin, spacing).spacing
    cells = np.concatenate([bent(walls, places, math.cos(angle)), rims(walls)])
    cells = cells[np.argsort(cells[:, 2], kind="stable")]
    first, last = np.searchsorted(cells[:, 2], rows[:, 2]), np.searchsorted(cells[:, 2], rows[:, 5], side="right")
    return [within(row, cells[begin:end]) for row, begin, end in zip(rows, first, last, strict=True)]


def distinct(walls: Walls) -> Walls:
    """Return each place once: boxes with layers around them overlap."""
    chosen = np.unique(packed(walls.cells) * 6 + walls.side, return_index=True)[1]
    return Walls(walls.cut[chosen], walls.side[chosen], walls.cells[chosen], walls.place[chosen], walls.normal[chosen])


def packed(cells: Ints) -> Ints:
    """Return a number for each cell (n, 3)."""
    return np.asarray((cells[:, 0] << 2 * BITS) + (cells[:, 1] << BITS) + cells[:, 2])


def within(box: Ints, cells: Ints) -> Ints:
    """Return the numbers in a box of the cells (n, 3) that it has, each once."""
    index = cells - box[:3]
    size = box[3:] - box[:3] + 1
    index = index[((index >= 0) & (index < size)).all(axis=1)]
    return np.unique(index @ np.array([1, size[0], size[0] * size[1]]))


def bent(walls: Walls, places: Floats, cosine: float) -> Ints:
    """Return the cells (n, 3) of places on the metal between which its normal turns outwards."""
    near = turning(walls.normal, places, math.sqrt(2 * (1 - cosine) / 3))
    pairs = near[scipy.spatial.cKDTree(places[near]).query_pairs(REACH, output_type="ndarray")]
    first, second = pairs.T
    turns = (walls.normal[first] * walls.normal[second]).sum(axis=1)
    spreads = ((walls.normal[second] - walls.normal[first]) * (places[second] - places[first])).sum(axis=1)
    # Both sides of a thin sheet are no edge; its rim is seen by the normals there.
    edge = (turns < cosine) & (turns > OPPOSITE) & (spreads > 0)
    return walls.cells[np.unique(pairs[edge])]


def turning(normals: Floats, places: Floats, least: float) -> Ints:
    """Return the places near which a component of the normal changes by `least` or more; of flat parts there are none."""
    if not len(places):
        return np.empty(0, np.int64)
    # Two places within reach of each other share a block of `BLOCK` cells, grown by the reach.
    corners = [np.floor((places + shift * REACH) / BLOCK).astype(np.int64) for shift in CORNERS]
    blocks = packed(np.concatenate(corners))
    _, number = np.unique(blocks, return_inverse=True)
    order = np.argsort(number, kind="stable")
    begin = np.flatnonzero(np.diff(number[order], prepend=-1))
    ordered = normals[order % len(places)]
    change = np.maximum.reduceat(ordered, begin) - np.minimum.reduceat(ordered, begin)
    varies = np.max(change, axis=1)[number] >= least
    return np.flatnonzero(varies.reshape(len(CORNERS), -1).any(axis=0))


def rims(walls: Walls) -> Ints:
    """Return the cells (n, 3) around squares of four centres that the rim of a sheet goes through.

    A sheet crosses the outline of such a square an even number of times, unless it ends within.
    """
    low, axis = sheets(walls)
    squares = []
    for other in range(3):
        across = axis != other
        for shift in (0, -1):
            corner = low[across] + shift * np.eye(3, dtype=np.int64)[other]
            squares.append(np.column_stack([corner, axis[across] + other]))  # the pair of axes, as their sum
    corners, count = np.unique(np.concatenate(squares), axis=0, return_counts=True)
    odd = corners[count % 2 == 1]
    spans = np.array([[0, 0, 0], [1, 1, 0], [1, 0, 1], [0, 1, 1]])[odd[:, 3]]  # by the sum of the two axes
    steps = [odd[:, :3], odd[:, :3] + spans]
    for axis_number in range(3):
        unit = np.eye(3, dtype=np.int64)[axis_number] * spans
        steps.append(odd[:, :3] + unit)
    return np.concatenate(steps)


def sheets(walls: Walls) -> tuple[Ints, Ints]:
    """Return cells (n, 3) and axes (n,) of upward arms that a thin sheet cuts, on both sides of which is no metal."""
    key = packed(walls.cells) * 3 + walls.side // 2
    steps = np.array([1 << 2 * BITS, 1 << BITS, 1]) * 3
    up, down = np.flatnonzero(walls.side % 2 == 1), np.flatnonzero(walls.side % 2 == 0)
    _, below, above = np.intersect1d(key[up] + steps[walls.side[up] // 2], key[down], return_indices=True)
    below, above = up[below], down[above]
    opposite = (walls.normal[below] * walls.normal[above]).sum(axis=1) < OPPOSITE
    return walls.cells[below[opposite]], walls.side[below[opposite]] // 2

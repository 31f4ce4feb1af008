"""Cells beside edges and strongly curved parts of conductors, where fields are large: what refinement asks for."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
import scipy
from numpy.typing import ArrayLike

from ..shapes.spans import Ints
from .arms import Lattice, Walls, arms_of_boxes
from .conductor import Conductor

# Between places on the metal that are compared, in cells: around an edge these are at most √2 apart.
REACH = 1.5
# Cells whose arms may meet metal within the reach of an arm of a cell.
LAYERS = 4
# Metal between two centres is a sheet if its two normals point this much away from each other.
OPPOSITE = -0.5
BITS = 21  # of an index in a key


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
    walls = arms.crossings(electrodes, grown, origin, spacing)
    box = np.repeat(np.arange(len(rows)), np.diff(arms.first_cut))[walls.cut]
    chosen: list[list[Ints]] = [[] for _ in rows]
    for number in range(len(rows)):
        own = Walls(*(column[box == number] for column in walls))
        if len(own.cut):
            places = own.place / Lattice.of(origin, spacing).spacing
            chosen[number] += [bent(own, places, math.cos(angle)), rims(own)]
    return [within(row, cells) for row, cells in zip(rows, chosen, strict=True)]


def within(box: Ints, cells: Sequence[Ints]) -> Ints:
    """Return the numbers in a box of the cells (n, 3) that it has, each once."""
    index = np.concatenate([np.empty((0, 3), np.int64), *cells]) - box[:3]
    size = box[3:] - box[:3] + 1
    index = index[((index >= 0) & (index < size)).all(axis=1)]
    return np.unique(index @ np.array([1, size[0], size[0] * size[1]]))


def bent(walls: Walls, places: np.ndarray, cosine: float) -> Ints:
    """Return the cells (n, 3) of places on the metal between which its normal turns outwards."""
    pairs = scipy.spatial.cKDTree(places).query_pairs(REACH, output_type="ndarray")
    first, second = pairs.T
    turns = (walls.normal[first] * walls.normal[second]).sum(axis=1)
    spreads = ((walls.normal[second] - walls.normal[first]) * (places[second] - places[first])).sum(axis=1)
    # Both sides of a thin sheet are no edge; its rim is seen by the normals there.
    edge = (turns < cosine) & (turns > OPPOSITE) & (spreads > 0)
    return walls.cells[np.unique(pairs[edge])]


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
    key = ((walls.cells[:, 0] << 2 * BITS) + (walls.cells[:, 1] << BITS) + walls.cells[:, 2]) * 3 + walls.side // 2
    steps = np.array([1 << 2 * BITS, 1 << BITS, 1]) * 3
    up, down = np.flatnonzero(walls.side % 2 == 1), np.flatnonzero(walls.side % 2 == 0)
    _, below, above = np.intersect1d(key[up] + steps[walls.side[up] // 2], key[down], return_indices=True)
    below, above = up[below], down[above]
    opposite = (walls.normal[below] * walls.normal[above]).sum(axis=1) < OPPOSITE
    return walls.cells[below[opposite]], walls.side[below[opposite]] // 2

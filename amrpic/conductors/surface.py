"""Surfaces for eyes: quadrilaterals around a body, and its cut with a plane in pixels."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import scipy
from numpy.typing import ArrayLike, NDArray

from ..shapes import Shape
from ..shapes.spans import Floats, Ints

CELLS = 64  # along the longest side of a body


def quadrilaterals(shape: Shape, lower: ArrayLike, upper: ArrayLike, cells: int = CELLS) -> tuple[Floats, Ints]:
    """Return points (n, 3), m, and quadrilaterals of them (m, 4) on the surface of a body, as far as it lies in a box.

    Each cell of a lattice that the surface cuts has a point, the mean of where it cuts edges of the cell; around each edge that
    it cuts the points of the four cells are joined (S. Gibson, surface nets, 1998). Foils are cut once.
    """
    bounds = np.array(shape.bounds)
    low, high = np.maximum(bounds[0], lower), np.minimum(bounds[1], upper)
    width = float((high - low).max()) / cells
    if not width > 0:
        return np.empty((0, 3)), np.empty((0, 4), np.int64)
    first = low - 1.5 * width  # no node on faces along the axes
    count = np.ceil((high - first) / width).astype(np.int64) + 2
    corners, places, cut = [], [], []
    for axis in range(3):
        edges, place, outwards = _crossed(shape, axis, first, width, count)
        around = [np.zeros(3, np.int64) for _ in range(4)]
        u, v = (axis + 1) % 3, (axis + 2) % 3
        for offset, (du, dv) in zip(around, ((-1, -1), (0, -1), (0, 0), (-1, 0)), strict=True):
            offset[u], offset[v] = du, dv
        four = np.stack([edges + offset for offset in around], axis=1)  # (m, 4, 3)
        four[outwards < 0] = four[outwards < 0, ::-1]
        cut.append(four)
        corners.append(four.reshape(-1, 3))
        places.append(np.repeat(place, 4, axis=0))
    every, place = np.concatenate(corners), np.concatenate(places)
    numbers = (every + 1) @ np.array([1, count[0] + 2, (count[0] + 2) * (count[1] + 2)])
    _, point = np.unique(numbers, return_inverse=True)
    times = np.bincount(point)
    points = np.stack([np.bincount(point, place[:, d]) / times for d in range(3)], axis=1)
    return points, point.reshape(-1, 4)


def _crossed(shape: Shape, axis: int, first: Floats, width: float, count: Ints) -> tuple[Ints, Floats, Ints]:
    """Return the edges (m, 3) of a lattice along an axis that a surface cuts, where, m, and 1 if it faces up there, else -1."""
    u, v = (axis + 1) % 3, (axis + 2) % 3
    at_u, at_v = (part.ravel() for part in np.meshgrid(np.arange(count[u]), np.arange(count[v]), indexing="ij"))
    lines = np.zeros((len(at_u), 3))
    lines[:, u], lines[:, v] = first[u] + at_u * width, first[v] + at_v * width
    spans = shape.spans(lines, axis)
    line = np.concatenate([spans.line, spans.line])
    met = np.concatenate([spans.enter, spans.leave])
    faces = np.repeat([-1, 1], len(spans))
    with np.errstate(invalid="ignore"):
        number = np.floor((met - first[axis]) / width)
    inside = (number >= 0) & (number < count[axis] - 1)
    line, met, faces, number = line[inside], met[inside], faces[inside], number[inside].astype(np.int64)
    _, once = np.unique(line * count[axis] + number, return_index=True)
    line, met, faces, number = line[once], met[once], faces[once], number[once]
    edges, place = np.zeros((len(line), 3), np.int64), lines[line]
    edges[:, axis], edges[:, u], edges[:, v] = number, at_u[line], at_v[line]
    place[:, axis] = met
    return edges, place, faces


def in_plane(
    shape: Shape, axes: tuple[int, int], position: float, lower: ArrayLike, upper: ArrayLike, pixels: Sequence[int]
) -> tuple[NDArray[np.bool_], NDArray[np.bool_]]:
    """Return which pixels (first axis, second axis) of a plane lie in a body, and through which its surface goes.

    The plane has two `axes`, and its third coordinate is `position`, m; corners (2,) are in m.
    """
    corner, extent = np.asarray(lower, float), np.subtract(upper, lower)
    width = extent / pixels
    metal, surface = np.zeros((2, *pixels), bool)
    for along in range(2):
        across = 1 - along
        lines = np.full((pixels[across], 3), position)
        lines[:, axes[across]] = corner[across] + (np.arange(pixels[across]) + 0.5) * width[across]
        spans = shape.spans(lines, axes[along])
        ends = (np.array([spans.enter, spans.leave]) - corner[along]) / width[along]
        begin, end = np.clip(np.ceil(ends - 0.5), 0, pixels[along]).astype(np.int64)
        change = np.zeros((pixels[across], pixels[along] + 1), np.int64)
        np.add.at(change, (spans.line, begin), 1)
        np.add.at(change, (spans.line, np.maximum(begin, end)), -1)
        inside = np.cumsum(change, axis=1)[:, :-1] > 0
        edge = np.zeros_like(inside)
        for values in ends:
            seen = (values >= 0) & (values < pixels[along])
            edge[spans.line[seen], values[seen].astype(np.int64)] = True
        metal |= inside.T if along == 0 else inside
        surface |= edge.T if along == 0 else edge
    return metal, surface


def outline(
    shape: Shape,
    axes: tuple[int, int],
    depth: tuple[float, float],
    lower: ArrayLike,
    upper: ArrayLike,
    pixels: Sequence[int],
) -> NDArray[np.bool_]:
    """Return the pixels (first axis, second axis) at the rim of a body's shadow along the third axis.

    Of the body counts what lies between the coordinates of `depth` along that axis, m; corners (2,) are in m.
    """
    width = np.subtract(upper, lower) / pixels
    centres = [low + (np.arange(n) + 0.5) * w for low, n, w in zip(np.asarray(lower), pixels, width, strict=True)]
    lines = np.zeros((*pixels, 3))
    lines[..., axes[0]], lines[..., axes[1]] = centres[0][:, None], centres[1]
    spans = shape.spans(lines.reshape(-1, 3), 3 - sum(axes))
    shadow = np.zeros(lines[..., 0].size, bool)
    shadow[spans.line[(spans.enter <= depth[1]) & (spans.leave >= depth[0])]] = True
    shadow = shadow.reshape(tuple(pixels))
    return np.asarray(shadow & ~scipy.ndimage.binary_erosion(shadow, border_value=1))

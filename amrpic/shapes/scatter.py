"""Points on the surface of a body, and the area that each of them stands for."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from .shape import Shape
from .spans import Floats


class Scatter(NamedTuple):
    """Points on a surface."""

    place: Floats  # (n, 3) m
    normal: Floats  # (n, 3) unit vectors out of the body
    area: Floats  # (n,) m², that each stands for


def scattered(shape: Shape, lower: ArrayLike, upper: ArrayLike, width: float) -> Scatter:
    """Return points of the surface of a body in a box: where lines along the axes meet it, about `width` m apart.

    A line along an axis, with the area w² around it, meets an area w² / |n| of the surface, n the component of the normal along
    it. The points of the three axes count by n², which adds up to 1: so each has the area w² |n|.
    """
    bounds = np.array(shape.bounds)
    low, high = np.maximum(bounds[0], lower), np.minimum(bounds[1], upper)
    places, normals, areas = [np.zeros((0, 3))], [np.zeros((0, 3))], [np.zeros(0)]
    for axis in range(3 if (low <= high).all() else 0):
        u, v = (other for other in range(3) if other != axis)
        count = np.maximum(np.ceil((high - low) / width).astype(np.int64), 1)
        at_u, at_v = (low[a] + (np.arange(count[a]) + 0.5) / count[a] * (high[a] - low[a]) for a in (u, v))
        start = np.zeros((count[u] * count[v], 3))
        start[:, u], start[:, v] = np.repeat(at_u, count[v]), np.tile(at_v, count[u])
        spans = shape.spans(start, axis)
        line, met = np.concatenate([spans.line, spans.line]), np.concatenate([spans.enter, spans.leave])
        surface, towards = np.concatenate([spans.first, spans.last]), np.repeat([1.0, -1.0], len(spans))
        inside = np.flatnonzero((met >= low[axis]) & (met <= high[axis]))
        place = start[line[inside]]
        place[:, axis] = met[inside]
        normal = shape.normals(place, surface[inside], towards[inside, None] * np.eye(3)[axis])
        places.append(place)
        normals.append(normal)
        areas.append(np.abs(normal[:, axis]) * float(((high - low) / count)[[u, v]].prod()))
    area = np.concatenate(areas)
    extended = area > 0
    return Scatter(np.concatenate(places)[extended], np.concatenate(normals)[extended], area[extended])

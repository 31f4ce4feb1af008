"""Patches: the surface of an electrode in parts about as wide as a cell, each with a column of its own along the normal."""

from __future__ import annotations

import numpy as np
import scipy

from ..shapes import Shape
from ..shapes.scatter import Scatter
from ..shapes.spans import Floats, Ints

LEAST = 0.3  # of the area of a cell: a part with less joins its neighbours
LIFT = 1e-6  # of a cell by which particles start in front of the metal
SHARPEST = 0.4  # of a radius of curvature over the height of a column: edges have a smaller one
AROUND = 1.5  # cells around the middle of a patch over which its curvature is fitted


class Patches:
    """The surface of a body in parts that are about `width` m wide."""

    def __init__(self, shape: Shape, points: Scatter, width: float) -> None:
        self.shape, self.width = shape, width
        index = np.floor(points.place / width).astype(np.int64)
        cell = np.unique(index, axis=0, return_inverse=True)[1].ravel()
        area = np.bincount(cell, points.area)
        middles = np.stack([np.bincount(cell, points.area * x) for x in points.place.T], axis=1) / area[:, None]
        chosen = area >= min(LEAST * width**2, area.max())
        nearest = scipy.spatial.cKDTree(points.place).query(middles[chosen])[1]
        self.centre, self.normal = points.place[nearest], points.normal[nearest]  # (n, 3)
        self._tree = scipy.spatial.cKDTree(self.centre)
        patch = self._tree.query(points.place)[1]
        order = np.argsort(patch, kind="stable")
        self._point, self._normal = points.place[order] + LIFT * width * points.normal[order], points.normal[order]
        self._until = np.concatenate([[0.0], np.cumsum(points.area[order])])  # m², of all points before
        self._first = self._until[np.searchsorted(patch[order], np.arange(len(self) + 1))]
        self.area = np.diff(self._first)  # (n,) m²
        self.mean_curvature, self.gauss_curvature = self._curvatures(points)  # (n,) 1/m and 1/m²

    def __len__(self) -> int:
        return len(self.centre)

    @property
    def emitting(self) -> Ints:
        """The patches that emit: all."""
        return np.arange(len(self))

    def places(self, patch: Ints, u: Floats) -> tuple[Floats, Floats]:
        """Return places (n, 3) in m just in front of patches (n,), and normals there, for numbers (2, n) in (0, 1)."""
        return self._points_at(self._first[patch] + u[0] * self.area[patch])

    def anywhere(self, u: Floats) -> tuple[Floats, Floats]:
        """Return the same, evenly on all of the surface."""
        return self._points_at(u[0] * self._until[-1])

    def _points_at(self, area: Floats) -> tuple[Floats, Floats]:
        chosen = np.clip(np.searchsorted(self._until, area, side="right") - 1, 0, len(self._point) - 1)
        return self._point[chosen], self._normal[chosen]

    def nearest(self, position: Floats) -> Ints:
        """Return the patches of places (n, 3) on the surface."""
        return np.asarray(self._tree.query(position)[1], dtype=np.int64)

    def find(self, position: Floats, height: float) -> tuple[Ints, Ints, Floats]:
        """Return which places (m, 3) are less than a height in m in front of the metal, their patches and their heights."""
        lower, upper = self.centre.min(axis=0) - 2 * height, self.centre.max(axis=0) + 2 * height
        close = np.flatnonzero(((position >= lower) & (position <= upper)).all(axis=1))
        distance, patch = self._tree.query(position[close], distance_upper_bound=height + 2 * self.width)
        within = np.flatnonzero(np.isfinite(distance))
        close, patch = close[within], patch[within]
        spans = self.shape.spans(position[close], -self.normal[patch])
        above = np.full(len(close), np.inf)
        np.minimum.at(above, spans.line, np.where(spans.leave < 0, np.inf, np.maximum(spans.enter, 0.0)))
        low = np.flatnonzero(above < height)
        return close[low], patch[low], above[low]

    def widening(self, patch: Ints, height: Floats) -> Floats:
        """Return the area of columns at a height in m over that of their patches."""
        return np.asarray(1 + 2 * self.mean_curvature[patch] * height + self.gauss_curvature[patch] * height**2)

    def _curvatures(self, points: Scatter) -> tuple[Floats, Floats]:
        """Return mean and Gaussian curvature: of a linear fit of normals around the middle of each patch."""
        near = scipy.spatial.cKDTree(points.place).query_ball_point(self.centre, AROUND * self.width)
        mean, gauss = np.zeros((2, len(self)))
        most = SHARPEST / self.width
        for patch, chosen in enumerate(near):
            normal = self.normal[patch]
            x = np.cross(normal, np.eye(3)[np.argmin(np.abs(normal))])
            axes = np.stack([x / np.linalg.norm(x), np.cross(normal, x / np.linalg.norm(x))], axis=1)
            steps, turns = ((of[chosen] - of_middle) @ axes for of, of_middle in (
                (points.place, self.centre[patch]), (points.normal, normal)))  # fmt: skip
            slope = np.linalg.lstsq(steps, turns, rcond=None)[0]
            principal = np.clip(np.linalg.eigvalsh((slope + slope.T) / 2), -most, most)
            mean[patch], gauss[patch] = principal.mean(), principal.prod()
        return mean, gauss

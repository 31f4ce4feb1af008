"""Where a mesh that moves is in the laboratory."""

from __future__ import annotations

import itertools
import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from .domain import Domain

Vector = tuple[float, float, float]
UNTURNED = ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0))


@dataclass(frozen=True)
class Window:
    """Coordinates of the mesh and its particles: their origin (m) and unit vectors in the laboratory.

    Formats of meshes know no turned axes. Files and pictures show a turned mesh along the axes of the laboratory, so that the
    place `pivot` (m, in the window) is where it is: that of the particle with which the window turns.
    """

    origin: Vector = (0.0, 0.0, 0.0)
    axes: tuple[Vector, Vector, Vector] = UNTURNED
    pivot: Vector = (0.0, 0.0, 0.0)

    @property
    def is_turned(self) -> bool:
        return self.axes != UNTURNED

    def at(self, origin: np.ndarray) -> Window:
        """Return the window with its origin (3,) in m elsewhere in the laboratory."""
        return replace(self, origin=vector(origin))

    def turned(self, before: np.ndarray, after: np.ndarray) -> Window:
        """Return the window turned by the smallest turn that takes the line along `before` (3,) into that along `after` (3,).

        So it backs up where a direction is reversed, and stays as it is where one vanishes. A vector a becomes
        a cos + w × a + w (w · a) / (1 + cos), w = before × after (O. Rodrigues, 1840).
        """
        if not (before.any() and after.any()):
            return self
        before, after = before / np.linalg.norm(before), after / np.linalg.norm(after)
        after = after if before @ after >= 0 else -after
        cosine, w = float(before @ after), np.cross(before, after)
        if not w.any():
            return self
        axes = np.array(self.axes)
        axes = axes * cosine + np.cross(w, axes) + np.outer(axes @ w, w) / (1 + cosine)
        x, y, _ = axes = axes / np.linalg.norm(axes, axis=1)[:, None]
        y = y - x * (x @ y)  # what rounding leaves does not grow from turn to turn
        y /= np.linalg.norm(y)
        return replace(self, axes=(vector(x), vector(y), vector(np.cross(x, y))))

    def shift_to(self, other: Window) -> Vector:
        """Return where the origin of another window is in this one, m."""
        return vector(self.from_laboratory(np.subtract(other.origin, self.origin)))

    def turn_to(self, other: Window) -> np.ndarray | None:
        """Return the matrix (3, 3) by which vectors of this window become those of another; None if their axes are the same."""
        return None if other.axes == self.axes else np.array(other.axes) @ np.array(self.axes).T

    def to_laboratory(self, vectors: np.ndarray) -> np.ndarray:
        """Return vectors (..., 3) of the window along the axes of the laboratory."""
        return vectors @ np.array(self.axes) if self.is_turned else vectors

    def from_laboratory(self, vectors: np.ndarray) -> np.ndarray:
        """Return vectors (..., 3) of the laboratory along the axes of the window."""
        return vectors @ np.array(self.axes).T if self.is_turned else vectors

    def places(self, positions: np.ndarray) -> np.ndarray:
        """Return places (..., 3) in the laboratory, m, of positions in the window."""
        return self.to_laboratory(positions) + self.origin

    @property
    def shift(self) -> np.ndarray:
        """By how much (3,), in m, the mesh is moved from its own coordinates to where files and pictures show it."""
        return self.places(np.array(self.pivot)) - self.pivot if self.is_turned else np.array(self.origin)

    def shown(self, domain: Domain) -> Domain:
        """Return the domain of the mesh where files and pictures show it."""
        if not self.shift.any():
            return domain
        return replace(domain, lower=vector(domain.lower + self.shift), upper=vector(domain.upper + self.shift))

    def astray(self, domain: Domain) -> float:
        """Return by how much, in m, the corners of the domain are shown beside their places, since the axes are turned."""
        corners = np.array(list(itertools.product(*zip(domain.lower, domain.upper, strict=True)))) - self.pivot
        return float(np.linalg.norm(self.to_laboratory(corners) - corners, axis=1).max())


def part_of(turn: np.ndarray, share: float) -> np.ndarray:
    """Return the matrix (3, 3) that turns by a share of the angle of another one, which is below half a turn."""
    w = np.array([turn[2, 1] - turn[1, 2], turn[0, 2] - turn[2, 0], turn[1, 0] - turn[0, 1]]) / 2  # axis times sine
    sine = float(np.linalg.norm(w))
    if sine == 0:
        return np.eye(3)
    angle = share * math.atan2(sine, (np.trace(turn) - 1) / 2)
    cross = np.cross(np.eye(3), w / sine)  # its product with a vector is axis × vector
    return np.eye(3) + math.sin(angle) * cross + (1 - math.cos(angle)) * cross @ cross


def vector(of: ArrayLike) -> Vector:
    """Return three numbers."""
    x, y, z = np.asarray(of, dtype=float).tolist()
    return (x, y, z)


AT_REST = Window()  # the coordinates of the laboratory


def window_of(values: Mapping[str, Any]) -> Window:
    """Return the window of its `origin`, `axes` and `pivot` as files have them; what older ones lack is as at rest."""
    x, y, z = (vector(axis) for axis in values.get("axes", UNTURNED))
    return Window(vector(values.get("origin", (0, 0, 0))), (x, y, z), vector(values.get("pivot", (0, 0, 0))))


def axes(direction: tuple[float, float, float], roll: float) -> list[list[float]]:
    """Return the unit vectors along x, y, z of what looks into a direction: turned from those of the laboratory by the smallest
    turn that takes z into the direction (about y if that is -z), then rolled about it."""
    x, y, z = np.array(direction) / math.hypot(*direction)
    s = x * x + y * y
    if s == 0:
        turned = np.diag([math.copysign(1.0, z), 1.0, math.copysign(1.0, z)])
    else:
        # rows are the new axes; c = (1 - cos) / sin² = 1 / (1 + cos), without cancellation for either sign of the cosine
        c = (1 - z) / s if z < 0 else 1 / (1 + z)
        turned = np.array([[1 - c * x * x, -c * x * y, -x], [-c * x * y, 1 - c * y * y, -y], [x, y, z]])
    cosine, sine = math.cos(roll), math.sin(roll)
    rolled: list[list[float]] = (np.array([[cosine, sine, 0], [-sine, cosine, 0], [0, 0, 1]]) @ turned).tolist()
    return rolled

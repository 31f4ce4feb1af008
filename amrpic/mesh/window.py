"""Where a mesh that moves is in the laboratory."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

Vector = tuple[float, float, float]
UNTURNED = ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0))


@dataclass(frozen=True)
class Window:
    """Coordinates of the mesh and its particles: their origin (m) and unit vectors in the laboratory."""

    origin: Vector = (0.0, 0.0, 0.0)
    axes: tuple[Vector, Vector, Vector] = UNTURNED

    @property
    def is_turned(self) -> bool:
        return self.axes != UNTURNED

    def at(self, origin: np.ndarray) -> Window:
        """Return the window with its origin (3,) in m elsewhere in the laboratory."""
        return Window(vector(origin), self.axes)

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
        return Window(self.origin, (vector(x), vector(y), vector(np.cross(x, y))))

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


def vector(of: ArrayLike) -> Vector:
    """Return three numbers."""
    x, y, z = np.asarray(of, dtype=float).tolist()
    return (x, y, z)


AT_REST = Window()  # the coordinates of the laboratory

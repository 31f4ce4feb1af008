"""The frames of a reference particle along its orbit."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from ..mesh.directions import axes as axes_of
from .pieces import LatticePiece


@dataclass(frozen=True, eq=False)
class OrbitFrame:
    """A place on the orbit: x and y across it, z along it."""

    origin: np.ndarray  # (3,) m
    axes: np.ndarray  # (3, 3), rows: x, y and z

    def moved(self, *by: float) -> OrbitFrame:
        """Return the frame moved by lengths along its own axes, m."""
        return OrbitFrame(self.origin + np.array(by) @ self.axes, self.axes)

    def rolled(self, angle: float) -> OrbitFrame:
        """Return the frame turned about z, from x towards y, rad."""
        c, s = math.cos(angle), math.sin(angle)
        return OrbitFrame(self.origin, np.array([[c, s, 0], [-s, c, 0], [0, 0, 1]]) @ self.axes)

    def bent(self, angle: float) -> OrbitFrame:
        """Return the frame turned about y, from z towards -x, rad."""
        c, s = math.cos(angle), math.sin(angle)
        return OrbitFrame(self.origin, np.array([[c, 0, s], [0, 1, 0], [-s, 0, c]]) @ self.axes)

    @property
    def direction(self) -> tuple[float, float, float]:
        """Of z."""
        x, y, z = self.axes[2].tolist()
        return (x, y, z)

    @property
    def roll(self) -> float:
        """Of x from that of an element with this direction and no roll, rad."""
        x, y, _ = np.array(axes_of(self.direction, 0.0))
        return math.atan2(self.axes[0] @ y, self.axes[0] @ x)


START = OrbitFrame(np.zeros(3), np.eye(3))


def chord(piece: LatticePiece) -> float:
    """Return the length from end to end of a piece, m."""
    half = piece.angle / 2
    return piece.length * (math.sin(half) / half if half else 1.0)


def middle(entry: OrbitFrame, piece: LatticePiece) -> OrbitFrame:
    """Return the frame halfway along the straight line from end to end of a piece, z along it."""
    return entry.rolled(piece.tilt).bent(piece.angle / 2).moved(0, 0, chord(piece) / 2)


def exit_of(entry: OrbitFrame, piece: LatticePiece) -> OrbitFrame:
    """Return the frame behind a piece."""
    half = middle(entry, piece).moved(0, 0, chord(piece) / 2)
    return half.bent(piece.angle / 2).rolled(-piece.tilt)

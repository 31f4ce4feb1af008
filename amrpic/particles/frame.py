"""The frame in which the self-field of a fast beam is electrostatic."""

from __future__ import annotations

import math
from dataclasses import dataclass

STATIC = 1e-4  # β² of a part below which "auto" leaves its magnetic field out
SLOW = 0.01  # share of the force by magnetic fields above which they must not be left out; β² where all move together


@dataclass(frozen=True)
class Frame:
    """A frame that moves along a mesh axis; the laboratory, where it does not move."""

    axis: int = 2
    momentum: float = 0.0  # β γ

    @property
    def gamma(self) -> float:
        return math.hypot(1.0, self.momentum)

    @property
    def rapidity(self) -> float:
        return math.asinh(self.momentum)

    @property
    def beta(self) -> tuple[float, float, float]:
        """Velocity over c."""
        out = [0.0, 0.0, 0.0]
        out[self.axis] = self.momentum / self.gamma
        return (out[0], out[1], out[2])

    @property
    def stretch(self) -> tuple[float, float, float]:
        """Factors on lengths from the laboratory to this frame: see `PoissonSolver`."""
        out = [1.0, 1.0, 1.0]
        out[self.axis] = self.gamma
        return (out[0], out[1], out[2])

    @property
    def is_fast(self) -> bool:
        """Whether its magnetic field must not be left out."""
        return max(map(abs, self.beta)) ** 2 > SLOW

    @property
    def reversed(self) -> Frame:
        """The frame of images in a wall across the axis, which move against their charge."""
        return Frame(self.axis, -self.momentum)


LABORATORY = Frame()

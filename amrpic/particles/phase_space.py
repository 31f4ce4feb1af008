"""A bunch in phase space as a linear image of unit coordinates."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ..units import SPEED_OF_LIGHT


@dataclass(frozen=True)
class PhasePlane:
    """One plane: x = size a, p = lean a + spread b from unit coordinates a and b that are not correlated.

    So <x^2> = size^2, <x p> = size lean, <p^2> = lean^2 + spread^2.
    """

    size: float  # m
    lean: float = 0.0  # kg m/s
    spread: float = 0.0  # kg m/s

    @classmethod
    def of_emittance(cls, emittance: float, alpha: float, size: float, mass: float) -> PhasePlane:
        """Return the plane of a normalised emittance (m rad), Twiss alpha and rms size (m).

        <x p> = -alpha emittance m c and <x^2> <p^2> - <x p>^2 = (emittance m c)^2.
        """
        spread = emittance * mass * SPEED_OF_LIGHT / size if emittance > 0 else 0.0
        return cls(size, 0.0 - alpha * spread, spread)


@dataclass(frozen=True)
class PhaseSpace:
    """Where a bunch is, how it moves, and its three planes."""

    centre: Sequence[float]  # m
    planes: Sequence[PhasePlane]  # along x, y, z
    momentum: Sequence[float] = (0.0, 0.0, 0.0)  # mean of one real particle, kg m/s

    def place(self, unit: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return positions (n, 3) m and momenta (n, 3) kg m/s for unit coordinates x, y, z, p_x, p_y, p_z, (6, n)."""
        size, lean, spread = (
            np.array([[getattr(p, name)] for p in self.planes]) for name in ("size", "lean", "spread")
        )
        position = np.array(self.centre, dtype=float)[:, None] + size * unit[:3]
        momentum = np.array(self.momentum, dtype=float)[:, None] + (lean * unit[:3] + spread * unit[3:])
        return position.T, momentum.T

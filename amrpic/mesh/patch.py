"""The cells of one field in one box."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from .hierarchy import Hierarchy


@dataclass(frozen=True)
class Patch:
    """The values of one field in one box of this rank."""

    level: int
    box: int  # its number among the level's boxes
    lower: tuple[int, int, int]  # inclusive global indices of its level
    upper: tuple[int, int, int]
    data: np.ndarray  # (nx, ny, nz), x fastest in memory; writable unless the field is locked
    hierarchy: Hierarchy

    def centres(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Cell centres in m as three arrays that broadcast to (nx, ny, nz)."""
        h = self.hierarchy.spacing(self.level)
        axes = [
            self.hierarchy.domain.lower[d] + (np.arange(self.lower[d], self.upper[d] + 1) + 0.5) * h[d]
            for d in range(3)
        ]
        return axes[0][:, None, None], axes[1][None, :, None], axes[2][None, None, :]

    @cached_property
    def covered(self) -> np.ndarray:
        """Where a finer level covers the cell, bool (nx, ny, nz)."""
        return self.hierarchy.native.covered(self.level, self.box).astype(bool)

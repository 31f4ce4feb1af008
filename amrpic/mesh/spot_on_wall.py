"""The part of each face of a wall that emits, and the field there: a face at the rim of a spot emits from a part alone."""

from __future__ import annotations

from collections.abc import Callable
from functools import cached_property

import numpy as np

from .columns import Columns

ACROSS = 16  # places along each axis of a face by which its part in the spot is counted
BESIDE = [(x, y) for x in (-1, 0, 1) for y in (-1, 0, 1) if (x, y) != (0, 0)]


class SpotOnWall:
    """A spot on the faces of columns; `holds` says which places (2, n) in m lie in it, None that all do."""

    def __init__(self, columns: Columns, holds: Callable[[np.ndarray], np.ndarray] | None) -> None:
        self.columns = columns
        self.share = np.ones(len(columns)) if holds is None else self._shares(holds)  # (n,) of each face that emits

    @property
    def area(self) -> np.ndarray:
        """(n,) m², of each face that emits."""
        return self.share * self.columns.area

    @cached_property
    def emitting(self) -> np.ndarray:
        """The columns (m,) with a face of which some part emits."""
        return np.flatnonzero(self.share > 0)

    def inside(self, field: np.ndarray) -> np.ndarray:
        """Return the field where faces emit, of means over faces (n,).

        A face at the rim emits until the field is zero on its part in the spot, not the mean over it. Beside the spot it has
        the field of the dark faces around, so the rest is that in the spot, which is no larger than the mean since charge lies
        in front of it.
        """
        rim, dark = self._rim
        share, mean = self.share[rim], field[rim]
        outside = (field[self._beside] * dark).sum(axis=1) / dark.sum(axis=1)
        out = field.copy()
        out[rim] = np.minimum(mean, (mean - (1 - share) * outside) / share)
        return out

    @cached_property
    def _rim(self) -> tuple[np.ndarray, np.ndarray]:
        """Columns (m,) of which a part emits and that have dark ones around, and which of `_beside` (m, 8) are dark."""
        partial = np.flatnonzero((self.share > 0) & (self.share < 1))
        beside = np.stack([self.columns.beside(partial, step) for step in BESIDE], axis=1)
        dark = self.share[beside] == 0
        chosen = dark.any(axis=1)
        self._beside = beside[chosen]
        return partial[chosen], dark[chosen]

    def _shares(self, holds: Callable[[np.ndarray], np.ndarray]) -> np.ndarray:
        corner, width = (values[:, self.columns.across] for values in (self.columns.corner, self.columns.width))
        parts = (np.arange(ACROSS) + 0.5) / ACROSS
        out = np.zeros(len(self.columns))
        for x in parts:
            for y in parts:
                out += holds((corner + width * [x, y]).T)
        return out / ACROSS**2

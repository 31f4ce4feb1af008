"""The part of each face of a wall that emits, and the field there: a face at the rim of a spot emits from a part alone."""

from __future__ import annotations

from collections.abc import Callable
from functools import cached_property

import numpy as np

from .columns import Columns

PARTS = 16  # along each axis of a face, by which its share in the spot is counted
MIDDLES = (np.stack(np.divmod(np.arange(PARTS**2), PARTS)) + 0.5) / PARTS  # (2, PARTS²)
BESIDE = [(x, y) for x in (-1, 0, 1) for y in (-1, 0, 1) if (x, y) != (0, 0)]


class SpotOnWall:
    """A spot on the faces of columns; `holds` says which places (2, n) in m lie in it, None that all do."""

    def __init__(self, columns: Columns, holds: Callable[[np.ndarray], np.ndarray] | None) -> None:
        self.columns = columns
        inside = np.ones((1, len(columns)), dtype=bool) if holds is None else self._inside(holds)
        self.share = inside.mean(axis=0)  # (n,) of each face that emits
        partial = np.flatnonzero((self.share > 0) & (self.share < 1))
        self._number = np.full(len(columns), -1)  # (n,) of each face of which a part emits
        self._number[partial] = np.arange(len(partial))
        self._emitting_parts = np.argsort(~inside[:, partial], axis=0, kind="stable").T  # (m, PARTS²): these first
        self._count = inside[:, partial].sum(axis=0)  # (m,) of them

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

    def places(self, column: np.ndarray, u: np.ndarray) -> np.ndarray:
        """Return places (2, n), m, on the faces of columns (n,) for numbers (2, n) in (0, 1); none is out of the spot.

        Those on a face at the rim are the middles of its parts that emit, so that it gives all that its share of it asks for.
        """
        number = self._number[column]
        rim = np.flatnonzero(number >= 0)
        number, u = number[rim], u.copy()
        chosen = self._emitting_parts[number, (u[0, rim] * self._count[number]).astype(np.int64)]
        u[:, rim] = MIDDLES[:, chosen]
        corner, width = (
            values[column][:, self.columns.across].T for values in (self.columns.corner, self.columns.width)
        )
        return corner + width * u

    @cached_property
    def _rim(self) -> tuple[np.ndarray, np.ndarray]:
        """Columns (m,) of which a part emits and that have dark ones around, and which of `_beside` (m, 8) are dark."""
        partial = np.flatnonzero((self.share > 0) & (self.share < 1))
        beside = np.stack([self.columns.beside(partial, step) for step in BESIDE], axis=1)
        dark = self.share[beside] == 0
        chosen = dark.any(axis=1)
        self._beside = beside[chosen]
        return partial[chosen], dark[chosen]

    def _inside(self, holds: Callable[[np.ndarray], np.ndarray]) -> np.ndarray:
        """Return which parts of faces have their middle in the spot, (PARTS², n)."""
        corner, width = (values[:, self.columns.across].T for values in (self.columns.corner, self.columns.width))
        return np.array([holds(corner + width * middle[:, None]) for middle in MIDDLES.T])

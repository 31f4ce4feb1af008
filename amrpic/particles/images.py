"""Which images stand for the particles of a part of a beam where space repeats: those nearest to its middle."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..mesh.domain import Domain
from ..mesh.periods import middle, nearest


@dataclass(frozen=True)
class Images:
    """The middle of a part of a beam, and how far space repeats about it."""

    centre: np.ndarray  # (3,) m, in the domain
    period: (
        np.ndarray
    )  # (3,) m; 0 along axes on which places stay as they are, as nothing repeats, or the part has no middle
    fill: np.ndarray  # (3,) rms size round each axis over its period, infinite if even; 0 where nothing repeats

    @classmethod
    def of(cls, sums: np.ndarray, domain: Domain | None) -> Images:
        """Return those of a part from its `circular_sums` (8,)."""
        weight, square, *of_axes = sums.tolist()
        if domain is None or not weight > 0:
            return NO_IMAGES
        centre, period, fill = np.zeros(3), np.zeros(3), np.zeros(3)
        for axis in np.flatnonzero(domain.periodic).tolist():
            cosine, sine = of_axes[2 * axis : 2 * axis + 2]
            place, fill[axis] = middle(cosine / weight, sine / weight, weight**2 / square)
            if np.isfinite(place):
                period[axis] = domain.period(axis)
                centre[axis] = domain.lower[axis] + place * period[axis]
        return cls(centre, period, fill)

    def about(self, mean: np.ndarray, domain: Domain | None) -> Images:
        """Return those that are as many periods further on as bring a mean (3,) of them into the domain."""
        if domain is None or not self.period.any():
            return self
        repeats = self.period > 0
        turns = np.floor((mean - domain.lower) / np.where(repeats, self.period, 1.0)) * repeats
        return Images(self.centre - turns * self.period, self.period, self.fill)

    def of_places(self, position: np.ndarray) -> np.ndarray:
        """Return the nearest images of places (n, 3) in m."""
        along = zip(position.T, self.centre, np.where(self.period > 0, self.period, np.inf), strict=True)
        return np.stack([centre + nearest(x - centre, period) for x, centre, period in along], axis=1)


NO_IMAGES = Images(np.zeros(3), np.zeros(3), np.zeros(3))  # places as they are


def periods(domain: Domain) -> tuple[float, float, float]:
    """Return after how far space repeats along each axis, m, as native functions take it: 0 where it does not."""
    x, y, z = (domain.period(axis) if domain.periodic[axis] else 0.0 for axis in range(3))
    return x, y, z

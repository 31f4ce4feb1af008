"""Where things are in space that repeats: images in the domain, those nearest to a place, and the middle of what goes round."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from .. import _native

Array = NDArray[np.float64]

# The resultant of what goes round, 0 if it is even and 1 if it is in one place, above which it has a middle: the root of this
# many variances of the noise of so many particles, but no less and no more than these two.
NOISE, LEAST, ENOUGH = 20.0, 0.1, 0.5
LARGEST_FILL = (
    1 / 6
)  # circular rms size over the period: half a percent of a normal beam's size, as nearest images have it


def wrapped(points: Array, lower: Array, upper: Array, periodic: Sequence[bool]) -> Array:
    """Return points (n, 3) in m, those beyond periodic faces where their images are in the domain: lower <= x < upper."""
    first, last = (np.asarray(corner, dtype=np.float64).tolist() for corner in (lower, upper))
    return _native.wrapped(
        np.ascontiguousarray(points, dtype=np.float64), first, last, [bool(is_periodic) for is_periodic in periodic]
    )


def wrapped_along(axis: int, place: float, lower: Array, upper: Array, periodic: Sequence[bool]) -> float:
    """Return a place along an axis, m, where its image is in the domain if that is periodic there."""
    point = np.array([lower], dtype=np.float64)
    point[0, axis] = place
    return float(wrapped(point, lower, upper, periodic)[0, axis])


def nearest(offset: Array, period: float) -> Array:
    """Return offsets in m as short as images make them, where space repeats after `period` m; infinity: nowhere."""
    return offset - period * np.round(offset / period) if math.isfinite(period) else offset


def middle(cosine: float, sine: float, number: float) -> tuple[float, float]:
    """Return the middle of what goes round, in periods from 0 to 1, nan where there is none, and its rms size in periods.

    `cosine` and `sine` are the means of cos(2π x) and sin(2π x), x in periods, over equal particles of this `number`. The
    rms size is that of a normal distribution with this resultant R, sqrt(-2 ln R) / 2π (K. V. Mardia and P. E. Jupp,
    Directional Statistics, 2000, 2.3): infinite if it is even.
    """
    resultant = min(math.hypot(cosine, sine), 1.0)
    fill = math.sqrt(-2 * math.log(resultant)) / (2 * math.pi) if resultant > 0 else math.inf
    if resultant <= min(max(math.sqrt(NOISE / number), LEAST), ENOUGH):
        return math.nan, fill
    return math.atan2(sine, cosine) / (2 * math.pi) % 1.0, fill

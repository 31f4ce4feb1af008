"""Arrays that are given, checked at the door."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from ..errors import InputError


def finite(values: ArrayLike, name: str, dimensions: int | None = None) -> np.ndarray:
    """Return values as a contiguous array of doubles. InputError if some are not finite, or the axes are too few or many."""
    try:
        array = np.ascontiguousarray(values, dtype=np.float64)
    except (TypeError, ValueError):
        raise InputError(f"{name} are no array of numbers; give all rows the same length") from None
    if dimensions is not None and array.ndim != dimensions:
        raise InputError(f"{name} have {array.ndim} axes; give {dimensions}")
    good = np.isfinite(array)
    if not good.all():
        where = np.unravel_index(int(np.argmin(good)), array.shape)
        at = ", ".join(str(int(i)) for i in where)
        raise InputError(f"{name} hold {array[where]} at [{at}]; leave out what is not finite")
    return array


def points(values: ArrayLike, name: str) -> np.ndarray:
    """Return points (n, 1 to 3). InputError if they are something else."""
    array = finite(values, name, 2)
    if not 1 <= array.shape[1] <= 3:
        raise InputError(f"{name} have {array.shape[1]} coordinates; give 1, 2 or 3")
    return array

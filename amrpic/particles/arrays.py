"""Arrays of particles: columns laid out for the kernels, in memory that is used again."""

from __future__ import annotations

import itertools

import numpy as np

from .. import _native
from ..errors import ParticleError

PAGE = 512  # doubles


def repeated(values: np.ndarray) -> np.ndarray:
    """The same values, as one that takes no memory if they are equal."""
    return np.broadcast_to(values[0], values.shape) if len(values) > 0 and (values == values[0]).all() else values


def empty_columns(count: int) -> np.ndarray:
    """(count, 3), each column contiguous and starting on a cache line."""
    # Kernels read the columns of several arrays at once. Each array starts an eighth of a page after the one before, so that
    # they do not compete for the same cache sets, and reads do not wait for writes to equal low address bits.
    first = next(_columns_made) * PAGE // 8 % PAGE
    capacity = -(-count // PAGE) * PAGE + PAGE // 8
    memory = recycled(3 * capacity + PAGE, np.float64)
    return memory[first : first + 3 * capacity].reshape(3, capacity).T[:count]


def zero_columns(count: int) -> np.ndarray:
    """(count, 3) zeros that cannot be written to: memory that all share and nobody touches."""
    global _zeros
    if _zeros.shape[1] < count:
        _zeros = np.zeros((3, count))
        _zeros.flags.writeable = False
    return _zeros.T[:count]


def columns(values: np.ndarray, what: str) -> np.ndarray:
    """The same values (n, 3) with contiguous columns, as kernels read them: themselves, or a copy.

    Raises ParticleError for another shape; `what` says in it what they are.
    """
    values = np.asarray(values, dtype=np.float64)
    if values.ndim != 2 or values.shape[1] != 3:
        raise ParticleError(f"the {what} have shape {values.shape}; give (n, 3)")
    if values.strides[0] == values.itemsize or len(values) == 0:
        return values
    out = empty_columns(len(values))
    out[...] = values
    return out


def recycled(count: int, dtype: type) -> np.ndarray:
    """(count,) values of eight bytes each, not set; in the memory of an array that is gone, if there is such.

    A step makes and drops many arrays of the same size, and fresh memory takes longer to get than to fill.
    """
    return _native.recycled(8 * count).view(dtype)


_columns_made = itertools.count(0, 3)
_zeros = np.zeros((3, 0))

"""scipy's sine transform as a solver, and as a yardstick: what times per cell are divided by.

It is bound by memory and arithmetic about as a multigrid solver is, is installed everywhere, and is the same code whatever we
change. So a time over its time, both of the same turn, can be compared between processors and between days.
"""

from __future__ import annotations

from collections.abc import Callable
from time import perf_counter

import numpy as np
from scipy import fft

Array = np.ndarray
YARDSTICK = 128  # cells along an axis


def eigenvalues(n: int) -> Array:
    """Those of h² times minus the second difference with ghosts of opposite sign, for dstn type 2."""
    return 4 * np.sin(np.pi * np.arange(1, n + 1) / (2 * n)) ** 2


def inverse_eigenvalues(n: int) -> Array:
    """One over those of h² times minus the Laplacian, (n, n, n)."""
    of_x, of_y, of_z = np.meshgrid(*[eigenvalues(n)] * 3, indexing="ij", sparse=True)
    return 1 / (of_x + of_y + of_z)


def by_sine_transform(f: Array, inverse: Array) -> Array:
    """Return φ by the discrete sine transform and its inverse: a direct solve, the floor for uniform meshes."""
    return fft.idstn(fft.dstn(f, type=2, workers=1) * inverse, type=2, workers=1)


class Yardstick:
    """Times the direct solve of 128³ cells."""

    def __init__(self, n: int = YARDSTICK) -> None:
        self.cells = n**3
        self._f = np.random.default_rng(1).normal(size=(n, n, n))
        self._inverse = inverse_eigenvalues(n)
        self.seconds_per_cell()  # pages, and the plan, come into being

    def seconds_per_cell(self, clock: Callable[[], float] = perf_counter) -> float:
        start = clock()
        by_sine_transform(self._f, self._inverse)
        return (clock() - start) / self.cells

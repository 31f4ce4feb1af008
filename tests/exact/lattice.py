"""The exact potential of charge on an infinite lattice: convolution with the lattice Green's function by FFT."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import scipy.fft
from scipy.special import ive


def green(reach: Sequence[int], spacing: Sequence[float] = (1.0, 1.0, 1.0)) -> np.ndarray:
    """Lattice Green's function over the cell volume, offsets 0 .. reach: the integral of three heat kernels over time."""
    x, w = np.polynomial.legendre.leggauss(12)
    x, w = (x + 1) / 2, w / 2
    h = np.asarray(spacing)
    enough = 4 * max((n + 1) * d for n, d in zip(reach, h, strict=True)) ** 2 + 64 * max(h) ** 2
    times, weights = [], []
    start, length = 0.0, 0.25 * min(h) ** 2
    while start < enough:
        times.append(start + length * x)
        weights.append(length * w)
        start, length = start + length, start + length
    tail = start**-0.5 * x
    time = np.concatenate([*times, tail**-2])
    weight = np.concatenate([*weights, start**-0.5 * w * 2 * tail**-3])
    kernels = [heat_kernel(n, 2 * time / d**2) for n, d in zip(reach, h, strict=True)]
    plane = np.einsum("jt,kt->jkt", kernels[1], kernels[2] * weight)
    return np.tensordot(kernels[0], plane, axes=(1, 2)) / np.prod(h)


def heat_kernel(reach: int, x: np.ndarray) -> np.ndarray:
    """exp(-x) I_n(x) for n = 0 .. reach, (reach + 1, x.size); by its asymptotic series where ive loses its digits."""
    n = np.arange(reach + 1)[:, None]
    far = x > max(1e4, 20.0 * reach**2)
    series, term = np.ones((reach + 1, x.size)), np.ones((reach + 1, x.size))
    for k in range(1, 16):
        term = term * -(4.0 * n**2 - (2 * k - 1) ** 2) / (8 * k * np.maximum(x, 1e3))
        series += term
    return np.where(far, series / np.sqrt(2 * np.pi * x), ive(n, np.where(far, 1.0, x)))


class FreeLattice:
    """Potential of charges on the cells of a box, on these cells and the ghost cells around them."""

    def __init__(self, cells: Sequence[int], spacing: Sequence[float] = (1.0, 1.0, 1.0)) -> None:
        self.cells = cells
        self.shape = [scipy.fft.next_fast_len(2 * n + 4, real=True) for n in cells]
        offsets = [
            np.minimum(np.minimum(i := np.arange(m), m - i), n + 1) for m, n in zip(self.shape, cells, strict=True)
        ]
        table = green([n + 1 for n in cells], spacing)
        self.kernel = scipy.fft.rfftn(table[np.ix_(*offsets)])

    def __call__(self, charges: np.ndarray) -> np.ndarray:
        padded = np.zeros(self.shape)
        padded[tuple(slice(1, n + 1) for n in self.cells)] = charges
        potential = scipy.fft.irfftn(scipy.fft.rfftn(padded) * self.kernel, s=self.shape)
        return potential[tuple(slice(0, n + 2) for n in self.cells)]

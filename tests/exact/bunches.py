"""Exact fields of bunches in free space, and quiet particles of them."""

from __future__ import annotations

import numpy as np
from scipy.special import ndtri
from scipy.stats import qmc

from amrpic.units import VACUUM_PERMITTIVITY

NODES = 200  # of Gauss's rule over q in [0, inf)


def quiet_gaussian(number: int, sizes: np.ndarray, seed: int = 1) -> np.ndarray:
    """Places (n, 3) of a normal distribution with these rms sizes, by Sobol's points; n a power of two."""
    return ndtri(_points(number, seed)) * sizes


def quiet_ellipsoid(number: int, axes: np.ndarray, seed: int = 1) -> np.ndarray:
    """Places (n, 3) that fill an ellipsoid with these half axes evenly, by Sobol's points; n a power of two."""
    u = _points(number, seed)
    height, angle = 2 * u[:, 1] - 1, 2 * np.pi * u[:, 2]
    across = np.sqrt(1 - height**2)
    return u[:, :1] ** (1 / 3) * np.stack([across * np.cos(angle), across * np.sin(angle), height], axis=1) * axes


def gaussian_field(places: np.ndarray, sizes: np.ndarray, charge: float) -> np.ndarray:
    """E (n, 3) in V/m at places (n, 3) of a normal distribution at rest: E = Q/(4 π^1.5 ε₀) ∫ Π exp(−x²/a)/√a 2x/a dq,
    a = 2σ² + q (O. D. Kellogg, "Foundations of potential theory", VII.6)."""
    out = np.zeros_like(places)
    for q, width in _over_q(2 * sizes**2):
        a = 2 * sizes**2 + q
        out += width * (np.exp(-(places**2 / a).sum(axis=1)) / np.sqrt(a.prod()))[:, None] * 2 * places / a
    return charge / (4 * np.pi**1.5 * VACUUM_PERMITTIVITY) * out


def ellipsoid_field(places: np.ndarray, axes: np.ndarray, charge: float) -> np.ndarray:
    """E (n, 3) in V/m at places (n, 3) inside an ellipsoid that is filled evenly: linear in each coordinate."""
    factors = sum(width / ((axes**2 + q) * np.sqrt((axes**2 + q).prod())) for q, width in _over_q(axes**2))
    return 3 * charge / (8 * np.pi * VACUUM_PERMITTIVITY) * factors * places


def _points(number: int, seed: int) -> np.ndarray:
    return np.clip(qmc.Sobol(3, scramble=True, seed=seed).random(number), 1e-12, 1 - 1e-12)


def _over_q(squares: np.ndarray):
    nodes, weights = np.polynomial.legendre.leggauss(NODES)
    t, scale = (nodes + 1) / 2, squares.prod() ** (1 / 3)
    r = t / (1 - t)
    return zip(scale * r**2, scale * r / (1 - t) ** 2 * weights, strict=True)

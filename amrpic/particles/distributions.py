"""Distributions of phase space in unit form.

Each function takes `DRAWS` rows of numbers in (0, 1), (7, n), and returns x, y, z, p_x, p_y, p_z, (6, n): every coordinate with
mean 0 and variance 1, no two of them correlated. `phase_space` gives them their sizes. They are smooth maps of the unit cube
wherever they can be, so that quasi-random numbers stay quiet. Fourth moments <x^4> are stated; that of a normal one is 3.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
import scipy

from .thermal_equilibrium import squared_radius

DRAWS = 7
SHORT = 0.02  # below it the difference of two terms loses more digits than a series


def gaussian(u: np.ndarray) -> np.ndarray:
    """Normal along all axes."""
    return scipy.special.ndtri(u[:6])


def cut_gaussian(u: np.ndarray, cutoff: Sequence[float]) -> np.ndarray:
    """Normal along all axes, x, y and z within `cutoff` (3,) of 0: their variance is `cut_rms`². Momenta are whole."""
    most = np.array(cutoff)[:, None]
    tails = scipy.special.ndtr(-most)
    places = np.clip(scipy.special.ndtri(tails + (1 - 2 * tails) * u[:3]), -most, most)
    return np.concatenate([places, scipy.special.ndtri(u[3:6])])


def cut_rms(cutoff: float) -> float:
    """Return the rms of a normal number of variance 1 that is within `cutoff` of 0."""
    if cutoff < SHORT:  # nearly even; the next term is of the order of cutoff⁴
        return cutoff / math.sqrt(3) * (1 - cutoff**2 / 15)
    inside = math.erf(cutoff / math.sqrt(2))
    return math.sqrt(1 - math.sqrt(2 / math.pi) * cutoff * math.exp(-(cutoff**2) / 2) / inside)


def ball(u: np.ndarray) -> np.ndarray:
    """Constant density in the ball of radius sqrt(5), for <x^2> = R^2 / 5; normal momenta. <x^4> = 15 / 7."""
    return _isotropic(np.sqrt(5) * np.cbrt(u[0]), u)


def parabolic(u: np.ndarray) -> np.ndarray:
    """Density 1 - r^2 / 7 in the ball of radius sqrt(7), for <x^2> = R^2 / 7; normal momenta. <x^4> = 7 / 3."""
    return _isotropic(
        np.sqrt(7 * scipy.special.betaincinv(1.5, 2, u[0])), u
    )  # (r / R)^2 has the beta distribution of 3/2 and 2


def shell(u: np.ndarray, inner: float) -> np.ndarray:
    """Constant density between the spheres of radius a R and R; normal momenta.

    <x^2> = R^2 / 5 (1 - a^5) / (1 - a^3), <x^4> = 3 R^4 / 35 (1 - a^7) / (1 - a^3), with a = `inner` in [0, 1).
    """
    return _isotropic(shell_radius(inner) * np.cbrt(inner**3 + (1 - inner**3) * u[0]), u)


def shell_radius(inner: float) -> float:
    """Return the outer radius of the unit shell."""
    return float(np.sqrt(5 * (1 - inner**3) / (1 - inner**5)))


def tube(u: np.ndarray, inner: float) -> np.ndarray:
    """Constant density between the cylinders of radius a R and R around z, R^2 = 4 / (1 + a^2), and |z| < sqrt(3).

    <x^4> = R^4 (1 + a^2 + a^4) / 8, <z^4> = 9 / 5; normal momenta.
    """
    x, y = _polar(tube_radius(inner) * np.sqrt(inner**2 + (1 - inner**2) * u[0]), u[1])
    return np.stack([x, y, _even(u[2]), *scipy.special.ndtri(u[3:6])])


def tube_radius(inner: float) -> float:
    """Return the outer radius of the unit tube."""
    return float(2 / np.sqrt(1 + inner**2))


def kapchinsky_vladimirsky(u: np.ndarray, normal_z: bool) -> np.ndarray:
    """Constant density on the sphere of radius 2 in (x, p_x, y, p_y); z even in |z| < sqrt(3), or normal; p_z normal.

    Any projection onto two of the four coordinates fills a disc of radius 2 evenly. <x^4> = 2, <x^2 y^2> = 2 / 3.
    """
    x, px = _polar(2 * np.sqrt(u[0]), u[1])  # the share of a plane in the squared radius is even in (0, 1)
    y, py = _polar(2 * np.sqrt(1 - u[0]), u[2])
    return np.stack([x, y, scipy.special.ndtri(u[3]) if normal_z else _even(u[3]), px, py, scipy.special.ndtri(u[4])])


def thermal(u: np.ndarray, depression: float) -> np.ndarray:
    """Thermal equilibrium of a continuous round beam with a tune depression in [0, 1]; z even in |z| < sqrt(3).

    Normal in x, y at 1, constant in a disc of radius 2 at 0; normal momenta. See `thermal_equilibrium`.
    """
    x, y = _polar(np.sqrt(squared_radius(depression)(u[0])), u[1])
    return np.stack([x, y, _even(u[2]), *scipy.special.ndtri(u[3:6])])


def waterbag(u: np.ndarray) -> np.ndarray:
    """Constant density in the six-dimensional ball of radius sqrt(8), for <x^2> = R^2 / 8. <x^4> = 12 / 5."""
    # The squared radii of the three planes fill a simplex evenly: cut its sum first, then the sum among the planes.
    total, cut = 8 * np.cbrt(u[0]), np.sqrt(u[1])
    squares = total * (1 - cut), total * cut * (1 - u[2]), total * cut * u[2]
    planes = [_polar(np.sqrt(square), u[3 + i]) for i, square in enumerate(squares)]
    return np.stack([plane[part] for part in (0, 1) for plane in planes])


def halo(u: np.ndarray, share: float, size: float) -> np.ndarray:
    """A normal core, and as a `share` of all a normal tail that is `size` times as large in all six coordinates.

    With the core's variance c = 1 / (1 + share (size^2 - 1)): <x^4> = 3 c^2 (1 + share (size^4 - 1)).
    """
    return halo_core(share, size) * np.where(u[6] < share, size, 1.0) * scipy.special.ndtri(u[:6])


def halo_core(share: float, size: float) -> float:
    """Return the rms size of the core as a part of that of core and tail together."""
    return float(1 / np.sqrt(1 + share * (size**2 - 1)))


def _isotropic(radius: np.ndarray, u: np.ndarray) -> np.ndarray:
    """Places at a distance from the origin in directions that are even over the sphere, by rows 1 and 2; normal momenta."""
    cosine = 2 * u[1] - 1
    x, y = _polar(radius * np.sqrt(1 - cosine**2), u[2])
    return np.stack([x, y, radius * cosine, *scipy.special.ndtri(u[3:6])])


def _polar(radius: np.ndarray, turn: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    return radius * np.cos(2 * np.pi * turn), radius * np.sin(2 * np.pi * turn)


def _even(u: np.ndarray) -> np.ndarray:
    """Even in (-sqrt(3), sqrt(3)), which has variance 1."""
    return np.sqrt(3) * (2 * u - 1)

"""Momenta with which particles leave a surface.

Each function takes three rows of numbers in (0, 1), (3, n), and returns momenta in kg m/s, (3, n): along the normal that points
away from the surface, and along two axes across it. MTE is the mean transverse energy, <p_x² + p_y²> / 2m.
"""

from __future__ import annotations

import math

import numpy as np
import scipy


def thermal(u: np.ndarray, energy: float, mass: float) -> np.ndarray:
    """Flux of a Maxwellian with the temperature `energy` = kT (J): p_n = √(-2 m kT ln u), normal across. MTE = <E_n> = kT."""
    size = math.sqrt(mass * energy)
    return size * np.stack([np.sqrt(-2 * np.log(u[0])), *scipy.special.ndtri(u[1:3])])


def isotropic(u: np.ndarray, energy: float, mass: float) -> np.ndarray:
    """One kinetic energy (J), as many in each direction away from the surface. MTE = 2/3 of the energy."""
    return _towards(math.sqrt(2 * mass * energy), u[0], u[1])


def lambert(u: np.ndarray, energy: float, mass: float) -> np.ndarray:
    """One kinetic energy (J), directions by Lambert's cosine law. MTE = half of the energy."""
    return _towards(math.sqrt(2 * mass * energy), np.sqrt(u[0]), u[1])


def three_step(u: np.ndarray, photon: float, work: float, fermi: float, mass: float) -> np.ndarray:
    """Photo-emission from a metal at T = 0 in three steps: D. H. Dowell, J. F. Schmerge, PRSTAB 12, 074201 (2009).

    Energies in J: of the photons, the work function as the field lowers it, and the Fermi energy. Inside, electrons fill
    s² = E from E_F + work to E_F + photon evenly in E, and leave if s cosθ > s0. MTE = (photon - work) / 3, if that is small
    against E_F.
    """
    least, most = math.sqrt(fermi + work), math.sqrt(fermi + photon)
    s = least + np.sqrt(u[0]) * (most - least)
    cosine = least / s + (1 - least / s) * u[1]
    normal = np.sqrt(np.maximum((s * cosine) ** 2 - least**2, 0.0))
    across = s * np.sqrt(1 - cosine**2)
    turn = 2 * np.pi * u[2]
    return math.sqrt(2 * mass) * np.stack([normal, across * np.cos(turn), across * np.sin(turn)])


def _towards(size: float, cosine: np.ndarray, turn: np.ndarray) -> np.ndarray:
    across = size * np.sqrt(1 - cosine**2)
    return np.stack([size * cosine, across * np.cos(2 * np.pi * turn), across * np.sin(2 * np.pi * turn)])

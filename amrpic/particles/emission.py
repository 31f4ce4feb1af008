"""How particles leave a surface: with which momenta, and in which current.

Each function of momenta takes three rows of numbers in (0, 1), (3, n), and returns momenta in kg m/s, (3, n): along the normal
that points away from the surface, and along two axes across it. MTE is the mean transverse energy, <p_x² + p_y²> / 2m.
"""

from __future__ import annotations

import math

import numpy as np
import scipy

from ..units import BOLTZMANN, ELEMENTARY_CHARGE, VACUUM_PERMITTIVITY

RICHARDSON = 1.20173e6  # A/(m² K²), 4π e m k² / h³
FIRST, SECOND = 1.541434e-6, 6.830890e9  # A eV/V² and V/(m eV^(3/2)): of Fowler and Nordheim


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


def richardson(temperature: float, work: float, pull: np.ndarray) -> np.ndarray:
    """Current density in A/m² of a surface at a temperature (K), whose work function (J) a field (V/m) that pulls lowers.

    Richardson and Dushman's law, with the lowering e √(e E / 4πε₀) by Schottky.
    """
    lowered = np.sqrt(ELEMENTARY_CHARGE**3 * np.maximum(pull, 0.0) / (4 * math.pi * VACUUM_PERMITTIVITY))
    return RICHARDSON * temperature**2 * np.exp(-(work - lowered) / (BOLTZMANN * temperature))


def fowler_nordheim(work: float, pull: np.ndarray) -> np.ndarray:
    """Current density in A/m² that a field (V/m) pulls out of a cold surface with a work function (J).

    With the barrier functions of R. G. Forbes, Appl. Phys. Lett. 89, 113122 (2006): v = 1 - f + f ln(f) / 6.
    """
    phi, field = work / ELEMENTARY_CHARGE, np.maximum(pull, 1.0)
    f = np.minimum(1.439964e-9 * field / phi**2, 1.0)
    v, t = 1 - f + f * np.log(f) / 6, 1 + f / 9 - f * np.log(f) / 18
    return np.where(pull > 1.0, FIRST * field**2 / (phi * t**2) * np.exp(-v * SECOND * phi**1.5 / field), 0.0)

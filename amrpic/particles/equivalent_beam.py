"""The self-field of the uniform beam that has the same rms sizes, which stands for any beam in the second moments (F. Sacherer,
IEEE Trans. Nucl. Sci. 18 (1971) 1105)."""

from __future__ import annotations

import math

import scipy

from ..units import SPEED_OF_LIGHT, VACUUM_PERMITTIVITY


def line_gradient(charge: float, size: float, across: float) -> float:
    """Return E_x / x, V/m², in a uniform elliptic cylinder of so much charge per length (C/m).

    `size` and `across` are its rms sizes along x and y, m: half of its half axes.
    """
    return charge / (4 * math.pi * VACUUM_PERMITTIVITY * size * (size + across))


def ellipsoid_gradient(charge: float, size: float, across: float, along: float) -> float:
    """Return E_x / x, V/m², in a uniform ellipsoid at rest, of a charge (C) and rms sizes along x, y and z, m.

    Its half axes are √5 times as long (O. D. Kellogg, Foundations of Potential Theory, 1929, chapter VII, with Carlson's R_D).
    """
    return (
        charge
        / (4 * math.pi * VACUUM_PERMITTIVITY * 5**1.5)
        * float(scipy.special.elliprd(across**2, along**2, size**2))
    )


def tune_depression(emittance: float, size: float, gradient: float, charge: float, mass: float, gamma: float) -> float:
    """Return k/k0, the wave numbers with and without self-field, of the beam that is matched with these moments.

    Of a normalised rms `emittance` (m rad) and an rms `size` (m), whose self-force per length is `charge` (C) × `gradient`
    (V/m²), and particles of a `mass` (kg); from the envelope equation at rest, k0² <x²> = ε²/<x²> + <x F_x>/(γ m v²) with
    k = ε/<x²>. nan without emittance and self-force.
    """
    cold = charge * gradient * gamma * size**4 / (mass * SPEED_OF_LIGHT**2)
    total = emittance**2 + cold
    return emittance / math.sqrt(total) if total > 0 else math.nan

"""The uniform beam that stands for another one: its field satisfies Gauss's law, and long ones are alike."""

from __future__ import annotations

import numpy as np
import pytest

from amrpic.particles.thermal_equilibrium import ellipsoid_gradient, line_gradient, tune_depression
from amrpic.units import ELECTRON_MASS, ELEMENTARY_CHARGE, SPEED_OF_LIGHT, VACUUM_PERMITTIVITY

SIZES = (1e-3, 2.5e-3, 0.7e-3)  # m, rms


def test_divergence_of_the_field_is_the_density():
    x, y, z = SIZES
    of_cylinder = line_gradient(1e-10, x, y) + line_gradient(1e-10, y, x)
    assert of_cylinder == pytest.approx(1e-10 / (np.pi * 4 * x * y) / VACUUM_PERMITTIVITY, rel=1e-12)
    of_ellipsoid = sum(ellipsoid_gradient(1e-12, *np.roll(SIZES, -d)) for d in range(3))
    volume = 4 / 3 * np.pi * 5**1.5 * x * y * z
    assert of_ellipsoid == pytest.approx(1e-12 / volume / VACUUM_PERMITTIVITY, rel=1e-12)


def test_middle_of_a_long_ellipsoid_is_a_cylinder():
    """Of 3 Q / (4 c) per length and the half axes √5 σ, which a cylinder with σ' = √5 σ / 2 has."""
    x, y, long = *SIZES[:2], 10.0
    shorter = np.sqrt(5) / 2
    cylinder = line_gradient(3 * 1e-12 / (4 * np.sqrt(5) * long), shorter * x, shorter * y)
    assert ellipsoid_gradient(1e-12, x, y, long) == pytest.approx(cylinder, rel=1e-5)


def test_tune_depression_is_that_of_the_envelope_at_rest():
    """k0² <x²> = k² <x²> + x F / (γ m v²) with the momentum β γ m c, k = ε / (β γ <x²>)."""
    emittance, size, gradient, u = 2e-6, 1.3e-3, -4e4, 1.7
    gamma = np.hypot(1, u)
    k = emittance / (u * size**2)
    own = -ELEMENTARY_CHARGE * gradient / (ELECTRON_MASS * SPEED_OF_LIGHT**2 * u**2 / gamma)
    found = tune_depression(emittance, size, gradient, -ELEMENTARY_CHARGE, ELECTRON_MASS, gamma)
    assert found == pytest.approx(k / np.sqrt(k**2 + own), rel=1e-12)
    assert tune_depression(0.0, size, gradient, -ELEMENTARY_CHARGE, ELECTRON_MASS, gamma) == 0
    assert np.isnan(tune_depression(0.0, size, 0.0, -ELEMENTARY_CHARGE, ELECTRON_MASS, gamma))

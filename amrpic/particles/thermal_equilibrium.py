"""Beams in linear focusing: the gradient of their own field, their tune depression, and thermal equilibrium in it."""

from __future__ import annotations

import math
from collections.abc import Callable
from functools import lru_cache

import numpy as np
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


END = 45.0  # ψ where the density, e^-45, has ended
POINTS = 8001  # across the beam; its edge is a Debye length wide, and at `COLDEST` the beam 600 of them
COLDEST = 0.005  # tune depression below which the beam is uniform: its edge is thinner than 1/500 of its radius
SMALLEST = -700.0  # logarithm of δ
ROUNDING = 1e-9  # 4 S/T below which a beam is without self-field


def profile(log_delta: float) -> tuple[np.ndarray, np.ndarray]:
    """Return distances s from the axis and ψ there, (n,), for a logarithm of δ; ψ ends at `END`.

    Where ψ is small its equation is linear, and tolerances are relative: δ may be as small as numbers are.
    """
    delta = math.exp(log_delta)

    def change(s: float, y: np.ndarray) -> tuple[float, float]:
        psi, slope = y
        return slope, delta - math.expm1(-psi) - slope / s

    def end(_: float, y: np.ndarray) -> float:
        return y[0] - END

    end.terminal = True  # type: ignore[attr-defined]
    start = 1e-3 * min(1.0, 1 / math.sqrt(delta))
    first = (delta * start**2 / 4, delta * start / 2)  # ψ = δ s²/4 near the axis
    furthest = 2 * math.sqrt(END) + 2 * abs(log_delta) + 100
    solution = scipy.integrate.solve_ivp(
        change, (start, furthest), first, "DOP853", rtol=1e-10, atol=0, dense_output=True, events=end
    )
    s = np.linspace(start, solution.t[-1], POINTS)
    assert solution.sol is not None
    return np.append(0.0, s), np.append(0.0, solution.sol(s)[0])


def line_density(log_delta: float) -> float:
    """Return ∫ exp(-ψ) s ds."""
    s, psi = profile(log_delta)
    return float(scipy.integrate.cumulative_simpson(np.exp(-psi) * s, x=s)[-1])


@lru_cache(maxsize=16)
def squared_radius(depression: float) -> Callable[[np.ndarray], np.ndarray]:
    """Return r²/<x²> as a function of the share of the beam beyond r, in (0, 1), for a tune depression from 0 to 1."""
    if depression < COLDEST:
        return lambda beyond: 4 * (1 - beyond)
    target = 4 * (1 / depression**2 - 1)
    if target < ROUNDING:
        return lambda beyond: -2 * np.log(beyond)  # without self-field the density is normal
    s, psi = profile(
        scipy.optimize.brentq(lambda d: line_density(d) - target, SMALLEST, math.log(2 / target), xtol=1e-10)
    )
    density = np.exp(-psi) * s
    inwards = scipy.integrate.cumulative_simpson(density[::-1], x=-s[::-1])  # so that small ones are exact too
    share = inwards[::-1]
    mean_square = scipy.integrate.cumulative_simpson(density * s**2, x=s)[-1] / share[0]
    table = scipy.interpolate.PchipInterpolator(-np.log(share / share[0]), 2 * s[:-1] ** 2 / mean_square)
    return lambda beyond: table(-np.log(beyond))


def matched(
    focusing: float,
    self_force: float,
    *,
    size: float | None = None,
    emittance: float | None = None,
    depression: float | None = None,
) -> tuple[float, float]:
    """Return rms size (m) and temperature (J) of the matched beam that has one of them, or the tune depression.

    `focusing` is K in N/m, `self_force` S in J; `emittance` is sqrt(T <x²>), in sqrt(J) m. The temperature is negative where
    the size is less than that of the cold beam. All follow from K <x²> = T + S, the envelope equation at rest.
    """
    if emittance is not None:
        square = (self_force + math.sqrt(self_force**2 + 4 * focusing * emittance**2)) / (2 * focusing)
    elif depression is not None:
        square = self_force / (focusing * (1 - depression**2))
    else:
        assert size is not None
        square = size**2
    return math.sqrt(square), focusing * square - self_force

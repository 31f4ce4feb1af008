"""Thermal equilibrium of a continuous round beam in linear focusing, with its own field.

The density is n(0) exp(-ψ) with ψ = (K r²/2 + q φ(r)/γ²)/T: K the focusing in N/m, T the temperature γ m <v_x²> in J. With
r = s λ in Debye lengths, λ² = ε0 γ² T/(q² n(0)), Poisson's equation is (s ψ')'/s = 1 + δ - exp(-ψ), and δ > 0 alone
distinguishes beams (R. C. Davidson, H. Qin, Physics of Intense Charged Particle Beams, 2001; S. M. Lund, T. Kikuchi,
R. C. Davidson, Phys. Rev. ST Accel. Beams 12 (2009) 114801). By the virial theorem K <x²> = T + S for every δ, with
S = <x F_x> = q λ_q/(8π ε0 γ²) for its own field and the charge per length λ_q. So the tune depression k/k0, that of the KV beam
with the same rms size and emittance, is sqrt(T/(K <x²>)); it fixes ∫ exp(-ψ) s ds = 4 S/T = 4 ((k0/k)² - 1), and that fixes δ.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from functools import lru_cache

import numpy as np
import scipy

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

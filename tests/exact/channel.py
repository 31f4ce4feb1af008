"""A slab of a continuous electron beam in a focusing channel: its scene, and the envelope equation that it follows.

The slab lies in a square grounded pipe whose half width is 6 beam radii, and is periodic along z. Images are weak there: those
of a round beam vanish, those of an elliptic one are some 1e-3 of its own field.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.integrate import solve_ivp

from amrpic.particles.thermal_equilibrium import line_gradient
from amrpic.units import ELECTRON_MASS, ELEMENTARY_CHARGE, SPEED_OF_LIGHT

RADIUS = 1e-3  # m, of the uniform beam that has the matched rms size
PIPE = 6 * RADIUS
LENGTH = 0.6 * RADIUS
CELLS = (40, 40, 2)  # cubes
OMEGA = 1e9  # 1/s, of the oscillation without charge
PERIOD = 2 * math.pi / OMEGA
GRADIENT = -ELECTRON_MASS * OMEGA**2 / ELEMENTARY_CHARGE  # V/m²: constant focusing with OMEGA of particles at rest
DEPRESSION = 0.5

Focusing = Callable[[float], tuple[float, float]]  # squares of the frequencies along x and y, 1/s², at a time in s


def constant(time: float) -> tuple[float, float]:
    return OMEGA**2, OMEGA**2


@dataclass(frozen=True)
class Envelope:
    """A beam that follows the envelope equation σ'' + ω²(t) σ = q E_x / (γ³ m) + ε²/σ³ along x and y, primes being d/dt."""

    start: tuple[float, float]  # m: rms sizes along x and y at the start, where they do not change
    emittance: float  # m²/s: rms size times rms velocity at the waist
    charge: float  # C/m, of electrons
    gamma: float = 1.0

    def at(self, times: np.ndarray, focusing: Focusing, step: float = np.inf) -> np.ndarray:
        """Return rms sizes and their derivatives (x, y, x', y') at times, (4, n); integrated by steps of at most `step` s."""
        strength = -ELEMENTARY_CHARGE / (self.gamma**3 * ELECTRON_MASS)

        def change(time: float, s: np.ndarray) -> list[float]:
            x, y = s[:2]
            inwards = focusing(time)
            outwards = (strength * line_gradient(self.charge, *pair) for pair in ((x, y), (y, x)))
            pressure = (self.emittance**2 / size**4 for size in (x, y))
            rates = (o + p - i for o, p, i in zip(outwards, pressure, inwards, strict=True))
            return [s[2], s[3], *(rate * size for rate, size in zip(rates, (x, y), strict=True))]

        span = (times[0], times[-1])
        return solve_ivp(
            change, span, [*self.start, 0, 0], t_eval=times, max_step=step, rtol=1e-9, atol=1e-12 * RADIUS
        ).y

    def bunch(self, particles: int) -> dict[str, Any]:
        """The KV beam of this envelope at its start, as a section of a scene."""
        normalised = self.gamma * self.emittance / SPEED_OF_LIGHT
        # The same temperature along z as across: a beam that is cold along z is unstable (E. G. Harris, Phys. Rev. Lett. 2
        # (1959) 34), and at a tune depression of 0.5 loses 2 % of its transverse emittance within four periods.
        along = LENGTH / math.sqrt(12)
        x, y = ({"sigma": size, "emittance": normalised} for size in self.start)
        z = {"sigma": along, "emittance": normalised * self.gamma * along / math.sqrt(self.start[0] * self.start[1])}
        return {
            "distribution": "kv",
            "species": "electron",
            "charge": self.charge * LENGTH,
            "particles": particles,
            "sampling": "sobol",
            "twiss": {"x": x, "y": y, "z": z},
        }


def matched(depression: float = DEPRESSION) -> Envelope:
    """The round beam at rest of RADIUS in constant focusing: its own field takes 1 - η² of it, and the frequency is η OMEGA."""
    size = RADIUS / 2
    return Envelope(
        (size, size), depression * OMEGA * size**2, (1 - depression**2) * GRADIENT / line_gradient(1.0, size, size)
    )


def thermal(particles: int, length: float = LENGTH, mismatch: float = 1.0) -> dict[str, Any]:
    """The thermal beam of the same charge per length in constant focusing, as a section of a scene."""
    return {
        "distribution": "thermal",
        "species": "electron",
        "charge": matched().charge * length,
        "gradient": GRADIENT,
        "length": length,
        "tune_depression": DEPRESSION,
        "mismatch": mismatch,
        "particles": particles,
        "sampling": "sobol",
    }


def slab(
    bunches: list[dict[str, Any]],
    elements: Sequence[Mapping[str, Any]],
    dt: float,
    steps: int,
    levels: int,
    motion: Mapping[str, Any] | None = None,
) -> dict[str, Any]:
    """A scene of beams in the pipe, refined where charge is."""
    reach = (PIPE, PIPE, LENGTH / 2)
    return {
        "domain": {
            "lower": [-a for a in reach],
            "upper": list(reach),
            "cells": list(CELLS),
            "boundary": {"x": "dirichlet", "y": "dirichlet", "z": "periodic"},
        },
        "bunches": bunches,
        "elements": list(elements),
        "refinement": {"levels": levels, "regrid_every": 10, "rule": {"kind": "charge-density", "relative": 0.02}},
        "solver": {"tolerance": "discretization"},
        "motion": {"kind": "leapfrog", "dt": dt, **(motion or {})},
        "schedule": {"steps": steps},
    }


FOCUSING = {"kind": "constant-focusing", "gradient": [GRADIENT, GRADIENT, 0.0]}

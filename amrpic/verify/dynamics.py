"""Moving particles: single ones, bunches that their own charge drives apart, fast ones, and waves in a plasma."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np
from mpi4py import MPI
from scipy.integrate import solve_ivp

from ..particles.equivalent_beam import ellipsoid_gradient
from ..units import ELECTRON_MASS, ELEMENTARY_CHARGE, SPEED_OF_LIGHT
from . import beam_line, envelopes, halo, mismatch, orbits, passages, plasma, thermal, two_frames
from .runs import collected, end
from .sources import EPS0, Gaussian
from .table import Cell, Goal, Table

CHARGE = -10e-12  # C
PARTICLES = 200_000
STEPS = 100
EDGE = 0.999  # of the particles
SPHERE = (1e-3, 1e-3, 1e-3)  # m, half axes
ELLIPSOID = (1e-3, 1e-3, 3e-3)
BASES = (32, 64, 96)


def tables(comm: MPI.Comm) -> Iterator[Table]:
    """The tables of this topic. Collective."""
    yield from orbits.tables(comm)
    yield from passages.tables(comm)
    yield _explosions(comm)
    yield Table(
        "Field of a fast bunch",
        "Gaussian electron bunch, σ = 1 mm in the laboratory, 10⁶ quiet particles, one refined level: the largest error of "
        "each component of E and B within 2.5 σ, over the largest value of that component, against the exact field of the "
        "bunch at rest, boosted. The component of B along the motion is zero.",
        ("γ", "E_x", "E_y", "E_z", "B_x", "B_y", "cycles"),
        [_fast_bunches(comm, (gamma,)) for gamma in (2.0, 20.0, 100.0)],
    )
    yield Table(
        "Field of two bunches of different energy",
        "Two such bunches, one within the other, with half of the charge each: in two energy bins, against the sum of the "
        "exact fields of both. A minus is for one that moves downwards.",
        ("γ", "E_x", "E_y", "E_z", "B_x", "B_y", "cycles"),
        [_fast_bunches(comm, gammas) for gammas in ((4.0, 20.0), (8.0, -1.2))],
    )
    yield two_frames.table(comm)
    yield beam_line.table(comm)
    yield from plasma.tables(comm)
    yield envelopes.table(comm)
    yield thermal.table(comm)
    yield halo.table(comm)
    yield mismatch.table(comm)


# ---- explosion ----


def half_axes(start: Sequence[float], time: float) -> np.ndarray:
    """Half axes (m) of a uniform ellipsoid of electrons that starts at rest, after `time` s.

    It stays uniform, since E along an axis is linear.
    """

    def change(_: float, y: np.ndarray) -> np.ndarray:
        gradients = [ellipsoid_gradient(CHARGE, *(np.roll(y[:3], -d) / np.sqrt(5))) for d in range(3)]
        return np.concatenate([y[3:], -ELEMENTARY_CHARGE / ELECTRON_MASS * np.array(gradients) * y[:3]])

    return solve_ivp(change, (0, time), [*start, 0, 0, 0], rtol=1e-11, atol=1e-15).y[:3, -1]


def doubling_time(start: Sequence[float]) -> float:
    """About how long it takes, in s, until the ellipsoid is twice as large: some plasma periods' radians."""
    density = abs(CHARGE) / (4 / 3 * np.pi * np.prod(start))
    return 2.86 / float(np.sqrt(density * ELEMENTARY_CHARGE / (EPS0 * ELECTRON_MASS)))


def _explosions(comm: MPI.Comm) -> Table:
    rows: list[list[Cell]] = []
    curves: dict[str, tuple[list[float], list[float]]] = {}
    for name, start in (("sphere", SPHERE), ("3:1 ellipsoid", ELLIPSOID)):
        found = {cells: _explosion(comm, start, cells) for cells in BASES}
        for part in range(2):
            label = f"{name}, {('rms', 'edge')[part]}"
            curves[label] = (list(map(float, BASES)), [errors[part] for errors in found.values()])
        for cells, (rms, edge) in found.items():
            last = cells == BASES[-1]
            goal = Goal(edge, 0.01) if last and name == "sphere" else edge
            rows.append([name, f"{cells}³ + 1 level", Goal(rms, 5e-3) if last else rms, goal])
    return Table(
        "Coulomb explosion",
        f"{PARTICLES} electrons at rest, quiet, of 10 pC in a uniform ellipsoid with a half axis of 1 mm, until it is about "
        "twice as large, in free space; one level refined where charge is. Largest error of the rms sizes along the axes, and "
        f"of the elliptic radius that holds {EDGE:.1%} of the particles, against the exact law of a uniform ellipsoid.",
        ("bunch", "mesh", "rms", "edge"),
        rows,
        curves,
        upwards="relative error",
        by_line=True,
    )


def _explosion(comm: MPI.Comm, start: Sequence[float], cells: int) -> tuple[float, float]:
    """The errors of the rms sizes and of the edge."""
    time = doubling_time(start)
    exact = half_axes(start, time)
    reach = 1.25 * float(exact.max())
    state = end(
        comm,
        {
            "domain": {"lower": [-reach] * 3, "upper": [reach] * 3, "cells": cells},
            "bunches": [
                {
                    "distribution": "hollow",
                    "inner": 0.0,
                    "species": "electron",
                    "charge": CHARGE,
                    "particles": PARTICLES,
                    "sigma": [a / np.sqrt(5) for a in start],
                    "sampling": "sobol",
                }
            ],
            "refinement": {"levels": 1, "rule": {"kind": "charge-density", "relative": 0.05}},
            "motion": {"kind": "leapfrog", "dt": time / STEPS},
            "schedule": {"steps": STEPS},
        },
    )
    rms = state.moments().rms * np.sqrt(5) / exact
    radius = np.sort(np.linalg.norm(collected(comm, state.particles)[0] / exact, axis=1))
    edge = radius[int(EDGE * len(radius))] / EDGE ** (1 / 3)
    return float(np.abs(rms - 1).max()), abs(float(edge) - 1)


# ---- fast bunches ----


def _fast_bunches(comm: MPI.Comm, gammas: Sequence[float]) -> list[Cell]:
    """One or more in one place; a negative γ is that of a bunch that moves downwards."""
    sigma, charge = 1e-3, CHARGE / len(gammas)
    momenta = [float(np.copysign(np.sqrt(gamma**2 - 1), gamma)) for gamma in gammas]
    state = end(
        comm,
        {
            "domain": {"lower": [-5 * sigma] * 3, "upper": [5 * sigma] * 3, "cells": 64},
            "bunches": [
                {
                    "distribution": "gaussian",
                    "species": "electron",
                    "charge": charge,
                    "particles": 1_000_000 // len(gammas),
                    "sigma": sigma,
                    "momentum": [0.0, 0.0, momentum * ELECTRON_MASS * SPEED_OF_LIGHT],
                    "sampling": "sobol",
                }
                for momentum in momenta
            ],
            "refinement": {"levels": 1, "rule": {"kind": "charge-density", "relative": 0.02}},
            "motion": {"kind": "leapfrog", "dt": 1e-15},
        },
    )
    points = np.random.default_rng(1).uniform(-2.5 * sigma, 2.5 * sigma, (3, 5000))
    points = points[:, np.linalg.norm(points, axis=0) < 2.5 * sigma]
    electric, magnetic = np.zeros((points.shape[1], 3)), np.zeros((points.shape[1], 2))
    for momentum in momenta:
        gamma = float(np.hypot(1, momentum))
        at_rest = Gaussian((sigma, sigma, gamma * sigma), (0.0, 0.0, 0.0), charge)
        across_x, across_y, along = at_rest.field(points[0], points[1], gamma * points[2])
        own = np.stack([gamma * across_x, gamma * across_y, along], axis=1)
        electric += own
        magnetic += np.cross([0.0, 0.0, momentum / gamma / SPEED_OF_LIGHT], own)[:, :2]
    found = state.efield.sample(points.T), state.solution.bfield.sample(points.T)[:, :2]
    errors = [
        float(error)
        for values, exact in zip(found, (electric, magnetic), strict=True)
        for error in np.abs(values - exact).max(axis=0) / np.abs(exact).max(axis=0)
    ]
    return [", ".join(f"{gamma:g}" for gamma in gammas), *(Goal(error, 0.01) for error in errors), state.report.cycles]

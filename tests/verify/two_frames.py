"""One expanding bunch in two frames: its own, and the laboratory, where it is fast."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from mpi4py import MPI

from amrpic.units import ELECTRON_MASS, SPEED_OF_LIGHT
from amrpic.verify.table import Goal, Table, picture
from exact.runs import states

GAMMA = 20.0
SIGMA = (1e-3, 1e-3, 3e-3)  # m, at rest
STEPS = 60
PROPER_TIME = 1.2e-9  # s


def table(comm: MPI.Comm) -> Table:
    """Rms sizes of the bunch in both frames. Collective."""
    at_rest = sizes(comm, 1.0)
    fast = sizes(comm, GAMMA) * (1, 1, GAMMA)
    errors, growth = np.abs(fast / at_rest - 1).max(axis=0), at_rest[-1] / at_rest[0]

    def draw(path: Path) -> None:
        time = np.linspace(0, PROPER_TIME * 1e9, STEPS + 1)
        with picture(path, "One bunch in two frames", "proper time, ns", "rms size at rest, mm") as axes:
            for d, name in enumerate("xz"):
                axes.plot(time, at_rest[:, 2 * d] * 1e3, f"C{d}-", label=f"{name}, at rest")
                axes.plot(time[::4], fast[::4, 2 * d] * 1e3, f"C{d}o", markersize=4, label=f"{name}, γ = {GAMMA:g}")

    return Table(
        "One bunch in two frames",
        f"A cold Gaussian bunch of 200000 quiet electrons, 10 pC, at rest 1 × 1 × 3 mm, expands in free space by its own field "
        f"for {PROPER_TIME * 1e9:g} ns of its own time: once at rest, and once in the laboratory at γ = {GAMMA:g}, where "
        "lengths along z are γ times shorter, steps γ times longer, its magnetic field acts too, and the window goes along. "
        "Largest difference of the rms sizes at equal proper time. Particles a length z' apart come to that time z'/c apart, "
        "which counts in second order of the speed of expansion over c.",
        ("axis", "growth", "difference"),
        [[axis, growth[d], Goal(errors[d], 0.01)] for d, axis in enumerate("xyz")],
        upwards="rms sizes",
        picture=draw,
    )


def sizes(comm: MPI.Comm, gamma: float, cells: int = 48, particles: int = 200_000, steps: int = STEPS) -> np.ndarray:
    """Rms sizes (steps + 1, 3) in m of the bunch with this Lorentz factor along z, at equal proper times. Collective."""
    return np.array([state.moments().rms for state in states(comm, _scene(gamma, cells, particles, steps))])


def _scene(gamma: float, cells: int, particles: int, steps: int) -> dict[str, Any]:
    squeezed = np.array(SIGMA) / (1, 1, gamma)
    reach = (7 * squeezed).tolist()
    fast = {"frame": "rest", "window": "reference"} if gamma > 1 else {}
    return {
        "domain": {"lower": [-r for r in reach], "upper": reach, "cells": cells},
        "bunches": [
            {
                "distribution": "gaussian",
                "species": "electron",
                "charge": -10e-12,
                "particles": particles,
                "sigma": squeezed.tolist(),
                "momentum": [0.0, 0.0, np.sqrt(gamma**2 - 1) * ELECTRON_MASS * SPEED_OF_LIGHT],
                "sampling": "sobol",
            }
        ],
        "refinement": {"levels": 1, "rule": {"kind": "charge-density", "relative": 0.05}},
        "motion": {"kind": "leapfrog", "dt": gamma * PROPER_TIME / steps, **fast},
        "schedule": {"steps": steps},
    }

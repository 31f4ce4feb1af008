"""KV beams against the envelope equation, in constant focusing and in a lattice of quadrupoles."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from mpi4py import MPI
from scipy.linalg import expm
from scipy.optimize import brentq, root

from amrpic.units import ELECTRON_MASS, ELEMENTARY_CHARGE, SPEED_OF_LIGHT
from amrpic.verify.table import Cell, Goal, Table, picture
from exact.channel import (
    DEPRESSION,
    FOCUSING,
    LENGTH,
    OMEGA,
    PERIOD,
    RADIUS,
    Envelope,
    Focusing,
    constant,
    matched,
    slab,
)
from exact.runs import states

PARTICLES = 1_000_000
PERIODS = 20
LEVELS = 3
MISMATCH = 1.1

# The lattice: focusing and defocusing quadrupoles in turns, the slab starts in the middle of a focusing one.
BETA = 0.5
GAMMA = 1 / math.sqrt(1 - BETA**2)
SPEED = BETA * SPEED_OF_LIGHT
ADVANCE = math.radians(60)  # of the phase per cell without charge
CELL_TIME = ADVANCE / OMEGA  # so that it is OMEGA on average
CELL = SPEED * CELL_TIME  # m
FILLED = 0.5  # of the length by quadrupoles


@dataclass(frozen=True)
class Channel:
    """A channel, the beam in it, and the runs of it."""

    name: str
    beam: Envelope
    focusing: Focusing
    period: float  # s
    steps: int  # a period
    elements: Sequence[Mapping[str, Any]]
    motion: Mapping[str, Any]
    moving: Mapping[str, Any]  # of the bunch


def table(comm: MPI.Comm) -> Table:
    """Largest errors of the envelopes. Collective."""
    channels = constant_focusing(), lattice()
    found = {channel.name: _run(comm, channel) for channel in channels}
    rows: list[list[Cell]] = [
        [name, Goal(float(np.abs(measured / exact - 1).max()), 0.01), float(np.abs(emittance / emittance[0] - 1).max())]
        for name, (_, measured, exact, emittance) in found.items()
    ]
    return Table(
        "Envelopes of a KV beam",
        f"Slab of {PARTICLES} electrons, {LENGTH / RADIUS:.2g} beam radii long, periodic along z, in a square grounded pipe "
        "of a half width of 6 beam radii, tune depression 0.5, the same temperature along z as across: at rest in constant "
        f"focusing, {MISMATCH:g} times as large as the matched beam, and matched at {BETA:g} c through quadrupoles with hard "
        f"edges, 60° of phase per cell without charge, {CELL / LENGTH:.0f} slabs to a cell, the window going with it; "
        f"{LEVELS} refined levels. Largest relative error of the rms sizes along x and y over {PERIODS} periods of the "
        "focusing, against the envelope equation, and change of the emittances.",
        ("channel", "envelopes", "emittances"),
        rows,
        upwards="rms sizes",
        picture=partial(_draw, found),
    )


def _run(comm: MPI.Comm, channel: Channel) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Times in periods, and rms sizes as measured and by the equation and emittances, (n, 2)."""
    dt, steps = channel.period / channel.steps, channel.steps * PERIODS
    bunch = {**channel.beam.bunch(PARTICLES), **channel.moving}
    scene = slab([bunch], channel.elements, dt, steps, LEVELS, channel.motion)
    moments = [state.moments() for state in states(comm, scene)]
    times = np.arange(steps + 1) * dt
    exact = channel.beam.at(times, channel.focusing, step=dt / 4)[:2].T
    rms, emittance = (np.array([getattr(m, name)[:2] for m in moments]) for name in ("rms", "emittance"))
    return times / channel.period, rms, exact, emittance


def constant_focusing() -> Channel:
    """Constant focusing, with a beam that breathes."""
    beam = matched()
    larger = replace(beam, start=(MISMATCH * beam.start[0], MISMATCH * beam.start[1]))
    return Channel("constant focusing", larger, constant, PERIOD, 100, [FOCUSING], {}, {})


# ---- lattice ----


def lattice() -> Channel:
    """Quadrupoles, with the beam that is matched to them."""
    square = quadrupole_square()
    gradient = (
        -square * GAMMA * ELECTRON_MASS / (ELEMENTARY_CHARGE * SPEED)
    )  # T/m: electrons are focused by negative ones
    elements = [
        {
            "kind": "quadrupole",
            "centre": [0.0, 0.0, half * CELL / 2],
            "length": FILLED / 2 * CELL,
            "gradient": gradient * (-1) ** half,
        }
        for half in range(2 * PERIODS + 1)
    ]
    focusing = partial(alternating, square)
    velocity = {"velocity": [0.0, 0.0, SPEED]}
    return Channel(
        "quadrupoles", matched_to(focusing), focusing, CELL_TIME, 64, elements, {"window": "reference"}, velocity
    )


def alternating(square: float, time: float) -> tuple[float, float]:
    """Squares of the frequencies, 1/s²: those of the quadrupole that the beam is in, if it is in one."""
    half = time / (CELL_TIME / 2)
    if abs(half - round(half)) > FILLED / 2:
        return 0.0, 0.0
    sign = (-1) ** round(half)
    return sign * square, -sign * square


def quadrupole_square() -> float:
    """Square of the frequency in a quadrupole, 1/s², for which the phase advances as wanted without charge."""

    def through(square: float, share: float) -> np.ndarray:
        return expm(np.array([[0.0, 1.0], [-square, 0.0]]) * share * CELL_TIME)

    def surplus(square: float) -> float:
        inside, half_drift = FILLED / 4, (1 - FILLED) / 2
        parts = (square, inside), (0.0, half_drift), (-square, 2 * inside), (0.0, half_drift), (square, inside)
        cell = np.linalg.multi_dot([through(*part) for part in parts])
        return float(np.trace(cell)) / 2 - math.cos(ADVANCE)

    return brentq(surplus, 0.0, 20 * OMEGA**2, rtol=1e-12)


def matched_to(focusing: Focusing) -> Envelope:
    """The periodic envelope whose phase advance is `DEPRESSION` of that without charge."""
    smooth = matched()
    times = np.linspace(0, CELL_TIME / 2, 401)

    def beam(unknown: np.ndarray) -> Envelope:
        x, y, charge = unknown
        return replace(smooth, start=(x * RADIUS, y * RADIUS), charge=charge * smooth.charge * GAMMA**3, gamma=GAMMA)

    def mistakes(unknown: np.ndarray) -> list[float]:
        x, _, *slopes = beam(unknown).at(times, focusing, step=times[1])
        advance = 2 * np.trapezoid(smooth.emittance / x**2, times)
        return [
            slopes[0][-1] / (RADIUS * OMEGA),
            slopes[1][-1] / (RADIUS * OMEGA),
            advance / (DEPRESSION * ADVANCE) - 1,
        ]

    return beam(root(mistakes, [0.6, 0.4, 1.0], tol=1e-10).x)


def _draw(found: Mapping[str, Sequence[np.ndarray]], path: Path) -> None:
    with picture(path, "Envelopes of a KV beam", "periods", "rms size over beam radius") as axes:
        for colour, (name, (times, measured, exact, _)) in enumerate(found.items()):
            for axis in range(2):
                axes.plot(times, exact[:, axis] / RADIUS, "k", linewidth=0.5)
                axes.plot(
                    times,
                    measured[:, axis] / RADIUS,
                    f"C{2 * colour + axis}o",
                    markersize=3,
                    markevery=(2 * axis, 5),
                    label=f"{name}, {'xy'[axis]}",
                )
        axes.plot([], [], "k", linewidth=0.5, label="envelope equation")
        axes.set_xlim(PERIODS - 5, PERIODS)  # where errors have grown

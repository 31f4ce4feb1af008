"""A lattice cell beside ImpactX: two doublets, a solenoid and two dipoles, with space charge and without."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping
from dataclasses import dataclass
from functools import partial
from importlib.resources import files
from pathlib import Path
from typing import Any

import numpy as np
from mpi4py import MPI

from amrpic.pic.state import State
from amrpic.units import ELECTRON_MASS, ELEMENTARY_CHARGE, SPEED_OF_LIGHT
from amrpic.verify.table import Cell, Goal, Table, picture
from exact.runs import collected, states

REFERENCE = "beam_line.json"  # written by `python benchmarks impactx_line`

BETA_GAMMA = 5.0
BETA = BETA_GAMMA / math.hypot(1, BETA_GAMMA)
MOMENTUM = BETA_GAMMA * ELECTRON_MASS * SPEED_OF_LIGHT
RIGIDITY = -MOMENTUM / ELEMENTARY_CHARGE  # p/q of electrons, T m
PARTICLES = 100_000
CHARGES = {"without": -1e-25, "with": -20e-12}  # space charge: C of the bunch
BUNCH = {
    "distribution": "gaussian",
    "species": "electron",
    "sigma": [1e-3, 1e-3, 0.5e-3],
    "momentum": [0.0, 0.0, MOMENTUM],
    "momentum_spread": [4e-4 * MOMENTUM, 4e-4 * MOMENTUM, 3e-3 * MOMENTUM],
    "sampling": "sobol",
}
SIZES, MEASURED = ("x", "y", "z"), ("x", "y", "z", "emittance_x", "emittance_y", "spread")


@dataclass(frozen=True)
class Piece:
    """A piece of the line along the path of the reference particle; where a drift ends there may be a screen."""

    kind: str  # "drift", "quadrupole", "solenoid" or "dipole"
    length: float  # m, along the path
    strength: float = 0.0  # q/p times gradient in 1/m² or field in 1/m; of a dipole the angle towards -x, rad
    screen: str = ""


CELL = (
    Piece("drift", 0.1, screen="entrance"),
    Piece("quadrupole", 0.1, 9.0),
    Piece("drift", 0.15),
    Piece("quadrupole", 0.1, -9.0),
    Piece("drift", 0.1, screen="doublet"),
    Piece("drift", 0.05),
    Piece("solenoid", 0.2, 1.8),
    Piece("drift", 0.1, screen="solenoid"),
    Piece("drift", 0.05),
    Piece("dipole", 0.15, math.radians(15)),
    Piece("drift", 0.2),
    Piece("dipole", 0.15, -math.radians(15)),
    Piece("drift", 0.1, screen="dipoles"),
    Piece("quadrupole", 0.1, 9.0),
    Piece("drift", 0.15),
    Piece("quadrupole", 0.1, -9.0),
    Piece("drift", 0.2, screen="exit"),
)
LENGTH = sum(piece.length for piece in CELL)
AFTER = 0.02  # m, that all particles may pass the last screen


def table(comm: MPI.Comm) -> Table:
    """Differences at the screens. Collective."""
    peer = reference()
    found = {name: along(comm, charge) for name, charge in CHARGES.items()}
    rows: list[list[Cell]] = []
    for name in CHARGES:
        for screen, path in screens().items():
            ours, theirs = found[name].screens[screen], at(peer[name], path)
            errors = [abs(ours[what] / theirs[what] - 1) for what in MEASURED]
            bounds = [0.01 if what in SIZES else 0.02 for what in MEASURED]
            growth = [theirs[what] / at(peer["without"], path)[what] for what in SIZES]
            passed = Goal(ours["passed"], PARTICLES, least=True)
            rows.append([name, screen, passed, *growth, *map(Goal, errors, bounds)])
    return Table(
        "A lattice cell beside ImpactX",
        f"Gaussian bunch of {PARTICLES} electrons, βγ = {BETA_GAMMA:g}, {abs(CHARGES['with']) * 1e12:g} pC, rms sizes 1 × 1 × "
        f"0.5 mm, momentum spread 0.3 %, through {LENGTH:.3g} m of magnets with hard edges: two doublets, between them a "
        "solenoid and two sector dipoles of ±15°. Here: steps of 1 cm, open faces, two refined levels in a window that turns "
        f"with the beam. There: the same particles in {peer['made by']}. Relative differences of rms sizes, normalised "
        "emittances and rms energy spread of what passes the screens; growth is that of ImpactX's sizes by space charge. "
        "Conventions: ImpactX's variable is the path s, so its bunch is always known as it passes a plane, here only at "
        "screens. Its t is c times how much later than the reference particle that is, so that the length z is β times rms t; "
        "its pt is how much less energy a particle has, over p c. The particles start at one time here, and are taken on "
        "straight lines to the plane z = 0, where they start there. The charge of a bunch is positive there for the sign of "
        "the reference particle, and a sector is a dipole here with both faces turned by minus half its angle. The picture "
        "has sizes at one time in the axes of the reference particle (lines) beside ImpactX's (circles). "
        "`make impactx` makes ImpactX's values anew.",
        (
            "space charge",
            "screen",
            "particles",
            *(f"{what} growth" for what in SIZES),
            "x",
            "y",
            "z",
            "emittance x",
            "emittance y",
            "energy spread",
        ),
        rows,
        upwards="rms sizes",
        picture=partial(_draw, found, peer),
    )


# ---- the line ----


def line() -> tuple[list[dict[str, Any]], dict[str, float]]:
    """Return the elements of a scene for the cell, and z in m of its screens; it begins at the origin, along z."""
    elements: list[dict[str, Any]] = []
    planes: dict[str, float] = {}
    place, angle = np.zeros(3), 0.0  # of the path, from z towards x
    for piece in CELL:
        turn = piece.strength if piece.kind == "dipole" else 0.0
        middle = angle - turn / 2  # direction of the chord
        chord = piece.length * np.sinc(turn / 2 / math.pi) * np.array([math.sin(middle), 0.0, math.cos(middle)])
        if piece.kind != "drift":
            elements.append(
                {
                    "kind": piece.kind,
                    "centre": (place + chord / 2).tolist(),
                    "direction": chord.tolist(),
                    "length": float(np.linalg.norm(chord)),
                    **_field(piece),
                }
            )
        place, angle = place + chord, angle - turn
        if piece.screen:
            planes[piece.screen] = float(place[2])
    return elements, planes


def _field(piece: Piece) -> dict[str, float]:
    """The keys of an element that its strength gives."""
    match piece.kind:
        case "quadrupole":
            return {"gradient": piece.strength * RIGIDITY}
        case "solenoid":
            return {"field": piece.strength * RIGIDITY}
    turned = -piece.strength / 2
    return {"field": piece.strength / piece.length * RIGIDITY, "entrance_angle": turned, "exit_angle": turned}


def screens() -> dict[str, float]:
    """Return the path s in m of each screen."""
    ends = np.cumsum([piece.length for piece in CELL])
    return {piece.screen: float(s) for piece, s in zip(CELL, ends, strict=True) if piece.screen}


def scene(charge: float, particles: int = PARTICLES, levels: int = 2, steps: int = 212) -> dict[str, Any]:
    """The scene of a bunch with this charge in C, 1 cm to a step."""
    elements, planes = line()
    reach = [10e-3, 12e-3, 4e-3]
    return {
        "domain": {"lower": [-r for r in reach], "upper": reach, "cells": 32},
        "bunches": [{**BUNCH, "charge": charge, "particles": particles}],
        "elements": elements,
        "screens": [{"name": name, "z": z} for name, z in planes.items()],
        "refinement": {"levels": levels, "rule": {"kind": "charge-density", "relative": 0.02}},
        "solver": {"tolerance": "discretization"},
        "motion": {
            "kind": "leapfrog",
            "dt": (LENGTH + AFTER) / (BETA * SPEED_OF_LIGHT) / steps,
            "frame": "rest",
            "window": "reference",
        },
        "schedule": {"steps": steps},
    }


# ---- what is measured ----

Measured = Mapping[str, float]


@dataclass(frozen=True)
class Passage:
    """How a bunch fared: `sizes` (n, 3) in m at the paths `s` (n,) in m, and what was measured at each screen."""

    s: np.ndarray
    sizes: np.ndarray
    screens: Mapping[str, Measured]


def along(comm: MPI.Comm, charge: float, **resolution: int) -> Passage:
    """Run a bunch of this charge (C) through the cell; `resolution` are options of `scene`. Collective."""
    path, sizes = [], []
    for state in states(comm, scene(charge, **resolution)):
        path.append(state.course.path)
        sizes.append(state.moments().rms)
    return Passage(np.array(path), np.array(sizes), {name: _at_screen(comm, state, name) for name in screens()})


def _at_screen(comm: MPI.Comm, state: State, name: str) -> Measured:
    """What was measured of the particles that passed a screen. Collective."""
    record = state.screens
    here = np.flatnonzero(record.cause == record.names.index(name))
    time = np.concatenate(comm.allgather(record.time[here]))
    return {"passed": len(time), **measured(*collected(comm, record.particles.select(here)), time)}


def measured(position: np.ndarray, momentum: np.ndarray, time: np.ndarray) -> Measured:
    """Return sizes x, y, z in m, normalised emittances in m rad, and energy spread in units of m c², from what passes a plane.

    Positions (n, 3) in m, momenta (n, 3) in kg m/s, times (n,) in s.
    """
    u = momentum / (ELECTRON_MASS * SPEED_OF_LIGHT)
    covariances = [np.cov(position[:, d], u[:, d], bias=True) for d in range(2)]
    sizes = *(math.sqrt(c[0, 0]) for c in covariances), BETA * SPEED_OF_LIGHT * time.std()
    emittances = (math.sqrt(np.linalg.det(c)) for c in covariances)
    spread = np.sqrt(1 + np.sum(u**2, axis=1)).std()
    return dict(zip(MEASURED, (*sizes, *emittances, float(spread)), strict=True))


# ---- the reference ----


def reference() -> dict[str, Any]:
    """Return ImpactX's values: for each of CHARGES the path s and all MEASURED (n,), as `measured` has them."""
    return json.loads((files(__package__) / REFERENCE).read_text())


def description() -> dict[str, Any]:
    """Return the cell and the bunch that a reference is of, as JSON holds them."""
    return {"charges": CHARGES, "bunch": BUNCH, "cell": [list(vars(piece).values()) for piece in CELL]}


def at(values: Mapping[str, list[float]], path: float) -> Measured:
    """Return ImpactX's values where the path s is that of a screen. ValueError if it has none there."""
    (row,) = np.flatnonzero(np.isclose(values["s"], path, rtol=0, atol=1e-9))
    return {what: values[what][row] for what in MEASURED}


def _draw(found: Mapping[str, Passage], peer: Mapping[str, Any], path: Path) -> None:
    with picture(path, "A lattice cell beside ImpactX", "path, m", "rms size, mm") as axes:
        start = 0.0
        for piece in CELL:
            if piece.kind != "drift":
                axes.axvspan(start, start + piece.length, color="k", alpha=0.08, linewidth=0)
            start += piece.length
        for line_, (name, passage) in zip("-:", found.items(), strict=True):
            for d, what in enumerate(SIZES):
                label = f"{what}, {name} space charge"
                axes.plot(passage.s, passage.sizes[:, d] * 1e3, f"C{d}{line_}", linewidth=1, label=label)
                size = np.array(peer[name][what]) * 1e3
                axes.plot(peer[name]["s"], size, f"C{d}o", markersize=2.5, fillstyle="none", markevery=2)
        for place in screens().values():
            axes.axvline(place, color="k", linewidth=0.5)
        axes.plot([], [], "ko", markersize=2.5, fillstyle="none", label="ImpactX")
        axes.plot([], [], "k", linewidth=0.5, label="screens")

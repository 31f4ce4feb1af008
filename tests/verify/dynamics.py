"""Moving particles: single ones, bunches that their own charge drives apart, fast ones, and waves in a plasma."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np
from mpi4py import MPI
from scipy.integrate import solve_ivp

from amrpic.particles.thermal_equilibrium import ellipsoid_gradient
from amrpic.stages.push import PUSHERS
from amrpic.units import ELECTRON_MASS, ELEMENTARY_CHARGE, SPEED_OF_LIGHT
from amrpic.verify.table import Cell, Goal, Table
from exact import orbits, passages
from exact.runs import collected, end
from exact.sources import EPS0, Gaussian

from . import beam_line, envelopes, halo, mismatch, plasma, thermal, two_frames
from .curves import Curves

CHARGE = -10e-12  # C
PARTICLES = 200_000
STEPS = 100
EDGE = 0.999  # of the particles
SPHERE = (1e-3, 1e-3, 1e-3)  # m, half axes
ELLIPSOID = (1e-3, 1e-3, 3e-3)
BASES = (32, 64, 96)


def tables(comm: MPI.Comm) -> Iterator[Table]:
    """The tables of this topic. Collective."""
    yield _one_particle()
    yield _passages(comm)
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


# ---- single particles ----


def _one_particle() -> Table:
    turned = {
        (fields, pusher): orbits.turning(pusher, drift)
        for fields, drift in (("B", 0.0), ("E × B", 0.3))
        for pusher in PUSHERS
    }
    return Curves(
        "One particle in uniform fields",
        f"A positron in B, and in E × B that lets it drift with 0.3 of its speed: {orbits.TURNS} turns of 200 steps. Error of "
        "its phase in the drifting frame, over the whole phase, and its order from that with 100 steps a turn; change of |p| "
        "without E. In E along z: error of the momentum over what is gained, and order of the error of the place, 50 to 200 "
        "steps. Against exact orbits.",
        ("fields", "βγ", "pusher", "phase", "order", "momentum"),
        [*(row for case, found in turned.items() for row in _turning_rows(*case, *found)), *_accelerated_rows()],
        curves={
            f"{fields}, βγ = {u:g}, {pusher}": (list(map(float, orbits.STEPS)), list(map(float, errors[:, n])))
            for (fields, pusher), (errors, _) in turned.items()
            for n, u in enumerate(orbits.MOMENTA)
        },
        across="steps a turn",
        upwards="error of the phase",
        by_line=True,
    )


def _turning_rows(fields: str, pusher: str, errors: np.ndarray, changes: np.ndarray) -> Iterator[list[Cell]]:
    for u, error, change in zip(orbits.MOMENTA, errors.T, changes, strict=True):
        order = Goal(float(np.log2(error[-2] / error[-1])), 1.9, least=True)
        yield [fields, u, pusher, Goal(error[-1], 1e-4), order, Goal(change, 1e-12) if fields == "B" else ""]


def _accelerated_rows() -> Iterator[list[Cell]]:
    for pusher in PUSHERS:
        momentum, order = orbits.accelerated(pusher)
        yield ["E", 0.5, pusher, "", Goal(order, 1.9, least=True), Goal(momentum, 1e-12)]


def _passages(comm: MPI.Comm) -> Table:
    found: dict[str, tuple[list[float], list[Cell]]] = {}
    for ends, elements, exact in (
        ("smooth", passages.SMOOTH, passages.through_smooth),
        ("hard", passages.HARD, passages.through_hard),
    ):
        for name, element in elements.items():
            errors = [passages.passage_error(comm, element, steps, exact) for steps in passages.STEPS]
            auto = passages.flown(comm, element, "auto")
            at_auto = Goal(passages.error_of(comm, auto, element, exact), 1e-5)
            found[f"{name}, {ends}"] = (
                errors,
                [*errors, Goal(passages.order(errors), 1.9, least=True), auto.step, at_auto],
            )
    return Curves(
        "Passage through an element",
        f"40 protons with βγ = {passages.BETA_GAMMA} fly {passages.LENGTH} m through one element: errors of their places and "
        "momenta, over what the element changes of them (roots of mean squares, added), with these numbers of steps. Against "
        "SciPy's DOP853 in the same field; at hard edges it stops for what Maxwell's equations ask for there. Magnets with "
        "Enge's fringe, a solenoid as a thin sheet, the gap and focusing without ends are smooth. Last, the steps that "
        '`dt = "auto"` takes, and its error.',
        ("element", *(f"{steps} steps" for steps in passages.STEPS), "order", "steps of auto", "auto"),
        [[name, *cells] for name, (_, cells) in found.items()],
        curves={name: (list(map(float, passages.STEPS)), errors) for name, (errors, _) in found.items()},
        across="steps",
        upwards="error",
        by_line=True,
    )


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
    return Curves(
        "Coulomb explosion",
        f"{PARTICLES} electrons at rest, quiet, of 10 pC in a uniform ellipsoid with a half axis of 1 mm, until it is about "
        "twice as large, in free space; one level refined where charge is. Largest error of the rms sizes along the axes, and "
        f"of the elliptic radius that holds {EDGE:.1%} of the particles, against the exact law of a uniform ellipsoid.",
        ("bunch", "mesh", "rms", "edge"),
        rows,
        curves=curves,
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

"""Protons that fly through one element of a beam line, against SciPy."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any, Literal

import numpy as np
from mpi4py import MPI
from scipy.integrate import solve_ivp

from amrpic.external import ExternalFields
from amrpic.pic.state import State
from amrpic.scene.scene import Scene
from amrpic.units import ELEMENTARY_CHARGE, PROTON_MASS, SPEED_OF_LIGHT

from .runs import collected, states

MC = PROTON_MASS * SPEED_OF_LIGHT
BETA_GAMMA = 0.2
LENGTH = 0.6  # m, that particles fly
TIME = LENGTH / (BETA_GAMMA / np.hypot(1, BETA_GAMMA) * SPEED_OF_LIGHT)  # s
STEPS = (200, 400, 800)

# Lengths in m, fields in T, V/m or per m, otherwise with a unit.
QUADRUPOLE = {"kind": "quadrupole", "length": 0.1, "gradient": 3.0}
DIPOLE = {"kind": "dipole", "length": 0.1, "field": 0.1}
SOLENOID = {"kind": "solenoid", "length": 0.2, "field": 0.5}
FOCUSING = {"kind": "constant-focusing", "gradient": [1e9, 1e9, 0]}
ENGE = {"fringe": "enge", "gap": "2 cm"}
SMOOTH: Mapping[str, dict[str, Any]] = {
    "quadrupole": {**QUADRUPOLE, **ENGE},
    "solenoid": {**SOLENOID, "fringe": "sheet", "radius": "5 cm"},
    "dipole": {**DIPOLE, **ENGE},
    "rf-gap": {"kind": "rf-gap", "length": "5 cm", "voltage": "200 kV", "frequency": "100 MHz", "phase": "30 deg"},
    "focusing": FOCUSING,
    "turned dipole": {**DIPOLE, **ENGE, "entrance_angle": "20 deg", "exit_angle": "-0.3 rad"},
}
HARD: Mapping[str, dict[str, Any]] = {
    "quadrupole": QUADRUPOLE,
    "solenoid": SOLENOID,
    "dipole": DIPOLE,
    "focusing": {**FOCUSING, "length": 0.2},
    "cavity": {"kind": "cavity", "length": 0.1, "field": 2e6, "frequency": "300 MHz", "phase": "30 deg"},
}


def order(errors: list[float]) -> float:
    """The order of errors, each with half the step of the one before, by a straight line through all."""
    return float(-np.polyfit(np.log(2.0) * np.arange(len(errors)), np.log(errors), 1)[0])


Exact = Callable[[dict[str, Any], float], tuple[np.ndarray, np.ndarray]]
Steps = int | Literal["auto"]  # those that TIME takes


def passage_error(comm: MPI.Comm, element: dict[str, Any], steps: Steps, exact: Exact) -> float:
    """The error of protons that have flown through an element. Collective."""
    return error_of(comm, flown(comm, element, steps), element, exact)


def flown(comm: MPI.Comm, element: dict[str, Any], steps: Steps) -> State:
    """The first state after TIME. Collective."""
    return next(state for state in states(comm, passage([element], steps)) if state.time > TIME * (1 - 1e-9))


def error_of(comm: MPI.Comm, state: State, element: dict[str, Any], exact: Exact) -> float:
    """The error of places over what the element changes of them, and the same of momenta, added: roots of mean squares.

    Collective.
    """
    found, should, (x, p) = collected(comm, state.synchronized), exact(element, state.time), start()
    without = x + state.time * SPEED_OF_LIGHT / MC * p / _gamma(p / MC), p
    off, changed = (
        np.array([np.linalg.norm(a - b) for a, b in zip(should, other, strict=True)]) for other in (found, without)
    )
    return float((off / changed).sum())


def passage(elements: list[dict[str, Any]], steps: Steps) -> dict[str, Any]:
    """The scene of protons without weight to speak of, which fly along z from about -0.3 m to 0.3 m."""
    position, momentum = start()
    return {
        "domain": {
            "lower": ["-50 mm", "-50 mm", "-0.5 m"],
            "upper": ["50 mm", "50 mm", "0.5 m"],
            "cells": [8, 8, 16],
        },
        "bunches": [
            {
                "distribution": "arrays",
                "species": "proton",
                "position": position,
                "momenta": momentum,
                "charge": 1e-25,
            }
        ],
        "elements": elements,
        "motion": {"kind": "leapfrog", "dt": "auto" if steps == "auto" else TIME / steps},
        "schedule": {"steps": 100_000 if steps == "auto" else steps},
        "output": {"write": []},
    }


def start() -> tuple[np.ndarray, np.ndarray]:
    """Places (40, 3) in m, at all phases of a step before edges, and momenta (40, 3) in kg m/s of the protons."""
    rng = np.random.default_rng(4)
    position = rng.normal(0, 1e-3, (40, 3)) - np.array([0, 0, 0.3]) + np.outer(rng.uniform(-0.02, 0.02, 40), [0, 0, 1])
    momentum = (rng.normal(0, 2e-3, (40, 3)) + np.array([0, 0, 1])) * BETA_GAMMA * MC
    return position, momentum


# ---- by SciPy ----


def through_smooth(element: dict[str, Any], time: float) -> tuple[np.ndarray, np.ndarray]:
    """Places (n, 3) in m and momenta (n, 3) in kg m/s after `time` s, for a field that is smooth."""
    fields = _fields(element)

    def change(now: float, y: np.ndarray) -> np.ndarray:
        x, u = y.reshape(2, -1, 3)
        v = u / _gamma(u) * SPEED_OF_LIGHT
        e, b = fields.fields(x, now)
        return np.concatenate([v, ELEMENTARY_CHARGE / MC * (e + np.cross(v, b))]).ravel()

    x, p = start()
    found = _integrated(change, 0.0, time, np.stack([x, p / MC]))
    return found[0], found[1] * MC


def through_hard(element: dict[str, Any], time: float) -> tuple[np.ndarray, np.ndarray]:
    """The same for a field between two planes: straight to the first one, along z to the second one, straight to the end."""
    inside = _fields({**element, "length": 100 * LENGTH})
    half = element["length"] / 2

    def change(z: float, y: np.ndarray) -> np.ndarray:  # of x, y, c t and momenta over m c, by z
        (x, u), gamma = y.reshape(2, -1, 3), _gamma(y.reshape(2, -1, 3)[1])
        e, b = (np.empty_like(x) for _ in range(2))
        for n in range(len(x)):  # they come to z at times of their own
            (e[n],), (b[n],) = inside.fields([[x[n, 0], x[n, 1], z]], x[n, 2] / SPEED_OF_LIGHT)
        flight = np.concatenate([u[:, :2], gamma], axis=1)
        force = ELEMENTARY_CHARGE / MC * (e * gamma / SPEED_OF_LIGHT + np.cross(u, b))
        return np.concatenate([flight / u[:, 2:], force / u[:, 2:]]).ravel()

    x, p = start()
    u = p / MC
    arrival = (-half - x[:, 2:]) / u[:, 2:] * _gamma(u)  # c t
    at_entry = np.concatenate([x[:, :2] + (-half - x[:, 2:]) / u[:, 2:] * u[:, :2], arrival], axis=1)
    at_exit, out = _integrated(change, -half, half, np.stack([at_entry, past_edge(element, at_entry, u, 1)]))
    out = past_edge(element, at_exit, out, -1)
    left = SPEED_OF_LIGHT * time - at_exit[:, 2:]
    place = np.concatenate([at_exit[:, :2], np.full_like(left, half)], axis=1) + left * out / _gamma(out)
    return place, out * MC


def past_edge(element: dict[str, Any], x: np.ndarray, u: np.ndarray, rises: int) -> np.ndarray:
    """Momenta over m c behind a hard edge where the field rises (1) or falls (-1); x (n, 3), of which two columns count.

    In the plane, where a solenoid's B_z changes, div B = 0 asks for B_r = -r/2 ΔB_z δ(z), whose kick leaves |u| as it was; and
    where a dipole's B_y changes, curl B = 0 for B_z = y ΔB_y δ(z), which turns about z.
    """
    if element["kind"] not in ("solenoid", "dipole"):
        return u
    strength = rises * element["field"] * ELEMENTARY_CHARGE / MC
    out = u.copy()
    if element["kind"] == "solenoid":
        out[:, :2] += strength / 2 * np.stack([x[:, 1], -x[:, 0]], axis=1)
        out[:, 2] = np.sqrt((u**2).sum(axis=1) - (out[:, :2] ** 2).sum(axis=1))
    else:
        turned = (u[:, 0] + 1j * u[:, 1]) * np.exp(-1j * strength * x[:, 1] / u[:, 2])
        out[:, 0], out[:, 1] = turned.real, turned.imag
    return out


def _fields(element: dict[str, Any]) -> ExternalFields:
    return ExternalFields.of_scene(Scene.from_dict(passage([element], 1)))


def _integrated(change: Callable[..., np.ndarray], start: float, stop: float, y: np.ndarray) -> np.ndarray:
    found = solve_ivp(change, (start, stop), y.ravel(), method="DOP853", rtol=1e-11, atol=1e-13)
    return found.y[:, -1].reshape(y.shape)


def _gamma(u: np.ndarray) -> np.ndarray:
    return np.sqrt(1 + (u**2).sum(axis=1, keepdims=True))

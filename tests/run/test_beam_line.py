"""Beams in the fields of elements, against SciPy and the exact laws of optics."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from mpi4py import MPI
from scipy.integrate import solve_ivp

import amrpic
from amrpic.external import ExternalFields
from amrpic.units import ELEMENTARY_CHARGE, PROTON_MASS, SPEED_OF_LIGHT

MC = PROTON_MASS * SPEED_OF_LIGHT
BETA_GAMMA = 0.2
LENGTH = 0.6  # m, that particles fly


def scene(elements: list[dict[str, Any]], steps: int, **more: Any) -> amrpic.Scene:
    """Protons without weight to speak of, which fly along z from -0.3 m to 0.3 m."""
    rng = np.random.default_rng(4)
    position = rng.normal(0, 1e-3, (40, 3)) - np.array([0, 0, 0.3])
    momentum = (rng.normal(0, 2e-3, (40, 3)) + np.array([0, 0, 1])) * BETA_GAMMA * MC
    velocity = BETA_GAMMA / np.hypot(1, BETA_GAMMA) * SPEED_OF_LIGHT
    return amrpic.Scene.from_dict(
        {
            "domain": {
                "lower": ["-50 mm", "-50 mm", "-0.5 m"],
                "upper": ["50 mm", "50 mm", "0.5 m"],
                "cells": [8, 8, 16],
            },
            "bunches": [
                {
                    "distribution": "arrays",
                    "species": "proton",
                    "position": position.tolist(),
                    "momenta": momentum.tolist(),
                    "charge": 1e-25,
                }
            ],
            "elements": elements,
            "motion": {"kind": "leapfrog", "dt": LENGTH / velocity / steps},
            "schedule": {"steps": steps},
            "output": {"write": []},
            **more,
        }
    )


def end(given: amrpic.Scene, comm: MPI.Comm = MPI.COMM_SELF) -> tuple[np.ndarray, np.ndarray]:
    """Places and momenta at the end in the order of ids, on every rank."""
    run = amrpic.Simulation(comm, given)
    run.run()
    parts = [
        np.concatenate(comm.allgather(np.array(a)))
        for a in (run.particles.id, run.particles.position, run.particles.momentum)
    ]
    order = np.argsort(parts[0])
    return parts[1][order], parts[2][order]


def exact(given: amrpic.Scene) -> tuple[np.ndarray, np.ndarray]:
    """The same by SciPy, for fields without hard edges."""
    run = amrpic.Simulation(MPI.COMM_SELF, given)
    fields = ExternalFields.of_scene(given)
    order = np.argsort(run.particles.id)
    start = np.concatenate([run.particles.position[order], run.particles.momentum[order] / MC], axis=1)

    def change(time: float, y: np.ndarray) -> np.ndarray:
        x, u = y.reshape(-1, 6)[:, :3], y.reshape(-1, 6)[:, 3:]
        v = u / np.sqrt(1 + (u**2).sum(axis=1, keepdims=True)) * SPEED_OF_LIGHT
        e, b = fields.fields(x, time)
        return np.concatenate([v, ELEMENTARY_CHARGE / MC * (e + np.cross(v, b))], axis=1).ravel()

    time = given.motion.dt * given.schedule.last_step  # type: ignore[union-attr]
    found = solve_ivp(change, (0, time), start.ravel(), method="DOP853", rtol=1e-11, atol=1e-13).y[:, -1].reshape(-1, 6)
    return found[:, :3], found[:, 3:] * MC


SMOOTH = {
    "quadrupole": {
        "kind": "quadrupole",
        "centre": [0, 0, 0],
        "length": "0.1 m",
        "gradient": "3 T/m",
        "fringe": "enge",
        "gap": "2 cm",
    },
    "solenoid": {
        "kind": "solenoid",
        "centre": [0, 0, 0],
        "length": "0.2 m",
        "field": "0.5 T",
        "fringe": "sheet",
        "radius": "5 cm",
    },
    "dipole": {
        "kind": "dipole",
        "centre": [0, 0, 0],
        "length": "0.1 m",
        "field": "0.1 T",
        "fringe": "enge",
        "gap": "2 cm",
    },
    "rf-gap": {
        "kind": "rf-gap",
        "centre": [0, 0, 0],
        "length": "5 cm",
        "voltage": "200 kV",
        "frequency": "100 MHz",
        "phase": "30 deg",
    },
    "focusing": {"kind": "constant-focusing", "gradient": ["1 MV/m^2", "1 MV/m^2", 0]},
}


@pytest.mark.parametrize("name", SMOOTH)
def test_orbits_through_smooth_elements_are_those_of_scipy(name):
    errors = []
    for steps in (100, 200, 400):
        given = scene([SMOOTH[name]], steps)
        found, should = end(given), exact(given)
        x = np.abs(found[0] - should[0]).max() / 0.3
        p = np.abs(found[1] - should[1]).max() / (BETA_GAMMA * MC)
        errors.append(float(x + p))
    assert np.log2(errors[0] / errors[2]) / 2 > 1.9, errors
    assert errors[-1] < 1e-4, errors


def test_a_hard_quadrupole_is_its_transfer_matrix():
    """To first order in the coordinates, whatever the step: the edges cut steps."""
    k = 3.0 * ELEMENTARY_CHARGE / (BETA_GAMMA * MC)
    errors = []
    for steps in (100, 200, 400, 800):
        given = scene([{**SMOOTH["quadrupole"], "fringe": "hard", "gap": None}], steps)
        run = amrpic.Simulation(MPI.COMM_SELF, given)
        order = np.argsort(run.particles.id)
        x, p = run.particles.position[order], run.particles.momentum[order]
        slope = p[:, :2] / p[:, 2:]
        strength = k * BETA_GAMMA * MC / p[:, 2]
        x_in = x[:, :2] + slope * (-0.05 - x[:, 2:])
        root = np.sqrt(strength)[:, None]
        c = np.concatenate([np.cos(root * 0.1), np.cosh(root * 0.1)], axis=1)
        s = np.concatenate([np.sin(root * 0.1), np.sinh(root * 0.1)], axis=1)
        slope_out = np.array([-1, 1]) * root * s * x_in + c * slope
        found = end(given)
        errors.append(float(np.abs(found[1][:, :2] / found[1][:, 2:] - slope_out).mean()))
    assert np.polyfit(np.log(2.0) * np.arange(4), np.log(errors), 1)[0] < -1.5 or errors[-1] < 1e-8, errors


@pytest.mark.mpi(ranks=(1, 2, 3))
def test_elements_act_the_same_on_any_number_of_ranks(comm):
    given = scene([SMOOTH["quadrupole"], {**SMOOTH["solenoid"], "fringe": "hard", "radius": None}], 40)
    alone, together = end(given), end(given, comm)
    assert np.abs(alone[0] - together[0]).max() < 1e-12
    assert np.abs(alone[1] - together[1]).max() < 1e-12 * BETA_GAMMA * MC


def test_restart_in_the_middle_of_an_element_goes_on_bit_by_bit(tmp_path):
    given = scene([SMOOTH["rf-gap"], {**SMOOTH["solenoid"], "fringe": "hard", "radius": None}], 60)
    run = amrpic.Simulation(MPI.COMM_SELF, given)
    run.on_step(lambda now: now.checkpoint(tmp_path / "half") if now.step == 31 else None)
    run.run()
    again = amrpic.Simulation.restart(MPI.COMM_SELF, tmp_path / "half")
    again.run()
    for name in ("position", "momentum", "id"):
        assert np.array_equal(getattr(run.particles, name), getattr(again.particles, name))

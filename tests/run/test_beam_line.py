"""Beams in the fields of elements, against SciPy and the exact laws of optics."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from mpi4py import MPI

import amrpic
from amrpic.units import ELEMENTARY_CHARGE
from amrpic.verify.passages import (
    BETA_GAMMA,
    HARD,
    MC,
    SMOOTH,
    order,
    passage,
    passage_error,
    through_hard,
    through_smooth,
)
from amrpic.verify.runs import collected


def scene(elements: list[dict[str, Any]], steps: int, **more: Any) -> amrpic.Scene:
    return amrpic.Scene.from_dict({**passage(elements, steps), **more})


def end(given: amrpic.Scene, comm: MPI.Comm = MPI.COMM_SELF) -> tuple[np.ndarray, np.ndarray]:
    """Places and momenta at the end in the order of ids, on every rank."""
    run = amrpic.Simulation(comm, given)
    run.run()
    return collected(comm, run.particles)


@pytest.mark.parametrize("name", SMOOTH)
def test_orbits_through_smooth_elements_are_those_of_scipy(name):
    errors = [passage_error(MPI.COMM_SELF, SMOOTH[name], steps, through_smooth) for steps in (100, 200, 400)]
    assert order(errors) > 1.9, errors
    assert errors[-1] < 1e-4, errors


@pytest.mark.parametrize("name", HARD)
def test_orbits_through_hard_edges_are_those_of_scipy(name):
    errors = [passage_error(MPI.COMM_SELF, HARD[name], steps, through_hard) for steps in (100, 200, 400)]
    assert order(errors) > 1.8, errors
    assert errors[-1] < 1e-3, errors


def test_a_hard_quadrupole_is_its_transfer_matrix():
    """To first order in the coordinates, whatever the step: the edges cut steps."""
    k = 3.0 * ELEMENTARY_CHARGE / (BETA_GAMMA * MC)
    errors = []
    for steps in (100, 200, 400, 800):
        given = scene([HARD["quadrupole"]], steps)
        run = amrpic.Simulation(MPI.COMM_SELF, given)
        x, p = collected(MPI.COMM_SELF, run.particles)
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
    given = scene([SMOOTH["quadrupole"], HARD["solenoid"]], 40)
    alone, together = end(given), end(given, comm)
    assert np.abs(alone[0] - together[0]).max() < 1e-12
    assert np.abs(alone[1] - together[1]).max() < 1e-12 * BETA_GAMMA * MC


def test_restart_in_the_middle_of_an_element_goes_on_bit_by_bit(tmp_path):
    given = scene([SMOOTH["rf-gap"], HARD["solenoid"]], 60)
    run = amrpic.Simulation(MPI.COMM_SELF, given)
    run.on_step(lambda now: now.checkpoint(tmp_path / "half") if now.step == 31 else None)
    run.run()
    again = amrpic.Simulation.restart(MPI.COMM_SELF, tmp_path / "half")
    again.run()
    for name in ("position", "momentum", "id"):
        assert np.array_equal(getattr(run.particles, name), getattr(again.particles, name))

"""Beams in the fields of elements, against SciPy and the exact laws of optics."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from mpi4py import MPI

import amrpic
from amrpic.units import ELEMENTARY_CHARGE
from exact.passages import (
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
from exact.runs import collected


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


RADIUS, BEND = 1.0, 0.18  # m, rad
SMALL = 1e-5  # m and rad


def sector_matrices(entrance: float, exit: float, before: float = 0.1, after: float = 0.05) -> list[np.ndarray]:
    """For x and y: drift, pole face, sector, pole face, drift (K. L. Brown, SLAC-75), angles from the normal of the orbit."""
    c, s = np.cos(BEND), np.sin(BEND)
    sectors = np.array([[[c, RADIUS * s], [-s / RADIUS, c]], [[1, RADIUS * BEND], [0, 1]]])
    drift = [np.array([[1, length], [0, 1]]) for length in (before, after)]
    face = [[np.array([[1, 0], [sign * np.tan(e) / RADIUS, 1]]) for sign in (1, -1)] for e in (entrance, exit)]
    return [drift[1] @ face[1][plane] @ sectors[plane] @ face[0][plane] @ drift[0] for plane in (0, 1)]


def seen_along(orbit: np.ndarray, place: np.ndarray, momentum: np.ndarray) -> np.ndarray:
    """x, x', y, y' of particles (n, 4) where they pass the plane through a point across a direction of x and z."""
    (x0, z0), (sine, cosine) = orbit
    along = np.array([sine, 0, cosine])
    slope = momentum / (momentum @ along)[:, None]
    passed = place + slope * ((np.array([x0, 0, z0]) - place) @ along)[:, None]
    x = (passed[:, 0] - x0) * cosine - (passed[:, 2] - z0) * sine
    return np.stack([x, slope[:, 0] * cosine - slope[:, 2] * sine, passed[:, 1], slope[:, 1]], axis=1)


@pytest.mark.parametrize(
    "angles, sign", [((0.0, 0.0), 1), ((-0.09, -0.09), 1), ((0.4, -0.3), 1), ((0.4, -0.3), -1)],
    ids=["rectangle", "sector", "wedge", "wedge that bends to +x"],
)  # fmt: skip
def test_a_hard_dipole_with_pole_faces_is_its_transfer_matrix(angles, sign):
    """To first order in the coordinates about the design orbit; with positive angles a magnet is shorter at x > 0."""
    half = RADIUS * np.sin(BEND / 2)
    arrive, leave = (np.array([way * sign * np.sin(BEND / 2), np.cos(BEND / 2)]) for way in (1, -1))
    start = np.array([0, -half]) - 0.1 * arrive
    axis_x = np.array([arrive[1], 0, -arrive[0]])  # across the orbit
    offsets = SMALL * np.concatenate([np.eye(4), -np.eye(4)])
    place = np.array([start[0], 0, start[1]]) + offsets[:, :1] * axis_x + offsets[:, 2:3] * [0, 1, 0]
    way = np.array([arrive[0], 0, arrive[1]]) + offsets[:, 1:2] * axis_x + offsets[:, 3:] * [0, 1, 0]
    momentum = BETA_GAMMA * MC * way / np.linalg.norm(way, axis=1, keepdims=True)
    magnet = {
        "kind": "dipole",
        "length": 2 * half,
        "field": sign * BETA_GAMMA * MC / ELEMENTARY_CHARGE / RADIUS,
        "entrance_angle": angles[0],
        "exit_angle": angles[1],
    }
    bunch = {
        "distribution": "arrays",
        "species": "proton",
        "charge": 1e-25,
        "position": place.tolist(),
        "momenta": momentum.tolist(),
    }
    x, p = end(scene([magnet], 200, bunches=[bunch]))
    seen = seen_along(np.array([[0, half] + 0.05 * leave, leave]), x, p)
    found = (seen[:4] - seen[4:]).T / (2 * SMALL)
    # Mirrored in x, a face is turned the other way.
    expected = np.zeros((4, 4))
    expected[:2, :2], expected[2:, 2:] = sector_matrices(BEND / 2 + sign * angles[0], BEND / 2 + sign * angles[1])
    # The orbit's error is of second order in the step, and goes with the place in the step where a face is crossed: that of
    # its derivative by x is of first order.
    assert np.abs(found - expected).max() < 3.5e-4
    assert np.linalg.det(found) == pytest.approx(1, abs=1e-3)


@pytest.mark.mpi(ranks=(1, 2, 3))
def test_elements_act_the_same_on_any_number_of_ranks(comm):
    given = scene([SMOOTH["quadrupole"], HARD["solenoid"]], 40)
    alone, together = end(given), end(given, comm)
    assert np.abs(alone[0] - together[0]).max() < 1e-12
    assert np.abs(alone[1] - together[1]).max() < 1e-12 * BETA_GAMMA * MC


@pytest.mark.parametrize(
    "element", [*HARD.values(), SMOOTH["quadrupole"], SMOOTH["rf-gap"]], ids=lambda of: str(of["kind"])
)
def test_what_acts_on_a_particle_does_not_depend_on_those_beside_it(element):
    """Blocks of particles wholly inside an element take another way than those of which some are outside."""
    rng = np.random.default_rng(6)
    place = rng.uniform(-1e-2, 1e-2, (256, 3))
    momenta = (rng.normal(0, 2e-3, (256, 3)) + np.array([0, 0, 1])) * BETA_GAMMA * MC
    some_outside = np.where(np.arange(256)[:, None] % 5 == 0, [0, 0, 0.4], 0) + place
    ends = []
    for position in (place, some_outside):
        bunch = {
            "distribution": "arrays",
            "species": "proton",
            "charge": 1e-25,
            "position": position,
            "momenta": momenta,
        }
        ends.append(end(scene([element], 3, bunches=[bunch], motion={"kind": "leapfrog", "dt": 1e-11})))
    beside = np.arange(256) % 5 != 0
    (x, p), (x_beside, p_beside) = ends
    changed = np.abs(p[beside] - momenta[beside]).max()
    assert changed > 1e-7 * BETA_GAMMA * MC
    assert np.abs(x - x_beside)[beside].max() < 1e-14
    assert np.abs(p - p_beside)[beside].max() < 1e-9 * changed


def test_restart_in_the_middle_of_an_element_goes_on_bit_by_bit(tmp_path):
    given = scene([SMOOTH["rf-gap"], HARD["solenoid"]], 60)
    run = amrpic.Simulation(MPI.COMM_SELF, given)
    run.on_step(lambda now: now.checkpoint(tmp_path / "half") if now.step == 31 else None)
    run.run()
    again = amrpic.Simulation.restart(MPI.COMM_SELF, tmp_path / "half")
    again.run()
    for name in ("position", "momentum", "id"):
        assert np.array_equal(getattr(run.particles, name), getattr(again.particles, name))

"""Runs whose open faces lie beside walls and periodic axes: the examples, windows, restarts."""

from __future__ import annotations

import re
from typing import Any

import numpy as np
import pytest
from mpi4py import MPI
from scipy.integrate import solve_ivp

import amrpic
from amrpic.units import ELECTRON_MASS, ELEMENTARY_CHARGE, SPEED_OF_LIGHT
from amrpic.units import VACUUM_PERMITTIVITY as EPS0
from examples import EXAMPLES


def example(name: str, *changes: str) -> amrpic.Scene:
    return amrpic.Scene.from_toml(EXAMPLES / f"{name}.toml", ["output.write=[]", *changes])


def momentum_along_z(run: amrpic.Simulation) -> float:
    return float(run.particles.weight @ run.particles.momentum[:, 2])


def force_of_images(particles: amrpic.Particles, sample: int) -> float:
    """Sum over pairs of some particles and the images of some, in a plane z = 0 at 0 V, along z, N: by Coulomb's law."""
    chosen = np.random.default_rng(2).permutation(len(particles.position))[: 2 * sample]
    here, other = particles.position[chosen[:sample]], particles.position[chosen[sample:]] * (1, 1, -1)
    total = sum(((z - other[:, 2]) / ((x - other[:, 0]) ** 2 + (y - other[:, 1]) ** 2 + (z - other[:, 2]) ** 2) ** 1.5).sum()
                for x, y, z in here)  # fmt: skip
    return -(float(particles.weight @ particles.charge) ** 2) / (4 * np.pi * EPS0) * total / sample**2


@pytest.mark.parametrize("steps", [4, 40])
def test_the_cathode_holds_the_pancake_back_by_its_image(steps):
    """Momentum per time, less the accelerating field, against a sum over pairs of particles and images."""
    run = amrpic.Simulation(MPI.COMM_SELF, example("cathode"))
    run.advance(steps - 1)
    before = momentum_along_z(run)
    run.advance(1)
    expected = force_of_images(run.particles, 8000)
    run.advance(1)
    force = (momentum_along_z(run) - before) / (2 * 2e-12) - 1e-11 * 1e6
    assert run.particles.global_count(run.comm) == 100_000
    assert expected < -0.01 * 1e-11 * 1e6  # that share of the accelerating force
    assert force == pytest.approx(expected, rel=0.01)


def test_a_long_beam_spreads_as_the_universal_curve_and_its_potential_is_a_logarithm():
    run = amrpic.Simulation(MPI.COMM_SELF, example("long_beam"))
    times, radii = [run.time], [2 * run.state.moments().rms[:2]]
    for state in run:
        times.append(state.time)
        radii.append(2 * state.moments().rms[:2])
    gamma = 1 + 1e4 * ELEMENTARY_CHARGE / (ELECTRON_MASS * SPEED_OF_LIGHT**2)
    period, per_length = 1e-3, 1.71e-12 / 1e-3
    strength = ELEMENTARY_CHARGE * per_length / (2 * np.pi * EPS0 * ELECTRON_MASS * gamma**3)
    exact = solve_ivp(
        lambda _, y: (y[1], strength / y[0]), (0, times[-1]), (1e-3, 0), t_eval=times, rtol=1e-9, atol=1e-12
    ).y[0]
    assert exact[-1] > 2e-3
    for axis in range(2):
        np.testing.assert_allclose(np.array(radii)[:, axis], exact, rtol=3e-3)
    r = np.linspace(2.3e-3, 2.9e-3, 5)  # m, outside of the beam
    phi = run.phi.sample(np.stack([r * np.cos(r), r * np.sin(r), 0.2 * r], axis=1), order=3)
    np.testing.assert_allclose(phi, per_length / (2 * np.pi * EPS0) * np.log(r / (gamma * period)), rtol=1e-3)


@pytest.mark.mpi(ranks=(1, 2))
@pytest.mark.parametrize("name", ["cathode", "long_beam"])
def test_examples_go_on_after_a_restart_bit_by_bit(comm, tmp_path, name):
    whole = amrpic.Simulation(comm, example(name, "schedule.steps=8"))
    whole.run(log="silent")
    first = amrpic.Simulation(comm, example(name, "schedule.steps=4"))
    first.run(log="silent")
    first.checkpoint(tmp_path / "checkpoint")
    again = amrpic.Simulation.restart(comm, tmp_path / "checkpoint", example(name, "schedule.steps=8"))
    again.run(log="silent")
    for what in ("position", "momentum", "id"):
        np.testing.assert_array_equal(getattr(again.particles, what), getattr(whole.particles, what))
    for mine, expected in zip(again.phi.patches, whole.phi.patches, strict=True):
        np.testing.assert_array_equal(mine.data, expected.data)


BESIDE: dict[str, Any] = {
    "periodic along the motion": {"z": "periodic"},
    "a plate beside it": {"x": ["dirichlet", "open"]},
    "between plates": {"y": ["dirichlet", "neumann"]},
    "in a pipe": {"x": "dirichlet", "y": "dirichlet"},
}


@pytest.mark.mpi(ranks=(1, 2))
@pytest.mark.parametrize("faces", BESIDE.values(), ids=list(BESIDE))
def test_a_bunch_in_its_window_expands_as_one_at_rest(comm, faces):
    """It flies 30 lengths of the domain, so slowly that it has no magnetic field."""
    kicks, speed = {}, 0.01 * SPEED_OF_LIGHT
    for velocity in (0.0, speed):
        bunch = {
            "distribution": "gaussian",
            "species": "electron",
            "sigma": "1 mm",
            "cutoff": 3,
            "centre": ["-3 mm", "-2 mm", 0],
            "velocity": [0, 0, velocity],
            "charge": -5e-17,
            "particles": 4096,
            "sampling": "sobol",
        }
        scene = amrpic.Scene.from_dict(
            {
                "domain": {"lower": "-8 mm", "upper": "8 mm", "cells": 24, "boundary": faces},
                "bunches": [bunch],
                "refinement": {"levels": 1, "blocking_factor": 4},
                "motion": {
                    "kind": "leapfrog",
                    "dt": 30 * 16e-3 / speed / 20,
                    "frame": "lab",
                    "window": "reference" if velocity else "none",
                },
                "schedule": {"steps": 20},
                "output": {"write": []},
            }
        )
        run = amrpic.Simulation(comm, scene)
        run.run(log="silent")
        mean = ELECTRON_MASS * velocity / np.sqrt(1 - (velocity / SPEED_OF_LIGHT) ** 2)
        assert run.window.origin[2] == pytest.approx(30 * 16e-3 if velocity else 0, rel=1e-4)
        id, momentum = (
            np.concatenate(comm.allgather(np.array(getattr(run.particles, what)))) for what in ("id", "momentum")
        )
        kicks[velocity] = momentum[np.argsort(id)] - (0, 0, mean)
    scale = np.abs(kicks[0.0]).max()
    assert scale > 5e-4 * ELECTRON_MASS * speed  # it expands by a third
    np.testing.assert_allclose(kicks[speed] / scale, kicks[0.0] / scale, atol=1e-3)


@pytest.mark.parametrize(
    ("faces", "words"),
    [
        ({}, "zero at infinity"),
        ({"z": "periodic"}, r"-λ ln\(r/L\)/2πε₀, .* L = 0.5 m"),
        ({"z": "neumann"}, r"-λ ln\(r/L\)/2πε₀, .* L = 1 m"),
        ({"y": "periodic", "z": "periodic"}, r"-σ\|d\|/2ε₀"),
        ({"y": "neumann", "z": "periodic"}, r"-σ\|d\|/2ε₀"),
        ({"y": ["open", "dirichlet"], "z": "periodic"}, "of the Dirichlet faces"),
    ],
)
def test_the_zero_of_phi_is_the_one_that_is_stated(faces, words):
    """Of charge that is even along axes without an open face: its potential is that of a point, a line or a sheet."""
    domain = amrpic.Domain((-1, -1, -0.25), (1, 1, 0.25), (40, 40, 10), faces)
    assert re.search(words, domain.zero_of_phi)
    hierarchy = amrpic.Hierarchy(MPI.COMM_SELF, domain)
    closed = np.array([axis in faces and "open" not in faces[axis] for axis in "xyz"])
    sigma = np.where(closed, np.inf, 0.08)
    rho = amrpic.Field(hierarchy, "C/m^3").fill(
        lambda *place: EPS0 * np.exp(-sum((x / s) ** 2 / 2 for x, s in zip(place, sigma, strict=True)))
    )
    phi, _ = amrpic.PoissonSolver(hierarchy, tolerance=1e-9).solve(rho)
    d = np.array([0.6, 0.75, 0.9])
    found = phi.sample(np.stack([d, 0 * d, 0 * d], axis=1), order=3) * EPS0
    charge = rho.integral() / np.prod(np.subtract(domain.upper, domain.lower)[closed])
    period = 1.0 if faces.get("z") == "neumann" else 0.5
    away = np.hypot(d, 2.0)  # of the image in y = 1 at y = 2
    exact = {
        "zero at infinity": charge / (4 * np.pi * d),
        "of the Dirichlet faces": charge / (2 * np.pi) * np.log(away / d),
        r"-σ\|d\|/2ε₀": -charge * d / 2,
    }.get(words, -charge / (2 * np.pi) * np.log(d / period))
    np.testing.assert_allclose(found, exact, rtol=3e-3, atol=3e-4 * np.abs(exact).max())

"""Beams near the speed of light: input, motion, their own magnetic field, and what is refused."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from mpi4py import MPI

import amrpic
from amrpic.errors import InputError
from amrpic.scene import toml
from amrpic.scene.bunches import DescribedBunch
from amrpic.stages.gather import gather
from amrpic.units import ELECTRON_MASS, SPEED_OF_LIGHT
from exact.sources import Gaussian

MC = ELECTRON_MASS * SPEED_OF_LIGHT


def scene(*changes: str, gamma: float = 20.0, direction: tuple = (0, 0, 1), **bunch: Any) -> amrpic.Scene:
    """A Gaussian electron bunch that flies through an open domain."""
    momentum = np.sqrt(gamma**2 - 1) * MC * np.array(direction)
    described = {
        "distribution": "gaussian",
        "species": "electron",
        "charge": "-10 pC",
        "particles": 20000,
        "sigma": "1 mm",
        "sampling": "sobol",
        "momentum": momentum.tolist(),
    }
    data = {
        "domain": {"lower": ["-8 mm"] * 3, "upper": ["8 mm"] * 3, "cells": [32] * 3},
        "bunches": [{**described, **bunch}],
        "motion": {"kind": "leapfrog", "dt": "0.1 ps"},
        "schedule": {"steps": 4},
        "output": {"write": []},
    }
    toml.override(data, changes)
    return amrpic.Scene.from_dict(data)


@pytest.mark.parametrize("gamma", [2.0, 20.0, 100.0])
def test_the_field_of_a_fast_bunch_is_the_boosted_one(gamma):
    """E across is γ times that at rest, E along is as at rest, B = β × E / c."""
    state = amrpic.Simulation(MPI.COMM_SELF, scene("domain.cells=[64, 64, 64]", gamma=gamma, particles=200_000)).state
    assert state.solution.frames.members[0].gamma == pytest.approx(gamma, rel=1e-9)
    at_rest = Gaussian((1e-3, 1e-3, gamma * 1e-3), (0.0, 0.0, 0.0), -10e-12)
    points = np.random.default_rng(3).normal(0, 1.5e-3, (3, 2000)).clip(-5e-3, 5e-3)
    x, y, z = at_rest.field(points[0], points[1], gamma * points[2])
    exact = gamma * x, gamma * y, z
    for component, values in zip(state.efield.components, exact, strict=True):
        found = component.sample(points.T)
        assert np.abs(found - values).max() < 0.05 * np.abs(values).max()  # 4 cells per sigma


def test_velocities_momenta_and_kinetic_energies_mean_the_same():
    gamma = 1 / np.sqrt(1 - 0.8**2)
    ways = (
        {"momentum": [0, 0, 0.8 * gamma * MC]},
        {"velocity": [0, 0, "0.8 c"]},
        {"kinetic_energy": (gamma - 1) * MC * SPEED_OF_LIGHT},
    )
    for way in ways:
        plain = scene().to_dict()
        plain["bunches"][0].pop("momentum")
        bunch = amrpic.Scene.from_dict({**plain, "bunches": [{**plain["bunches"][0], **way}]}).bunches[0]
        assert isinstance(bunch, DescribedBunch)
        assert bunch.mean_momentum == pytest.approx((0, 0, 0.8 * gamma * MC), rel=1e-14)


def test_electrons_of_fifty_mev_fly_below_the_speed_of_light():
    run = amrpic.Simulation(MPI.COMM_SELF, scene(gamma=98.8))
    start = run.state.moments().mean[2]
    run.run()
    assert len(run.lost.particles) == 0
    assert (run.state.moments().mean[2] - start) / run.time == pytest.approx(
        np.sqrt(1 - 98.8**-2) * SPEED_OF_LIGHT, rel=1e-9
    )


def test_electric_and_magnetic_force_nearly_cancel():
    """Across a bunch the momentum grows by q E / γ², so the slower one's grows γ² times as fast."""
    kicks = {}
    for gamma in (2.0, 40.0):
        run = amrpic.Simulation(MPI.COMM_SELF, scene("motion.dt=1e-14", gamma=gamma, momentum_spread=0.0))
        before = run.particles.momentum.copy()
        own = np.argsort(run.particles.id)
        felt = gather(run.efield, run.state.particles)[own]
        run.run()
        gained = (run.particles.momentum[np.argsort(run.particles.id)] - before[own])[:, :2]
        kicks[gamma] = gained / (felt[:, :2] * -1.602176634e-19 * run.time)
    for gamma, part in kicks.items():
        assert np.median(part) == pytest.approx(gamma**-2, rel=0.01)


@pytest.mark.mpi(ranks=(1, 2))
def test_restart_of_a_fast_beam_goes_on_bit_by_bit(comm, tmp_path):
    run = amrpic.Simulation(comm, scene())
    run.on_step(lambda now: now.checkpoint(tmp_path / "half") if now.step == 2 else None)
    run.run()
    again = amrpic.Simulation.restart(comm, tmp_path / "half")
    again.run()
    for name in ("position", "momentum", "id"):
        assert np.array_equal(getattr(run.particles, name), getattr(again.particles, name))


@pytest.mark.mpi(ranks=(1, 2))
@pytest.mark.parametrize(
    ("changes", "options", "said"),
    [
        (['motion.frame="lab"'], {"gamma": 1.1}, 'motion.frame is "lab", but the particles move with 0.417 c'),
        ([], {"direction": (0.06, 0, 1), "gamma": 2.0}, "the mean velocity lies 0.06 rad off the z axis"),
        (
            ['domain.boundary={x="neumann", y="neumann", z="dirichlet"}'],
            {},
            "a face across the motion along z is dirichlet",
        ),
    ],
)
def test_what_has_no_frame_is_refused_in_one_sentence(comm, changes, options, said):
    with pytest.raises(InputError, match=said):
        amrpic.Simulation(comm, scene(*changes, **options))


def test_slow_beams_stay_in_the_laboratory():
    for gamma, gammas in ((1 + 4e-5, 1.0), (1 + 6e-5, 1 + 6e-5)):
        frame = amrpic.Simulation(MPI.COMM_SELF, scene(gamma=gamma)).state.solution.frames.members[0]
        assert frame.gamma == pytest.approx(gammas, abs=1e-9)

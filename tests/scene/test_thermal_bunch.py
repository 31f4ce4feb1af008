"""Thermal equilibrium: its equation, its limits, and beams with the size, emittance and tune depression asked for."""

from __future__ import annotations

import re
from typing import Any

import numpy as np
import pytest
from mpi4py import MPI
from scipy.integrate import cumulative_simpson

from amrpic import Simulation
from amrpic.errors import SceneError
from amrpic.io import time_series
from amrpic.particles import thermal_equilibrium
from amrpic.particles.distributions import thermal
from amrpic.particles.groups import Groups
from amrpic.particles.phase_space import PhasePlane
from amrpic.particles.uniform_numbers import draw
from amrpic.pic.initial_particles import make_particles
from amrpic.scene.scene import Scene
from amrpic.scene.thermal_bunch import ThermalBunch
from amrpic.stages.beam_diagnostics import Beam, group_moments
from amrpic.units import ELECTRON_MASS, ELEMENTARY_CHARGE, SPEED_OF_LIGHT, VACUUM_PERMITTIVITY

LENGTH = 0.02  # m
BUNCH: dict[str, Any] = {
    "distribution": "thermal",
    "species": "electron",
    "charge": -1e-12,
    "length": LENGTH,
    "gradient": -1e5,
    "particles": 2**15,
    "sampling": "sobol",
}


def scene(**bunch: Any) -> Scene:
    domain = {
        "lower": [-1, -1, -LENGTH / 2],
        "upper": [1, 1, LENGTH / 2],
        "cells": 16,
        "boundary": {"x": "dirichlet", "y": "dirichlet", "z": "periodic"},
    }
    bunches = [{key: value for key, value in (BUNCH | bunch).items() if value is not None}]
    return Scene.from_dict({"domain": domain, "bunches": bunches})


def across(**bunch: Any) -> PhasePlane:
    (made,) = scene(**bunch).bunches
    assert isinstance(made, ThermalBunch)
    return made.planes[0]


@pytest.mark.parametrize("log_delta", [-300.0, -10.0, 0.0, 5.0])
def test_profile_is_in_balance_with_its_own_field(log_delta):
    """The force of the charge within s, of the focusing, and of the pressure; and the virial theorem for the whole."""
    s, psi = thermal_equilibrium.profile(log_delta)
    within = cumulative_simpson(np.exp(-psi) * s, x=s, initial=0)
    force = (1 + np.exp(log_delta)) * s[1:] / 2 - within[1:] / s[1:]
    error = np.abs(force - np.gradient(psi, s, edge_order=2)[1:])[2:-2].max()
    assert error < 1e-3 * force.max()
    mean_square = cumulative_simpson(np.exp(-psi) * s**3, x=s)[-1] / within[-1]
    assert (1 + np.exp(log_delta)) * mean_square / 4 == pytest.approx(1 + within[-1] / 4, rel=1e-6)


def test_beam_without_charge_is_normal_and_a_cold_one_uniform():
    u = draw("random", 3, 0, 0, 1000)
    square = np.square(thermal(u, 0.0)[:2]).sum(axis=0)
    assert square == pytest.approx(4 * (1 - u[0]), rel=1e-12)
    assert np.square(thermal(u, 1.0)[:2]).sum(axis=0) == pytest.approx(-2 * np.log(u[0]), rel=1e-12)
    # Next to the limits, from the equation: the share of a cold beam within half its edge is a quarter.
    assert np.square(thermal(u, 1 - 1e-6)[:2]).sum(axis=0) == pytest.approx(-2 * np.log(u[0]), rel=1e-4, abs=1e-4)
    inside = u[0] > 0.1  # its edge is a Debye length wide
    assert np.square(thermal(u, 0.02)[:2]).sum(axis=0)[inside] == pytest.approx(square[inside], rel=2e-3, abs=1e-3)


@pytest.mark.parametrize("depression", [0.0, 0.003, 0.02, 0.5, 0.95, 1.0])
def test_second_moments_are_one(depression):
    x = thermal(draw("sobol", 3, 0, 0, 2**14), depression)
    assert np.cov(x) == pytest.approx(np.eye(6), abs=5e-3)


@pytest.mark.parametrize("momentum", [0.0, 3 * ELECTRON_MASS * SPEED_OF_LIGHT])
@pytest.mark.parametrize("given", [{"sigma": "3 mm"}, {"emittance": "5 um rad"}, {"tune_depression": 0.4}])
def test_bunch_is_matched_and_has_what_was_asked_for(given, momentum):
    """Envelope equation at rest: K <x²> = T + q λ/(8π ε0 γ²); sizes and tune depression as measured of the particles."""
    made = make_particles(MPI.COMM_SELF, scene(momentum=[0, 0, momentum], **given))
    groups = Groups.of(made.species)
    (part,) = group_moments(MPI.COMM_SELF, Beam(made, made), groups).values()
    gamma = np.hypot(1, momentum / (ELECTRON_MASS * SPEED_OF_LIGHT))
    size = part.rms[0]
    temperature = (part.rms[3] * ELECTRON_MASS * SPEED_OF_LIGHT) ** 2 / (gamma * ELECTRON_MASS)
    assert part.rms[5] == pytest.approx(gamma * part.rms[3], rel=2e-3)  # isotropic where it rests
    own = ELEMENTARY_CHARGE * 1e-12 / LENGTH / (8 * np.pi * VACUUM_PERMITTIVITY * gamma**2)
    assert ELEMENTARY_CHARGE * 1e5 * size**2 == pytest.approx(temperature + own, rel=2e-3)
    depression = part.tune_depression(0, LENGTH)
    assert depression == pytest.approx(part.tune_depression(1, LENGTH), rel=5e-3)
    assert depression**2 == pytest.approx(temperature / (temperature + own), rel=5e-3)
    measured = {"sigma": size, "emittance": part.emittance(0), "tune_depression": depression}
    ((name, value),) = given.items()
    wanted = {"3 mm": 3e-3, "5 um rad": 5e-6}.get(value, value)
    assert measured[name] == pytest.approx(wanted, rel=2e-3)


def test_mismatch_changes_sizes_and_not_the_emittance():
    matched, wide = (across(tune_depression=0.5, mismatch=factor) for factor in (1.0, 1.5))
    assert (wide.size, wide.spread) == pytest.approx((1.5 * matched.size, matched.spread / 1.5), rel=1e-14)


def test_wave_number_is_that_of_the_element():
    momentum = 3 * ELECTRON_MASS * SPEED_OF_LIGHT
    k = np.sqrt(1e5 * ELEMENTARY_CHARGE * np.sqrt(10) * ELECTRON_MASS) / momentum  # γ m v² k² = K
    by_wave = across(momentum=[0, 0, momentum], gradient=None, wavenumber=k, sigma=3e-3)
    by_gradient = across(momentum=[0, 0, momentum], sigma=3e-3)
    assert by_wave.spread == pytest.approx(by_gradient.spread, rel=1e-12)


@pytest.mark.parametrize(
    ("bunch", "sentence"),
    [
        (
            {},
            "bunches.0.sigma is missing, as are emittance and tune_depression; give sigma, emittance or tune_depression",
        ),
        ({"sigma": 1e-3, "emittance": 1e-6}, "bunches.0.sigma is given as well as emittance; keep one of the two"),
        ({"sigma": 1e-3}, "is less than 0.001499 m"),
        ({"sigma": 1e-3, "gradient": 1e5}, "does not focus particles of -1.60218e-19 C"),
        ({"sigma": 1e-3, "gradient": None}, "bunches.0.gradient is missing, as is wavenumber"),
        ({"sigma": 1e-3, "wavenumber": 3.0}, "is given as well as wavenumber"),
        ({"sigma": 1e-3, "gradient": None, "wavenumber": 3.0}, "needs a mean momentum"),
        ({"sigma": 1e-3, "velocity": [1e6, 0, 0]}, "bunches.0.velocity ([1000000.0, 0.0, 0.0]) is not along z"),
        ({"sigma": 1e-3, "momentum_spread": 1e-25}, "is given although the temperature gives it"),
        ({"sigma": 1e-3, "gradient": [-1e5, -2e5, 0]}, "bunches.0.gradient ([-100000.0, -200000.0, 0]) is not a"),
        ({"tune_depression": 0.5, "charge": 0.0, "particles": 0}, "needs a charge"),
        ({"sigma": 1e-3, "species": {"charge": 0, "mass": 1}, "charge": 0.0, "particles": 0}, "has no charge"),
    ],
)
def test_impossible_beams_get_one_sentence(bunch, sentence):
    with pytest.raises(SceneError, match=re.escape(sentence)):
        scene(**bunch)


def test_a_domain_that_does_not_continue_the_beam_is_remarked_on():
    assert not scene(sigma=3e-3).remarks()
    (remark,) = scene(sigma=3e-3, length=LENGTH / 2).remarks()
    assert "a piece of a continuous beam" in remark


@pytest.mark.mpi(ranks=(1, 2))
def test_table_of_the_beam_says_the_tune_depression_asked_for(comm, tmp_path):
    """Of each group by its own charge; none of two species together, nor of a bunch without width."""
    given = scene(tune_depression=0.4)
    needle = {
        "distribution": "kv",
        "charge": 1e-15,
        "particles": 10,
        "sigma": [0, 1e-3, 1e-3],
        "momentum_spread": 1e-25,
    }
    bunches = [*given.to_dict()["bunches"], needle]
    output = {"directory": str(tmp_path), "write": ["series"]}
    Simulation(comm, Scene.from_dict({**given.to_dict(), "bunches": bunches, "output": output})).run()
    comm.barrier()
    rows = time_series.read(tmp_path / "beam.csv")
    found = {group: rows["tune_depression_x"][i] for i, group in enumerate(rows["group"])}
    assert found["electron"] == found["bunch_0"] == pytest.approx(0.4, rel=2e-3)
    assert np.isnan(found["all"]) and np.isnan(found["bunch_1"])
    of_needle = rows["tune_depression_y"][list(rows["group"]).index("bunch_1")]
    assert np.isnan(found["proton"]) and 0 < of_needle < 1

"""Beams that are injected through a plane by Twiss parameters, and particles that a Python function gives."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from mpi4py import MPI
from test_births import GAP, SLOW, STEP, ordered, scene

from amrpic.commands.preview import preview
from amrpic.errors import InputError, SceneError
from amrpic.pic.simulation import Simulation
from amrpic.scene.scene import Scene
from amrpic.units import ELECTRON_MASS, ELEMENTARY_CHARGE, SPEED_OF_LIGHT

TWISS = {
    "x": {"emittance": "2 mm mrad", "alpha": 1.2, "sigma": "0.5 mm"},
    "y": {"emittance": "1 mm mrad", "alpha": -0.7, "beta": "10 cm"},
}
BEAM = {"process": "injection", "energy": "300 keV", "energy_spread": "3 keV", "twiss": TWISS, "momenta": None}


def injected(source: dict[str, Any]) -> Scene:
    domain = {"lower": [-1e-2, -1e-2, 0], "upper": [1e-2, 1e-2, 2e-2], "cells": 16}
    whole = {key: value for key, value in {**BEAM, "face": "z_lower", **source}.items() if value is not None}
    motion = {"kind": "leapfrog", "dt": "2 ps"}
    return scene({}, sources=[whole], domain=domain, motion=motion, schedule={"steps": 20})


@pytest.mark.parametrize("distribution", ["gaussian", "waterbag", "kv"])
@pytest.mark.parametrize("direction", [None, [1, 0, 0]])
def test_an_injected_beam_has_its_twiss_parameters_where_it_passes(distribution, direction):
    """Of each particle, traced back to the plane on a straight line."""
    plane = {"face": None, "plane": {"direction": direction, "centre": [-5e-3, 0, 1e-2]}} if direction else {}
    pulse = {"pulse": {"shape": "flat", "length": "20 ps"}, "charge": -1e-20, "particles": 20000, "sampling": "sobol"}
    run = Simulation(MPI.COMM_SELF, injected({**pulse, "distribution": distribution, **plane}))
    run.advance(15)
    assert len(run.particles) == 20000
    along, across = (0, (2, 1)) if direction else (2, (0, 1))
    momentum = run.particles.momentum / (ELECTRON_MASS * SPEED_OF_LIGHT)
    depth = run.particles.position[:, along] - (-5e-3 if direction else 0.0)
    for name, axis in zip("xy", across, strict=True):
        middle = 1e-2 if direction and axis == 2 else 0.0
        x = run.particles.position[:, axis] - middle - depth * momentum[:, axis] / momentum[:, along]
        (xx, xp), (_, pp) = np.cov(x, momentum[:, axis])
        emittance = float(str(TWISS[name]["emittance"]).split()[0]) * 1e-6
        assert np.sqrt(xx * pp - xp**2) == pytest.approx(emittance, rel=0.02)
        assert -xp / emittance == pytest.approx(TWISS[name]["alpha"], abs=0.04)
        if name == "x":
            assert np.sqrt(xx) == pytest.approx(5e-4, rel=0.02)
    energy = run.particles.kinetic_energy / ELEMENTARY_CHARGE
    assert energy.mean() == pytest.approx(300e3, rel=1e-3) and energy.std() == pytest.approx(3e3, rel=0.03)


def test_a_direct_current_comes_evenly():
    run = Simulation(MPI.COMM_SELF, injected({"current": -1e-15, "per_step": 40}))
    run.advance(10)
    tally = run.state.tallies.of[0]
    assert tally.particles == 400 and tally.charge == pytest.approx(-1e-15 * 10 * 2e-12)
    assert sum(tally.map) == pytest.approx(tally.charge)


@pytest.mark.parametrize(
    ("source", "words"),
    [
        ({"energy": None}, "energy"),
        ({"twiss": None}, "twiss"),
        ({"twiss": {"x": TWISS["x"]}}, "y is missing"),
        ({"twiss": {**TWISS, "x": {"emittance": 1e-6}}}, "is missing, as is sigma"),
        ({"spot": {"shape": "disc", "radius": 1}}, "spot"),
        ({"distribution": "round"}, "distribution"),
        ({"energy_spread": -1}, "energy_spread"),
    ],
)
def test_bad_injections_are_refused_in_one_sentence(source, words):
    with pytest.raises(SceneError) as refused:
        injected({"current": -1e-15, "per_step": 4, **source})
    text = str(refused.value)
    assert words in text and "sources.0" in text and "; " in text and "\n" not in text


def four(start: float, stop: float) -> tuple[np.ndarray, ...]:
    """Four particles a step on the lower plane, evenly in time."""
    time = start + (stop - start) * (np.arange(4) + 0.5) / 4
    place = np.tile([5e-4, 5e-4, 0.0], (4, 1))
    return time, place, np.tile([0, 0, SLOW * ELECTRON_MASS], (4, 1)), np.full(4, 2.0)


def of_function(function: Any) -> Scene:
    return scene({}, sources=[{"process": "function", "function": function}], domain=GAP)


@pytest.mark.mpi(ranks=(1, 2))
def test_a_function_gives_what_is_born(comm, tmp_path):
    folder = comm.bcast(tmp_path)
    whole = Simulation(comm, of_function(four))
    whole.advance(5)
    whole.checkpoint(folder / "half")
    rest = Simulation.restart(comm, folder / "half", of_function(four))
    whole.advance(5), rest.advance(5)
    table = ordered(comm, whole)
    np.testing.assert_array_equal(ordered(comm, rest), table)
    age = STEP * (10 - (np.arange(40) + 0.5) / 4)
    np.testing.assert_allclose(table[:, 3], SLOW * age, rtol=1e-4)
    assert whole.state.tallies.of[0].charge == pytest.approx(-80 * ELEMENTARY_CHARGE)


def test_a_preview_counts_an_injected_beam_and_calls_no_function(tmp_path):
    def never(start: float, stop: float) -> Any:
        raise AssertionError("called")

    beam = injected({"current": "-1 A", "per_step": 20}).sources[0]
    both = scene({}, sources=[beam, {"process": "function", "name": "own", "function": never}])
    text = preview(MPI.COMM_SELF, both.replace(output={"directory": str(tmp_path), "write": []}), 1)
    assert "sources give 400 particles of given charge until the last step" in text
    assert "what own gives is known in the run alone, and not counted" in text


@pytest.mark.parametrize(
    ("function", "words"),
    [
        (lambda start, stop: four(start, stop)[:3], "values to unpack"),
        (lambda start, stop: four(start + 1, stop + 1), "outside of the step"),
        (lambda start, stop: (*four(start, stop)[:3], np.ones(3)), "must return times"),
        (lambda start, stop: (*four(start, stop)[:3], np.full(4, np.nan)), "not finite"),
    ],
)
def test_bad_functions_are_refused_in_one_sentence(function, words):
    run = Simulation(MPI.COMM_SELF, of_function(function))
    with pytest.raises(InputError, match=words):
        run.advance()


def test_a_function_is_needed():
    with pytest.raises(SceneError, match="no Python function"):
        of_function(None)

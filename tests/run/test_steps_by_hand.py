"""A simulation stepped from Python: the same states as a run, which goes on with its files where it is."""

from __future__ import annotations

import logging
from pathlib import Path

import numpy as np
import pytest

import amrpic
from amrpic.io import time_series


def scene(folder: Path) -> amrpic.Scene:
    return amrpic.Scene(
        domain=amrpic.Domain(-0.1, 0.1, 16),
        bunches=[amrpic.GaussianBunch(species="electron", sigma=0.01, charge="-10 pC", particles=500)],
        motion=amrpic.Leapfrog(dt="50 ps"),
        schedule={"steps": 5},
        output={"directory": str(folder), "write": ["series"]},
    )


@pytest.mark.mpi(ranks=(1, 2))
def test_steps_are_those_of_a_run(comm, tmp_path):
    whole = amrpic.Simulation(comm, scene(tmp_path / "whole"))
    whole.run(log="silent")
    stepped = amrpic.Simulation(comm, scene(tmp_path / "stepped"))
    assert stepped.advance().step == 1
    assert stepped.advance(2).step == 3
    assert [state.step for state in stepped] == [4, 5]
    np.testing.assert_array_equal(stepped.state.particles.position, whole.state.particles.position)
    assert not (tmp_path / "stepped").exists()
    assert stepped.advance().step == 6  # beyond the scene, if asked for


def test_a_run_goes_on_from_steps_by_hand(tmp_path):
    simulation = amrpic.Simulation(scene(tmp_path))
    simulation.advance(2)
    simulation.run(log="silent")
    assert time_series.read(tmp_path / "series.csv")["step"].tolist() == [2, 3, 4, 5]
    simulation.advance()
    simulation.run(log="silent")
    assert time_series.read(tmp_path / "series.csv")["step"].tolist() == [2, 3, 4, 5, 6]


def test_a_run_is_silent_or_logs_on_demand(tmp_path, capfd, caplog):
    amrpic.Simulation(scene(tmp_path)).run(log="silent")
    with caplog.at_level(logging.INFO, logger="amrpic.run"):
        amrpic.Simulation(scene(tmp_path)).run(log="logging")
    assert capfd.readouterr().out == ""
    assert sum(record.message.startswith("step ") for record in caplog.records) == 6


def test_a_simulation_shows_where_it_is(tmp_path):
    simulation = amrpic.Simulation(scene(tmp_path))
    simulation.advance(2)
    assert repr(simulation) == "Simulation('scene': step 2, time 100 ps, levels 1, cells 4096, ranks 1)"

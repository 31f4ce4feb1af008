"""What a run with sources writes: a table of them, their particles as groups, and a restart that goes on with both."""

from __future__ import annotations

import numpy as np
import pytest
from mpi4py import MPI

from amrpic.commands.preview import preview
from amrpic.io import time_series
from amrpic.pic.simulation import Simulation
from amrpic.results import report_page
from amrpic.scene.scene import Scene
from amrpic.view import emission_plots


def scene(folder, steps: int) -> Scene:
    return Scene.from_dict(
        {
            "domain": {"lower": [0, 0, 0], "upper": [1e-3, 1e-3, 1e-2], "cells": [4, 4, 32], "boundary": "dirichlet"},
            "sources": [
                {
                    "process": "given",
                    "name": "gun",
                    "face": "z_lower",
                    "pulse": {"shape": "flat", "start": "0.5 ns", "length": "1 ns"},
                    "charge": "-1 fC",
                    "particles": 500,
                    "momenta": {"kind": "beam", "energy": "10 eV"},
                },
                {
                    "process": "given",
                    "face": "z_upper",
                    "species": "proton",
                    "current": "1 nA",
                    "per_step": 5,
                    "momenta": {"kind": "beam", "energy": "100 keV"},
                },
            ],
            "motion": {"kind": "leapfrog", "dt": "0.1 ns"},
            "schedule": {"steps": steps},
            "diagnostics": {"every": 5},
            "output": {"directory": str(folder), "write": ["series", "checkpoint"], "checkpoint_every": 10},
        }
    )


def test_a_run_tells_what_its_sources_gave(tmp_path):
    Simulation(scene(tmp_path, 20)).run(log="silent")
    table = time_series.read(tmp_path / "sources.csv")
    gun = np.array(table["source"]) == "gun"
    assert set(table["source"]) == {"gun", "source_1"}
    assert table["born_particles"][gun][-1] == 500 and table["born_particles"][gun][4] == 0
    np.testing.assert_allclose(table["born_charge"][gun][-1], -1e-15, rtol=1e-12)
    np.testing.assert_allclose(
        table["born_charge"][gun], np.cumsum(table["current"][gun]) * 1e-10, rtol=1e-9, atol=1e-30
    )
    np.testing.assert_allclose(table["current"][~gun][1:], 1e-9, rtol=1e-9)
    places = time_series.read(tmp_path / "emission.csv")
    of_gun = places[places["source"] == "gun"]
    assert len(of_gun) == 32**2 and of_gun["area"].sum() == pytest.approx(1e-6)
    assert of_gun["charge"].sum() == pytest.approx(-1e-15)
    x = np.average(of_gun["x"], weights=of_gun["charge"])
    assert x == pytest.approx(5e-4, abs=5 * 1e-3 / np.sqrt(12 * 500))
    names = [name for name, _ in emission_plots.figures(tmp_path)]
    assert names == ["current of sources", "emission of gun", "emission of source_1"]
    assert "emission of gun" in report_page.make(tmp_path)
    beam = time_series.read(tmp_path / "beam.csv")
    assert set(beam["group"]) == {"all", "electron", "proton", "gun", "source_1"}
    last = (np.array(beam["group"]) == "gun") & (beam["step"] == 20)
    assert beam["particles"][last] + beam["lost_particles"][last] == 500


def test_a_restart_goes_on_with_the_table(tmp_path):
    whole, cut = tmp_path / "whole", tmp_path / "cut"
    Simulation(scene(whole, 20)).run(log="silent")
    Simulation(scene(cut, 10)).run(log="silent")
    Simulation.restart(cut / "checkpoint_00000010", scene(cut, 20)).run(log="silent")
    one, other = (time_series.read(folder / "sources.csv") for folder in (whole, cut))
    maps = [time_series.read(folder / "emission.csv")["charge"] for folder in (whole, cut)]
    np.testing.assert_array_equal(maps[0], maps[1])
    for column in ("step", "time", "source", "born_particles", "born_charge", "current"):
        np.testing.assert_array_equal(one[column], other[column])


def test_a_preview_counts_what_will_be_born(tmp_path):
    text = preview(MPI.COMM_SELF, scene(tmp_path, 20), 1)
    assert "sources give 600 particles of given charge until the last step" in text
    hot = scene(tmp_path, 20).replace(motion={"kind": "leapfrog", "dt": "auto"})
    assert "motion.dt is chosen once the first field is known" in preview(MPI.COMM_SELF, hot, 1)

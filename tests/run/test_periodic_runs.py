"""A bunch is refined, measured and drawn alike wherever it is in a periodic domain."""

from __future__ import annotations

import csv

import numpy as np
import pytest

from amrpic import Scene, Simulation
from amrpic.io import particle_reader
from amrpic.mesh.periods import nearest
from amrpic.results import comparison
from amrpic.results.run_results import Results
from amrpic.view import phase_space_plots


def scene_of(folder, centre, write=("series",), **more):
    return Scene.from_dict(
        {
            "background": "neutralizing",
            "domain": {"lower": "-20 mm", "upper": "20 mm", "cells": 32, "boundary": "periodic"},
            "bunches": [
                {
                    "distribution": "gaussian",
                    "species": "electron",
                    "sigma": "1 mm",
                    "charge": "-1 pC",
                    "particles": 20000,
                    "momentum_spread": "1 keV/c",
                    "centre": centre,
                }
            ],
            "diagnostics": {"every": 1, "slices": 4},
            "output": {"write": list(write), "directory": str(folder)},
            **more,
        }
    )


def table_of(path):
    with path.open() as file:
        return list(csv.DictReader(line for line in file if not line.startswith("#")))


@pytest.mark.mpi(ranks=(1, 2, 4))
@pytest.mark.parametrize("axes", ["xyz", "xy"])
def test_the_radius_rule_refines_as_many_cells_wherever_the_bunch_is(comm, tmp_path, axes):
    refinement = {"levels": 1, "rule": {"kind": "radius", "axes": axes, "at_most": 3}}
    cells = []
    for centre in ([0, 0, 0], [0, 0, "20 mm"], ["-20 mm", "10 mm", "70 mm"]):
        simulation = Simulation(comm, scene_of(tmp_path, centre, (), refinement=refinement))
        cells.append(simulation.hierarchy.cells())
        assert simulation.remarks == []
    assert cells[0] == cells[1] == cells[2] > 32**3


@pytest.mark.mpi(ranks=(1, 3))
def test_tables_of_a_bunch_on_a_face_are_those_of_one_in_the_middle(comm, tmp_path):
    rows = {}
    for name, centre in (("middle", [0, 0, 0]), ("face", ["20 mm", 0, "-20 mm"])):
        Simulation(comm, scene_of(tmp_path / name, centre, refinement={"levels": 0})).run(log="silent")
        comm.barrier()
        rows[name] = [table_of(tmp_path / name / of)[0] for of in ("series.csv", "beam.csv", "slices.csv")]
    for middle, face in zip(rows["middle"], rows["face"], strict=True):
        same = [name for name in middle if name.startswith(("rms_", "emittance", "halo", "radius", "cov_", "moment_"))]
        assert len(same) >= 6
        for name in same:
            assert float(face[name]) == pytest.approx(float(middle[name]), rel=1e-9, abs=1e-16), name
    moved = float(rows["face"][0]["mean_z"]) - float(rows["middle"][0]["mean_z"])
    assert abs(moved) == pytest.approx(0.02, abs=1e-9) and abs(float(rows["face"][0]["mean_z"])) <= 0.02
    assert float(rows["face"][1]["max_z"]) - float(rows["face"][1]["min_z"]) < 0.01


def test_a_picture_of_phase_space_shows_a_bunch_on_a_face_in_one_piece(tmp_path):
    Simulation(scene_of(tmp_path, [0, 0, "20 mm"], ("particles", "checkpoint"), refinement={"levels": 0})).run(
        log="silent"
    )
    for path in (next(tmp_path.glob("particles_*.h5")), next(tmp_path.glob("checkpoint_*"))):
        ((_, figure),) = phase_space_plots.figures(particle_reader.read(path), ["z-pz"])
        plane = next(axes for axes in figure.axes if axes.get_xlabel().startswith("z"))
        left, right = plane.get_xlim()
        assert 6 < right - left < 16  # mm


def test_particles_that_rounding_takes_through_a_face_are_compared_where_they_are(tmp_path):
    for name, centre in (("one", "20 mm"), ("other", "19.999999999 mm")):
        scene = scene_of(tmp_path / name, [0, 0, centre], ("series", "particles"), refinement={"levels": 0}).to_dict()
        scene["bunches"][0]["sigma"] = ["1 mm", "1 mm", 0]
        Simulation(Scene.from_dict(scene)).run(log="silent")
    runs = [Results.open(tmp_path / name) for name in ("one", "other")]
    found = {one.what: one.relative for one in comparison._particles(*runs)}
    assert found["position over its rms"] < 1e-9
    z = [particle_reader.read(next(run.folder.glob("particles_*.h5"))).particles.position[:, 2] for run in runs]
    assert np.abs(z[1] - z[0]).max() > 0.039 and np.abs(nearest(z[1] - z[0], 0.04)).max() < 2e-12


@pytest.mark.mpi(ranks=(1, 2))
@pytest.mark.parametrize(("sigma", "remarked"), [("1 mm", False), ("6 mm", False), ("9 mm", True), ("50 mm", True)])
def test_a_beam_that_fills_its_period_draws_one_remark(comm, tmp_path, sigma, remarked):
    scene = scene_of(tmp_path, [0, 0, 0], refinement={"levels": 0}).to_dict()
    scene["bunches"][0]["sigma"] = ["1 mm", "1 mm", sigma]
    simulation = Simulation(comm, Scene.from_dict(scene))
    simulation.run(log="silent")
    about = [one for one in simulation.remarks if "takes up the period along z" in one]
    assert bool(about) == remarked and len(about) <= 2  # of all particles, and of the bunch, which has the same


def test_files_of_a_window_know_where_its_periods_are(tmp_path):
    """So that a bunch on a face is in one piece in pictures of either. Where all faces are open the domain may have turned."""
    for faces in ("periodic", "open"):
        scene = scene_of(tmp_path / faces, [0, 0, 0], ("particles", "checkpoint")).to_dict()
        scene["domain"] |= {"cells": 8, "boundary": faces}
        scene["background"] = "none" if faces == "open" else "neutralizing"
        scene["bunches"][0] |= {
            "centre": [0, 0, 0.02 if faces == "periodic" else 0],
            "kinetic_energy": "2 MeV",
            "charge": -1e-15,
        }
        scene |= {"motion": {"kind": "leapfrog", "dt": "30 ps", "window": "reference"}, "schedule": {"steps": 9}}
        run = Simulation(Scene.from_dict(scene))
        run.run(log="silent")
        written, held = (
            particle_reader.read(tmp_path / faces / name) for name in ("particles_00000009.h5", "checkpoint_00000009")
        )
        if faces == "open":
            assert run.window.origin[2] > 0.07 and written.domain is None
            continue
        assert written.domain == held.domain == run.window.shown(run.hierarchy.domain) != run.hierarchy.domain
        for dump in written, held:
            z = dump.particles.position[:, 2]
            assert written.domain.lower[2] <= z.min() < z.max() <= written.domain.upper[2] and np.ptp(z) > 0.039
            ((_, figure),) = phase_space_plots.figures(dump, ["z-pz"])
            left, right = next(axes for axes in figure.axes if axes.get_xlabel().startswith("z")).get_xlim()
            assert 6 < right - left < 16  # mm

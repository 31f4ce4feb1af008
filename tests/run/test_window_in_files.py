"""Meshes and particles of a window meet in all that a run writes, whoever reads it."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from mpi4py import MPI

import amrpic
from amrpic.io.field_reader import LiveDump, open_dump
from amrpic.io.provenance import Moment
from amrpic.pic.course import Course
from amrpic.results.comparison import compare
from vtk_files import vtk_read

Points = tuple[np.ndarray, np.ndarray]  # places (n, 3) in m, and a weight of each (n,)
STEPS = 30


def scene(folder: Path, **changes: Any) -> amrpic.Scene:
    """Electrons that fly 0.18 m, 20 lengths of the mesh that goes with them."""
    parts = {
        "domain": {"lower": "-4 mm", "upper": "4 mm", "cells": 16},
        "bunches": [
            {
                "distribution": "gaussian",
                "species": "electron",
                "kinetic_energy": "2 MeV",
                "sigma": "0.5 mm",
                "cutoff": 3.5,
                "charge": "-1 pC",
                "particles": 4000,
            }
        ],
        "motion": {"kind": "leapfrog", "dt": "20 ps", "window": "reference"},
        "schedule": {"steps": STEPS},
        "output": {"directory": str(folder), "write": ["fields", "particles", "series", "checkpoint", "pictures"]},
    }
    return amrpic.Scene.from_dict(parts | changes)


def centre(points: Points) -> np.ndarray:
    """The mean place (3,) by weights, in m."""
    places, weights = points
    return weights @ places / weights.sum()


def on_grid(values: np.ndarray, axes: list[np.ndarray]) -> Points:
    """Cells of a mesh on (z, y, x)."""
    z, y, x = np.meshgrid(*axes, indexing="ij")
    return np.stack([x.ravel(), y.ravel(), z.ravel()], axis=1), np.nan_to_num(values).ravel()


def by_viewer(folder: Path) -> tuple[Points, Points]:
    viewer = pytest.importorskip("openpmd_viewer")
    series = viewer.OpenPMDTimeSeries(str(folder / "openpmd"), check_all_files=False)
    values, info = series.get_field("rho", iteration=STEPS)
    x, y, z, w = series.get_particle(["x", "y", "z", "w"], species="electron", iteration=STEPS)
    return on_grid(values, [info.z, info.y, info.x]), (np.stack([x, y, z], axis=1), w)


def by_api(folder: Path) -> tuple[Points, Points]:
    api = pytest.importorskip("openpmd_api")
    series = api.Series(str(folder / "openpmd" / "openpmd_%T.h5"), api.Access.read_only)
    iteration = series.iterations[STEPS]
    rho, electron = iteration.meshes["rho"], iteration.particles["electron"]
    values = rho[api.Mesh_Record_Component.SCALAR].load_chunk()
    weight = electron["weighting"][api.Mesh_Record_Component.SCALAR].load_chunk()
    place, offset = ([electron[name][axis].load_chunk() for axis in "xyz"] for name in ("position", "positionOffset"))
    series.flush()
    axes = [
        lower + width * (np.arange(n) + 0.5)
        for lower, width, n in zip(rho.grid_global_offset, rho.grid_spacing, values.shape, strict=True)
    ]
    return on_grid(values, axes), (np.stack(place, axis=1) + np.stack(offset, axis=1), weight)


def by_vtk_and_beamphysics(folder: Path) -> tuple[Points, Points]:
    beamphysics = pytest.importorskip("beamphysics")
    amr, parts = vtk_read(folder / f"fields_{STEPS:08d}.vtkhdf"), []
    for block in range(amr.GetNumberOfBlocks(0)):
        data = amr.GetDataSetAsImageData(0, block)
        cells, rho = np.array(data.GetDimensions()) - 1, data.GetCellData().GetArray("rho")
        low, high = np.reshape(data.GetBounds(), (3, 2)).T
        axes = [a + (b - a) / n * (np.arange(n) + 0.5) for a, b, n in zip(low, high, cells, strict=True)]
        values = np.array([rho.GetValue(i) for i in range(int(cells.prod()))]).reshape(cells[::-1])
        parts.append(on_grid(values, axes[::-1]))
    group = beamphysics.ParticleGroup(str(folder / f"particles_{STEPS:08d}.h5"))
    places, weights = zip(*parts, strict=True)
    particles = np.stack([group.x, group.y, group.z], axis=1), group.weight
    return (np.concatenate(places), np.concatenate(weights)), particles


def by_yt(folder: Path) -> Points:
    yt = pytest.importorskip("yt")
    yt.set_log_level("error")
    data = yt.load(str(folder / f"fields_{STEPS:08d}.vtkhdf")).all_data()
    return np.stack([data["index", axis].to_value("m") for axis in "xyz"], axis=1), data["gdf", "rho"].v


def by_amrpic(path: Path) -> tuple[Points, Points]:
    """From a folder or a checkpoint."""
    found = amrpic.open(MPI.COMM_SELF, path)
    patches = found.fields[STEPS].rho.patches
    places = [np.stack(np.broadcast_arrays(*patch.centres()), axis=-1).reshape(-1, 3) for patch in patches]
    values = [patch.data.ravel() for patch in patches]
    beam = found.particles(STEPS)
    return (np.concatenate(places), np.concatenate(values)), (beam.position, beam.weight)


@pytest.mark.mpi(ranks=(1, 2))
def test_charge_of_meshes_and_of_particles_has_one_centre(comm: MPI.Comm, tmp_path: Path) -> None:
    """Clouds-in-cells keep the centre of charge, so that of ρ is the mean place of the particles, to rounding of 0.18 m."""
    run = amrpic.Simulation(comm, scene(tmp_path))
    run.run(log="silent")
    if comm.rank > 0:
        return
    at = run.window.origin
    readers = {"viewer": by_viewer, "api": by_api, "vtk": by_vtk_and_beamphysics}
    found = {name: read(tmp_path) for name, read in readers.items()}
    found |= {"folder": by_amrpic(tmp_path), "checkpoint": by_amrpic(tmp_path / f"checkpoint_{STEPS:08d}")}
    mean = centre(found["folder"][1])
    assert abs(mean[2] - 0.176) < 1e-3 and at[2] > 20 * 0.008
    for name, (rho, particles) in found.items():
        np.testing.assert_allclose(centre(rho), mean, rtol=0, atol=1e-14, err_msg=name)
        np.testing.assert_allclose(centre(particles), mean, rtol=0, atol=1e-14, err_msg=name)
    np.testing.assert_allclose(centre(by_yt(tmp_path)), mean, rtol=0, atol=1e-14)
    live = LiveDump(tmp_path, run.hierarchy, {"phi": run.phi}, Moment(STEPS, run.time, run.window))
    with open_dump(tmp_path) as fields, open_dump(tmp_path / f"checkpoint_{STEPS:08d}") as kept:
        for dump in fields, kept, live:  # what pictures show
            np.testing.assert_array_equal(dump.lower, np.array(run.scene.domain.lower) + at)
            np.testing.assert_array_equal(dump.upper, np.array(run.scene.domain.upper) + at)
    # as the run itself, in the coordinates of the mesh
    here, there = run.phi, amrpic.open(MPI.COMM_SELF, tmp_path).fields[STEPS].phi
    places = np.array([[0.0, 0.0, 0.0], [1e-3, -2e-3, 5e-4]])
    if comm.size == 1:
        np.testing.assert_allclose(there.sample(places + at), here.sample(places), rtol=1e-11)
        assert compare(tmp_path, tmp_path).equal(1e-12)


def test_a_turned_mesh_is_shown_about_the_reference_particle(tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    """Along the axes of the laboratory: what lies r from the particle there lies W r from it as shown, W the window's axes."""
    bunch = scene(tmp_path).to_dict()["bunches"][0] | {"centre": [0.001, 0, 0.001], "direction": [0, 0.6, 0.8]}
    run = amrpic.Simulation(
        MPI.COMM_SELF,
        scene(
            tmp_path,
            bunches=[bunch],
            motion={"kind": "leapfrog", "dt": "20 ps", "window": "reference", "frame": "rest"},
        ),
    )
    run.run()
    assert run.reference is not None and run.window.is_turned
    reference = np.array(run.reference.position)
    for found in by_viewer(tmp_path), by_api(tmp_path), by_vtk_and_beamphysics(tmp_path), by_amrpic(tmp_path):
        rho, particles = found
        offset = np.array(run.window.axes) @ (centre(particles) - reference)
        assert 1e-6 < np.abs(offset).max() < 1e-4
        np.testing.assert_allclose(centre(rho) - reference, offset, rtol=0, atol=2e-14)
    assert re.search(r"have its corners 4\.05\d* mm beside their places", capfd.readouterr().err)
    with open_dump(tmp_path) as dump:
        assert dump.window == run.window
    course = run.state.course.to_dict()
    assert Course.from_dict(course) == run.state.course
    del course["window"]["pivot"]  # which older checkpoints lack
    assert Course.from_dict(course).window.pivot == (0, 0, 0)


def test_a_window_goes_with_a_bunch_of_arrays_that_is_turned(tmp_path: Path) -> None:
    """Along the axis to which its momenta, given along its own z, are turned."""
    bunch = {
        "distribution": "arrays",
        "position": np.random.default_rng(1).normal(0, 5e-4, (500, 3)),
        "species": "electron",
        "kinetic_energy": "2 MeV",
        "charge": "-1 fC",
        "axis": [1, 0, 0],
        "roll": "30 deg",
        "shift": ["1 mm", 0, 0],
    }
    run = amrpic.Simulation(MPI.COMM_SELF, scene(tmp_path, bunches=[bunch]))
    before = run.particles.position.mean(axis=0)
    run.advance(5)
    assert run.window.origin == pytest.approx((5 * 20e-12 * 0.979 * 2.998e8, 0, 0), rel=1e-3)
    assert len(run.lost) == 0
    assert run.particles.position.mean(axis=0) == pytest.approx(before, abs=1e-6)

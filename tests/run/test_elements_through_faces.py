"""Elements that reach through periodic faces: they repeat with the domain, and a beam is the same wherever the faces are."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pytest
from mpi4py import MPI

import amrpic
from amrpic.errors import InputError
from amrpic.external import ExternalFields
from amrpic.pic.limits import check_scene
from amrpic.units import ELECTRON_MASS, SPEED_OF_LIGHT

MC = ELECTRON_MASS * SPEED_OF_LIGHT
PERIOD = 0.04  # m
WALLS = {"x": "dirichlet", "y": "dirichlet", "z": "periodic"}
ENGE = {"fringe": "enge", "gap": "2 mm"}
KINDS: dict[str, dict[str, Any]] = {
    "uniform": {"kind": "uniform", "length": 0.01, "electric_field": [1e5, 2e5, 3e5], "magnetic_field": [0.1, 0, -0.1]},
    "as long as the domain": {"kind": "uniform", "length": PERIOD, "electric_field": [1e5, 2e5, 3e5]},
    "focusing": {"kind": "constant-focusing", "length": 0.01, "gradient": [1e6, -2e6, 3e6]},
    "quadrupole": {"kind": "quadrupole", "length": 0.01, "gradient": 1},
    "fringed quadrupole": {"kind": "quadrupole", "length": 0.01, "gradient": 1, **ENGE},
    "tilted quadrupole": {
        "kind": "quadrupole",
        "length": 0.01,
        "gradient": 1,
        "direction": [0.3, -0.1, -1],
        "roll": 0.4,
    },
    "dipole": {"kind": "dipole", "length": 0.01, "field": 0.01, "entrance_angle": 0.3, "exit_angle": -0.2},
    "solenoid": {"kind": "solenoid", "length": 0.01, "field": 0.3},
    "gap": {"kind": "rf-gap", "length": 0.01, "voltage": 1e3, "frequency": 1e9, "phase": 0.3},
    "cavity": {"kind": "cavity", "length": 0.01, "field": 1e6, "frequency": 1e9},
}


def scene(elements: list[dict[str, Any]], shift: float = 0.0, u: float = 1.0, **more: Any) -> dict[str, Any]:
    """Electrons in a pipe that repeats along z, moved by a shift (m), with their elements."""
    rng = np.random.default_rng(4)
    x = rng.normal(size=(200, 3)).clip(-2.5, 2.5) * 1e-3 + (0, 0, shift - 0.01)
    momenta = (rng.normal(size=(200, 3)) * (0.01, 0.01, 0.02) + (0, 0, u)) * MC
    return {
        "domain": {"lower": [-0.01, -0.01, -PERIOD / 2], "upper": [0.01, 0.01, PERIOD / 2]}
        | {"cells": [8, 8, 16], "boundary": WALLS},
        "bunches": [
            {"distribution": "arrays", "species": "electron", "position": x, "momenta": momenta, "charge": -1e-11}
        ],
        "elements": [{**one, "centre": [*one.get("centre", [0, 0, 0])[:2], shift]} for one in elements],
        "solver": {"tolerance": 1e-12},
        "motion": {"kind": "leapfrog", "dt": "3 ps"},
        "output": {"write": []},
        **more,
    }


@pytest.mark.parametrize("kind", KINDS)
def test_fields_repeat_with_the_domain(kind):
    """Those at a place, and the means along flights, are the sum over all images of the place."""
    given = amrpic.Scene.from_dict(scene([KINDS[kind]], shift=0.017))
    alone, repeated = ExternalFields(given.elements), ExternalFields.of_scene(given)
    rng = np.random.default_rng(2)
    x = rng.uniform((-8e-3, -8e-3, -PERIOD / 2), (8e-3, 8e-3, PERIOD / 2), (400, 3))
    v = rng.normal(size=(400, 3)) * (2e7, 2e7, 2e8)
    shifts = [np.array([0, 0, n * PERIOD]) for n in range(-4, 5)]
    for start, stop in ((0.0, 0.0), (-2e-11, 0.0), (0.0, 4e-11)):
        found = np.hstack(repeated.means(x, v, 1e-10, start, stop))
        expected = sum(np.hstack(alone.means(x + shift, v, 1e-10, start, stop)) for shift in shifts)
        scale = np.abs(expected).max(axis=0)
        assert scale.max() > 0
        np.testing.assert_allclose(found / (scale + 1e-30), expected / (scale + 1e-30), rtol=0, atol=1e-11)


def test_the_field_of_a_coil_hardly_ends_at_a_face():
    """It never ends; of two places that are one, it differs by the field of a coil one and a half periods off."""
    coil = {"kind": "solenoid", "length": 0.01, "field": 0.3, "fringe": "sheet", "radius": "4 mm"}
    repeated = ExternalFields.of_scene(amrpic.Scene.from_dict(scene([coil])))
    lower, upper = repeated.fields([[1e-3, 5e-4, -PERIOD / 2], [1e-3, 5e-4, PERIOD / 2]])[1]
    assert np.abs(upper - lower).max() < 1e-5 * 0.3


def test_a_map_repeats_too(tmp_path: Path):
    with h5py.File(tmp_path / "map.h5", "w") as h5:
        h5.attrs.update({"openPMD": "1.1.0", "basePath": "/data/%T/", "meshesPath": "fields/"})
        B = h5.create_group("data/0/fields/B")
        B.attrs.update({"geometry": "cartesian", "dataOrder": "C", "gridUnitSI": 1.0})
        B.attrs["axisLabels"] = np.array(["x", "y", "z"], dtype="S")
        B.attrs["gridSpacing"], B.attrs["gridGlobalOffset"] = [0.01, 0.01, 0.001], [-0.02, -0.02, -0.005]
        B.attrs["unitDimension"] = [0.0, 1, -2, -1, 0, 0, 0]
        B["y"] = np.tile(np.sin(np.pi * np.arange(11) / 10) ** 2, (5, 5, 1))
    given = amrpic.Scene.from_dict(scene([{"kind": "map", "file": str(tmp_path / "map.h5")}], shift=0.019))
    z = np.array([-0.0195, -0.0185, -0.017, -0.012, 0.015, 0.018])
    found = ExternalFields.of_scene(given).fields(np.column_stack([0 * z, 0 * z, z]))[1][:, 1]
    along = (z - 0.019 + PERIOD / 2) % PERIOD - PERIOD / 2
    expected = np.where(np.abs(along) < 0.005, np.sin(np.pi * (along + 0.005) / 0.01) ** 2, 0)
    np.testing.assert_allclose(found, expected, atol=2e-3)


@pytest.mark.mpi(ranks=(1, 2))
@pytest.mark.parametrize("kind", ["quadrupole", "dipole", "solenoid", "gap"])
def test_a_beam_passes_an_element_on_a_face_as_one_in_the_middle(comm, kind):
    """Half a period further up, by whole cells: momenta are the same, also where a step crosses an end behind the face."""
    momenta = []
    for shift in (0.0, PERIOD / 2):
        run = amrpic.Simulation(comm, amrpic.Scene.from_dict(scene([KINDS[kind]], shift)))
        run.advance(30)
        ids = np.concatenate(comm.allgather(run.particles.id))
        momenta.append(np.concatenate(comm.allgather(run.particles.momentum))[np.argsort(ids)] / MC)
        assert len(ids) > 150
    np.testing.assert_allclose(momenta[1], momenta[0], rtol=0, atol=1e-9)


def test_an_element_over_all_of_the_domain_has_no_ends_and_a_longer_one_no_place():
    long = {**KINDS["quadrupole"], "length": 0.3}
    places = np.random.default_rng(1).uniform(-0.5, 0.5, (50, 3)) * (0.01, 0.01, PERIOD)
    B = ExternalFields.of_scene(amrpic.Scene.from_dict(scene([long], shift=0.1))).fields(places)[1]
    np.testing.assert_allclose(B, np.column_stack([places[:, 1], places[:, 0], 0 * places[:, 0]]), atol=1e-15)
    given = amrpic.Scene.from_dict(scene([KINDS["gap"], long], shift=0.15))
    with pytest.raises(InputError, match=r"^elements\.1 is"):
        check_scene(given, ranks=1)
    with pytest.raises(
        InputError, match=r"elements\.1 is 0\.3 m long, where space repeats along z after 0\.04 m, .*shorten it"
    ):
        amrpic.Simulation(MPI.COMM_SELF, given)


def test_elements_do_not_repeat_where_the_mesh_moves():
    """Each electron meets a quadrupole once, as it does where no face is periodic."""
    ahead = {**KINDS["quadrupole"], "centre": [0, 0, 0]}
    reference = {"species": "electron", "position": [0, 0, -0.01], "momentum": [0, 0, MC]}
    motion = {"kind": "leapfrog", "dt": "3 ps", "window": "reference", "reference": reference}
    given = scene([ahead], motion=motion)
    given["bunches"][0]["charge"] = -1e-30
    boxes = {"periodic": WALLS, "open": {"x": "dirichlet", "y": "dirichlet", "z": "open"}}
    momenta = []
    for walls in boxes.values():
        run = amrpic.Simulation(
            MPI.COMM_SELF, amrpic.Scene.from_dict({**given, "domain": given["domain"] | {"boundary": walls}})
        )
        run.advance(80)
        assert run.window.origin[2] > 1.2 * PERIOD and len(run.particles) == 200
        momenta.append(run.particles.momentum[np.argsort(run.particles.id)] / MC)
    np.testing.assert_allclose(momenta[0], momenta[1], rtol=0, atol=1e-12)

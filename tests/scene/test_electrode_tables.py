"""The table [[electrodes]]: shapes with units, files, combinations, and one sentence for each mistake with the key's place."""

from __future__ import annotations

import tomllib
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from amrpic import Scene, shapes
from amrpic.errors import InputError, SceneError
from amrpic.pic.driven_electrodes import compared_electrodes
from amrpic.scene.electrode_shapes import Formula

DOMAIN = {"lower": -0.02, "upper": 0.02, "cells": 16, "boundary": "dirichlet"}
BALL = {"kind": "sphere", "radius": "1 mm"}


def scene(shape: Any, **drive: Any) -> Scene:
    return Scene.from_dict(
        {"domain": DOMAIN, "electrodes": [{"name": "a", "shape": shape, **(drive or {"voltage": 1})}]}
    )


@pytest.mark.parametrize(
    "table, body",
    [
        (BALL, shapes.Sphere((0, 0, 0), 1e-3)),
        ({"kind": "box", "lower": "-5 mm", "upper": [0.01, "2 cm", 1]}, shapes.Box((-0.005,) * 3, (0.01, 0.02, 1))),
        (
            {"kind": "cylinder", "start": [0, 0, "1 mm"], "end": [0, 0, 1], "radius": "2 um"},
            shapes.Cylinder((0, 0, 1e-3), (0, 0, 1), 2e-6),
        ),
        (
            {"kind": "cone", "start": 0, "end": [0, 0, 1], "radius_start": 0, "radius_end": "3 mm"},
            shapes.Cone((0, 0, 0), (0, 0, 1), 0, 3e-3),
        ),
        (
            {"kind": "torus", "axis": [1, 2, 3], "radius": "3 mm", "tube": "1 mm"},
            shapes.Torus((0, 0, 0), (1, 2, 3), 3e-3, 1e-3),
        ),
        ({"kind": "plane", "point": [0, 0, "1 mm"], "normal": "z"}, shapes.Plane((0, 0, 1e-3), (0, 0, 1))),
        ({"kind": "disk", "normal": "x", "radius": "1 mm"}, shapes.Disk((0, 0, 0), (1, 0, 0), 1e-3)),
        (
            {"kind": "revolved", "points": [[0, "1 mm"], ["1 mm", "1 mm"], [0, "2 mm"]], "axis": "x"},
            shapes.Revolved([(0, 1e-3), (1e-3, 1e-3), (0, 2e-3)], (1, 0, 0)),
        ),
        (
            {"kind": "level-set", "formula": "x^2 - 1e-6", "lower": -1, "upper": 1, "samples": 9},
            shapes.LevelSet(Formula("x^2 - 1e-6"), (-1, -1, -1), (1, 1, 1), 9),
        ),
        (
            {"kind": "difference", "of": [{"kind": "box", "lower": -1, "upper": 1}, BALL, {**BALL, "moved": [1, 0, 0]}]},
            shapes.Box((-1,) * 3, (1,) * 3) - shapes.Sphere((0, 0, 0), 1e-3) - shapes.Sphere((0, 0, 0), 1e-3).moved((1, 0, 0)),
        ),
        ({"kind": "union", "of": [BALL, BALL]}, shapes.Sphere((0, 0, 0), 1e-3) | shapes.Sphere((0, 0, 0), 1e-3)),
        ({"kind": "intersection", "of": [BALL, BALL]}, shapes.Sphere((0, 0, 0), 1e-3) & shapes.Sphere((0, 0, 0), 1e-3)),
        (
            {**BALL, "turned": {"axis": "y", "angle": "90 deg", "about": [0, 0, 1]}, "moved": ["1 mm", 0, 0]},
            shapes.Sphere((0, 0, 0), 1e-3).turned("y", np.pi / 2, (0, 0, 1)).moved((1e-3, 0, 0)),
        ),
    ],
)  # fmt: skip
def test_tables_mean_the_shapes_of_python_and_come_back_from_toml(table, body):
    described = scene(table)
    assert described.electrodes[0].value.shape == body
    assert Scene.from_dict(described.to_dict()) == described
    assert Scene.from_dict(tomllib.loads(described.to_toml())) == described


def test_files_are_relative_to_the_scene_and_read_when_a_run_is_set_up(tmp_path):
    (tmp_path / "ring.csv").write_text("z, r\n0, 1\n1, 1\n1, 2\n0, 2\n")
    table = """
        [domain]
        lower = -1
        upper = 1
        cells = 16
        [[electrodes]]
        name = "ring"
        voltage = "3 kV"
        shape = { kind = "union", of = [{ kind = "revolved", file = "ring.csv", unit = "mm" }] }
    """
    (tmp_path / "scene.toml").write_text(table)
    described = Scene.from_toml(tmp_path / "scene.toml")
    [electrode], _ = compared_electrodes(described)
    assert electrode.shape == shapes.Revolved([(0, 1e-3), (1e-3, 1e-3), (1e-3, 2e-3), (0, 2e-3)])
    Path(tmp_path / "ring.csv").unlink()
    assert Scene.from_toml(tmp_path / "scene.toml") == described  # outputs are read without the file
    with pytest.raises(InputError, match=r"ring\.csv cannot be read \(No such file or directory\); check the path"):
        compared_electrodes(described)


@pytest.mark.parametrize(
    "shape, sentence",
    [
        (3, r"electrodes\.0\.shape \(3\) is not a valid dictionary"),
        ({"radius": 1}, r'electrodes\.0\.shape has no kind; add kind = "…" to it'),
        ({"kind": "spher"}, r"electrodes\.0\.shape \('spher'\) has an unknown kind; did you mean \"sphere\"\?"),
        ({"kind": "sphere"}, r"electrodes\.0\.shape\.radius is missing; add radius = …"),
        ({"kind": "sphere", "radius": -1}, r"electrodes\.0\.shape\.radius \(-1\) is not greater than 0"),
        ({**BALL, "moved": ["3 s", 0, 0]}, r"electrodes\.0\.shape\.moved\.0 \('3 s'\) has the unit \"s\""),
        ({**BALL, "turned": {"axis": "w", "angle": 1}}, r"shape\.turned\.axis \('w'\) points nowhere; give \"x\""),
        ({"kind": "torus", "radius": 1, "tube": 2}, r"shape is refused: Torus: its tube, 2 m, is not below its radius"),
        ({"kind": "union", "of": []}, r"electrodes\.0\.shape\.of \(\[\]\) is refused"),
        ({"kind": "union", "of": [{"kind": "box", "lower": 0}]}, r"electrodes\.0\.shape\.of\.0\.upper is missing"),
        ({"kind": "revolved"}, r"electrodes\.0\.shape\.points is missing, as is file; give points or file"),
        ({"kind": "revolved", "points": [[0, 1]], "file": "a"}, r"shape\.points is given as well as file"),
        ({"kind": "stl", "file": "a", "unit": "inch"}, r"shape\.unit \('inch'\) is no unit of length"),
        ({"kind": "level-set", "formula": "q", "lower": 0, "upper": 1}, r"shape\.formula \('q'\) holds \"q\""),
        ({"kind": "disk", "radius": 1, "normal": [0, 0, 0]}, r"shape\.normal .* points nowhere"),
    ],
)
def test_mistakes_in_shapes_get_one_sentence_with_their_place(shape, sentence):
    with pytest.raises(SceneError, match=sentence):
        scene(shape)


@pytest.mark.parametrize(
    "drive, sentence",
    [
        ({"voltage": "5 kA"}, r"electrodes\.0\.voltage \('5 kA'\) has the unit \"kA\", which is not a potential"),
        ({"voltage": "cos("}, r"electrodes\.0\.voltage \('cos\('\) is no formula"),
        ({"voltage": "5*x"}, r"electrodes\.0\.voltage \('5\*x'\) holds \"x\""),
        ({"voltage": "1/t"}, r"electrodes\.0\.voltage \('1/t'\) is inf at t = 0 s"),
        ({"voltage": True}, r"electrodes\.0\.voltage \(True\) is not a potential"),
        ({"voltage": 1, "charge": 1}, r"electrodes\.0\.voltage is given as well as charge; keep one of the two"),
        ({"colour": "red"}, r"electrodes\.0\.colour \('red'\) is an unknown key"),
        ({"charge": "3 V"}, r"electrodes\.0\.charge \('3 V'\) has the unit \"V\""),
    ],
)
def test_mistakes_in_what_drives_an_electrode_get_one_sentence(drive, sentence):
    with pytest.raises(SceneError, match=sentence):
        scene(BALL, **drive)


@pytest.mark.parametrize(
    "changes, sentence",
    [
        ({"electrodes": [{"name": "a", "shape": BALL}]}, r"electrodes\.0\.voltage is missing, as is charge"),
        ({"electrodes": [{"shape": BALL, "voltage": 1}]}, r"electrodes\.0\.name is missing"),
        ({"electrodes": [{"name": "a b", "shape": BALL, "voltage": 1}]}, r"electrodes\.0\.name \('a b'\) cannot stand"),
        (
            {"electrodes": [{"name": "x_lower", "shape": BALL, "voltage": 1}]},
            r"the name of a face of the domain already",
        ),
        (
            {"electrodes": [{"name": "a", "shape": BALL, "voltage": 1}] * 2},
            r"electrodes\.1\.name .* one of the electrodes",
        ),
        (
            {"apertures": [{"kind": "round", "name": "a", "radius": 1}]},
            r"electrodes\.0\.name \('a'\) is the name of an aper",
        ),
        ({"solver": {"order": 4}}, r"solver\.order \(4\) does not know electrodes; set it to 2"),
        (
            {"domain": {**DOMAIN, "boundary": "neumann"}, "electrodes": [{"name": "a", "shape": BALL, "charge": 1}]},
            r"electrodes float all between periodic and neumann faces",
        ),
    ],
)
def test_electrodes_that_do_not_fit_the_scene_are_refused(changes, sentence):
    data = {"domain": DOMAIN, "electrodes": [{"name": "a", "shape": BALL, "voltage": 1}], **changes}
    with pytest.raises(SceneError, match=sentence):
        Scene.from_dict(data)


def test_electrodes_that_touch_are_refused_with_the_place():
    two = [{"name": name, "shape": BALL, "voltage": volts} for name, volts in (("a", 1), ("b", 2))]
    with pytest.raises(InputError, match=r"electrodes a and b touch at .* m and have different voltages"):
        compared_electrodes(Scene.from_dict({"domain": DOMAIN, "electrodes": two}))


def test_a_held_electrode_lets_a_net_charge_stand_between_periodic_faces():
    bunch = {"distribution": "sphere", "radius": 1e-3, "charge": 1e-12, "particles": 8}
    data = {"domain": {**DOMAIN, "boundary": "periodic"}, "bunches": [bunch]}
    with pytest.raises(SceneError, match="the net charge is"):
        Scene.from_dict(data)
    Scene.from_dict({**data, "electrodes": [{"name": "a", "shape": BALL, "voltage": 1}]})

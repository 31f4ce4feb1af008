"""Sections [[elements]] of a scene: what they mean, and one sentence for each mistake."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest

from amrpic.errors import SceneError
from amrpic.external import ExternalFields
from amrpic.mesh.window import axes
from amrpic.scene.elements import DipoleElement, MapElement, enge_reach
from amrpic.scene.scene import Scene
from amrpic.scene.units import to_si
from amrpic.units import ELECTRON_MASS, ELEMENTARY_CHARGE, PROTON_MASS, SPEED_OF_LIGHT

QUADRUPOLE = {
    "kind": "quadrupole",
    "centre": [0, 0, "0.35 m"],
    "length": "0.1 m",
    "gradient": "12 T/m",
    "fringe": "hard",
}
BUNCH = {
    "distribution": "gaussian",
    "sigma": "2.5 mm",
    "charge": "10 pC",
    "particles": 10,
    "momentum": [0, 0, "1 MeV/c"],
}


def scene(*elements: dict[str, Any], **changes: Any) -> Scene:
    data: dict[str, Any] = {"domain": {"lower": -0.1, "upper": 0.1, "cells": 32}, "bunches": [BUNCH]}
    return Scene.from_dict({**data, "elements": elements, **changes})


def refusal(element: dict[str, Any], **changes: Any) -> str:
    with pytest.raises(SceneError) as refused:
        scene(element, **changes)
    message = str(refused.value)
    assert "\n" not in message and "; " in message and message.startswith("scene: elements.0")
    return message


def without(element: dict[str, Any], *keys: str, **more: Any) -> dict[str, Any]:
    return {key: value for key, value in element.items() if key not in keys} | more


def test_pole_faces_have_units_and_bounds():
    dipole = {"kind": "dipole", "length": 0.1, "field": 1.0}
    given = scene({**dipole, "entrance_angle": "10 deg", "exit_angle": -0.2}, motion={"kind": "leapfrog", "dt": 1e-12})
    [magnet] = given.elements
    assert isinstance(magnet, DipoleElement)
    assert (magnet.entrance_angle, magnet.exit_angle) == pytest.approx((math.pi / 18, -0.2))
    assert "exit_angle" in refusal({**dipole, "exit_angle": "90 deg"})
    assert "entrance_angle" in refusal({**without(QUADRUPOLE), "entrance_angle": 0.1})


def test_elements_of_a_toml_file(tmp_path):
    file = tmp_path / "line.toml"
    file.write_text(
        '[domain]\nlower = -0.1\nupper = 0.1\ncells = 32\n[[elements]]\nkind = "quadrupole"\n'
        'centre = [0, 0, "0.35 m"]\nlength = "0.1 m"\ngradient = "12 T/m"\nfringe = "hard"\n'
        '[[elements]]\nkind = "map"\nfile = "coil.h5"\nfrequency = "1.3 GHz"\nphase = "90 deg"\n'
    )
    given = Scene.from_toml(file)
    assert Scene.from_dict(given.to_dict()) == given
    quadrupole, coil = given.elements
    assert quadrupole == scene(QUADRUPOLE).elements[0]
    assert isinstance(coil, MapElement) and coil.file == str(tmp_path / "coil.h5")
    B = ExternalFields([quadrupole]).fields([[1e-3, 0, 0.35], [1e-3, 0, 0.41]])[1]
    assert np.allclose(B, np.array([[0, 12e-3, 0], [0, 0, 0]]))


@pytest.mark.parametrize(
    "text, kind, value",
    [
        ("1 T", "magnetic field", 1.0),
        ("3 mT", "magnetic field", 3e-3),
        ("20 G", "magnetic field", 2e-3),
        ("12 T/m", "gradient", 12.0),
        ("1.3 GHz", "frequency", 1.3e9),
        ("50 Hz", "frequency", 50.0),
        ("90 deg", "angle", math.pi / 2),
        ("1 rad", "angle", 1.0),
        ("2 1/m", "wave number", 2.0),
        ("3 MV/m^2", "electric gradient", 3e6),
    ],
)
def test_units(text, kind, value):
    assert to_si(text, kind) == pytest.approx(value, rel=1e-15)


@pytest.mark.parametrize(
    "element, words",
    [
        (QUADRUPOLE | {"length": "-1 cm"}, "length (-0.01) is not greater than 0"),
        (QUADRUPOLE | {"length": 0}, "length"),
        (without(QUADRUPOLE, "gradient"), "gradient is missing"),
        (QUADRUPOLE | {"gradient": "12 T"}, 'has the unit "T", which is not a gradient; use one of T/m, mT/m, G/cm'),
        (QUADRUPOLE | {"fringe": "enge"}, "gap ('nothing') is missing"),
        (QUADRUPOLE | {"fringe": "sheet"}, "fringe ('sheet') is not one of the choices"),
        (QUADRUPOLE | {"gap": 0.1}, 'gap (0.1) means nothing to hard edges; set fringe = "enge"'),
        (
            QUADRUPOLE | {"fringe": "enge", "gap": 0.1, "enge": [0, -3]},
            "enge ([0.0, -3.0]) does not let the field fall",
        ),
        (QUADRUPOLE | {"fringe": "enge", "gap": 0.1, "enge": [0, 0, 3]}, "does not let the field fall"),
        (QUADRUPOLE | {"direction": [0, 0, 0]}, "direction ([0.0, 0.0, 0.0]) points nowhere"),
        (QUADRUPOLE | {"kind": "sextupole"}, "unknown kind"),
        (without(QUADRUPOLE, "kind"), "has no kind"),
        (QUADRUPOLE | {"strength": 2}, "strength (2) is an unknown key"),
        ({"kind": "solenoid", "length": 1, "field": 1, "fringe": "sheet"}, "radius ('nothing') is missing"),
        ({"kind": "solenoid", "length": 1, "field": 1, "radius": 1}, "radius (1.0) means nothing to hard edges"),
        ({"kind": "solenoid", "length": 1, "field": 1, "fringe": "enge"}, "fringe ('enge') is not one of the choices"),
        ({"kind": "cavity", "length": 1, "field": 1e6}, "frequency ('nothing') is missing"),
        ({"kind": "cavity", "length": 1, "field": 1e6, "frequency": -1}, "frequency (-1.0) is not greater"),
        ({"kind": "rf-gap", "length": 1, "voltage": 1e6, "phase": 1}, "phase (1.0) means nothing without a frequency"),
        ({"kind": "map"}, "file is missing"),
        ({"kind": "constant-focusing"}, "gradient is missing, as is wavenumber; give gradient or wavenumber"),
        ({"kind": "constant-focusing", "gradient": 1, "wavenumber": 1}, "is given as well as wavenumber"),
    ],
)
def test_mistakes_get_a_sentence(element, words):
    assert words in refusal(element)


@pytest.mark.parametrize(
    "bunches",
    [[], [{"distribution": "openpmd", "file": "x.h5"}], [without(BUNCH, "momentum")]],
    ids=["none", "in a file", "at rest"],
)
def test_wave_number_needs_a_bunch_that_moves(bunches):
    message = refusal({"kind": "constant-focusing", "wavenumber": [1, 2, 0]}, bunches=bunches)
    assert "wavenumber ([1.0, 2.0, 0.0]) needs a first bunch" in message


@pytest.mark.parametrize("species, mass, sign", [("proton", PROTON_MASS, 1), ("electron", ELECTRON_MASS, -1)])
def test_wave_number_is_that_of_the_oscillation(species, mass, sign):
    momentum = 3 * mass * SPEED_OF_LIGHT
    bunch = BUNCH | {"species": species, "charge": sign * 1e-12, "momentum": [0, 0, momentum]}
    fields = ExternalFields.of_scene(scene({"kind": "constant-focusing", "wavenumber": [2, 3, 0]}, bunches=[bunch]))
    E = fields.fields([[1e-3, 1e-3, 1.0]])[0][0]
    gamma, speed = math.sqrt(10), 3 * SPEED_OF_LIGHT / math.sqrt(10)
    expected = -gamma * mass * speed**2 * np.array([4, 9, 0]) * 1e-3 / (sign * ELEMENTARY_CHARGE)
    assert np.allclose(E, expected, rtol=1e-12)


def test_axes_are_right_handed_and_orthogonal():
    rng = np.random.default_rng(1)
    directions = [*rng.normal(0, 1, (20, 3)), (0, 0, 1), (0, 0, -2), (1e-9, 0, -1), (0, 1e-12, 1), (1, 0, 0)]
    for direction in directions:
        turned = np.array(axes(tuple(direction), rng.uniform(-4, 4)))
        assert np.allclose(turned @ turned.T, np.eye(3), atol=1e-14)
        assert np.linalg.det(turned) == pytest.approx(1)
        assert np.allclose(turned[2], direction / np.linalg.norm(direction), atol=1e-15)
    assert axes((0, 0, 1), 0.0) == np.eye(3).tolist()


def test_fringes_end_where_nothing_is_left():
    assert enge_reach((0.0, 4.0)) == pytest.approx(15.0)
    assert math.isinf(enge_reach((0.0, 0.1)))

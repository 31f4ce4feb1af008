"""Potentials and slopes given on the faces of a scene's domain, and formulas in it."""

from __future__ import annotations

import re

import numpy as np
import pytest

from amrpic.errors import InputError, SceneError
from amrpic.pic.simulation import Simulation
from amrpic.scene.expression import formula
from amrpic.scene.scene import Scene

QUADRUPOLE = "1e3*(x^2 - y^2)"


def scene(folder=None, **domain) -> Scene:
    return Scene.from_dict(
        {
            "domain": {"lower": -1, "upper": 1, "cells": 16, **domain},
            "refinement": {
                "levels": 1,
                "rule": {"kind": "static", "boxes": [{"level": 1, "lower": -0.5, "upper": 0.5}]},
            },
            "output": {"directory": str(folder), "write": ["checkpoint"]},
        }
    )


@pytest.mark.mpi(ranks=(1, 2))
def test_walls_of_a_quadrupole_make_its_field_without_charge(comm, tmp_path):
    """x² − y² is met exactly by second-order stencils, z + 2 by the constant faces and the slope."""
    values = dict.fromkeys("xy", f"{QUADRUPOLE} + 50*z") | {"z": [f"{QUADRUPOLE} - 50", 0]}
    boundary = {"x": "dirichlet", "y": "dirichlet", "z": ["dirichlet", "neumann"]}
    run = Simulation(comm, scene(tmp_path, boundary=boundary, potential=values, slope={"z": [0, "0.05 kV/m"]}))
    for component, exact in zip(run.efield.components, ((-2e3, 0), (2e3, 1), (-50, None)), strict=True):
        for patch in component.patches:
            factor, axis = exact
            expected = factor * (patch.centres()[axis] if axis is not None else 1) * np.ones(patch.data.shape)
            assert np.allclose(patch.data, expected, atol=1e-5)
    again = Scene.from_dict(run.scene.to_dict())
    assert again == run.scene
    run.run()
    assert np.array_equal(Simulation.restart(comm, tmp_path / "checkpoint_00000000").phi.array(1), run.phi.array(1))


@pytest.mark.mpi(ranks=(1, 2))
@pytest.mark.parametrize("formula", ["1/(y - y)", "sqrt(x - 5)", "9^9^9^9^9"])
def test_a_formula_without_a_value_is_reported_with_its_key(comm, tmp_path, formula):
    with pytest.raises(InputError, match=r"^domain.potential.z: its formula .*; correct it$"):
        Simulation(comm, scene(tmp_path, boundary={"z": "dirichlet"}, potential={"z": [0, formula]}))


@pytest.mark.parametrize(
    ("potential", "boundary", "rim"),
    [
        ({"z": [5, 0]}, {"z": ["dirichlet", "open"]}, None),
        ({"z": [5, -5]}, {"z": "dirichlet"}, None),
        ({"z": ["exp(-20*(x^2 + y^2))", 0]}, {"z": ["dirichlet", "open"]}, None),
        ({"z": ["exp(-2*(x^2 + y^2))", 0]}, {"z": ["dirichlet", "open"]}, "z_lower: .* at 0.103 V.* by up to 8%"),
        ({"z": [0, "1 + x"]}, {"z": ["open", "dirichlet"]}, "z_upper: .* at 1 V.* by up to 100%"),
        ({"z": ["y", 0]}, {"x": "periodic", "y": "dirichlet", "z": ["dirichlet", "open"]}, None),  # meets no open face
        ({"z": ["x", 0]}, {"x": "dirichlet", "y": "neumann", "z": "dirichlet"}, None),
    ],
)
def test_potentials_that_jump_where_walls_go_on_beyond_open_faces_are_remarked(potential, boundary, rim):
    remarks = [
        remark for remark in scene(boundary=boundary, potential=potential).remarks() if "domain.potential" in remark
    ]
    assert len(remarks) == (rim is not None)
    if rim is not None:
        assert re.match(f"domain.potential.z jumps at the rim of {rim}", remarks[0])


def test_a_formula_is_what_numpy_says():
    x, y, z = np.random.default_rng(1).random((3, 50))
    text = "-min(x, y)^2/(1 + z) + sin(pi*x)*exp(-y) + hypot(x, z) - 3"
    expected = -(np.minimum(x, y) ** 2) / (1 + z) + np.sin(np.pi * x) * np.exp(-y) + np.hypot(x, z) - 3
    assert np.array_equal(formula(text)(x, y, z), expected)


@pytest.mark.parametrize(
    ("domain", "words"),
    [
        ({"potential": {"x": 3}}, "is given on a face that is open, not dirichlet"),
        ({"boundary": {"x": ["neumann", "dirichlet"]}, "slope": {"x": [0, 3]}}, "is dirichlet, not neumann"),
        ({"potential": {"w": 3}}, "is not an axis"),
        ({"potential": 3}, "names no axis"),
        ({"potential": {"x": [1, 2, 3]}}, "two faces"),
        ({"potential": {"x": "3 mm"}}, "is no formula"),
        ({"potential": {"x": "__import__('os')"}}, "which no formula knows"),
        ({"potential": {"x": "sin(x, y)"}}, "gives sin 2 values"),
        ({"potential": {"x": "x if y else z"}}, "which no formula knows"),
    ],
)
def test_mistakes_are_reported_in_one_sentence(domain, words):
    with pytest.raises(SceneError, match=r"domain.*;") as refused:
        scene(**domain)
    assert words in str(refused.value)

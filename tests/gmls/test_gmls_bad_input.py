"""Each bad input gets one sentence with what, where, the value found and what to do."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from amrpic import gmls
from amrpic.errors import InputError, SolverError

X = np.random.default_rng(0).uniform(size=(200, 3))
T = X[:4]
NEAR = gmls.nearby(X, T, order=2)


def broken(values: np.ndarray, value: float) -> np.ndarray:
    out = values.copy()
    out[2, 1] = value
    return out


def stencils(**changed):
    arguments: dict[str, Any] = dict(space=gmls.Scalar(2), samples=gmls.Points(X), wanted=[gmls.VALUE])
    targets, near = changed.pop("targets", T), changed.pop("near", NEAR)
    return gmls.stencils(targets, near, **{**arguments, **changed})


def near_with(**changed):
    fields: dict[str, Any] = dict(start=NEAR.start, index=NEAR.index, reach=NEAR.reach)
    return gmls.Neighbours(**{**fields, **changed})


CASES = {
    "the sites hold nan at [2, 1]": lambda: gmls.Points(broken(X, np.nan)),
    "the sites hold inf at [2, 1]": lambda: gmls.nearby(broken(X, np.inf), T, order=2),
    "the targets hold nan at [2, 1]": lambda: stencils(targets=broken(T, np.nan)),
    "the order of a space is 5": lambda: gmls.Scalar(5),
    "the order of a space is 0": lambda: gmls.nearby(X, T, order=0),
    "sites have 3 coordinates and targets 2": lambda: gmls.nearby(X, T[:, :2], order=2),
    "the samples have 2 coordinates and the targets 3": lambda: stencils(samples=gmls.Points(X[:, :2])),
    "neighbours are given for 4 of 3 targets": lambda: stencils(targets=T[:3]),
    "neighbour 1 is sample 200, but there are 200": lambda: stencils(
        near=near_with(index=np.where(np.arange(len(NEAR.index)) == 1, 200, NEAR.index).astype(np.int32))
    ),
    "target 1 has reach 0.0": lambda: stencils(near=near_with(reach=NEAR.reach * [1, 0, 1, 1])),
    "target 0 has reach 0.0": lambda: gmls.nearby(X, T, radius=0.0),
    "either an order or a radius": lambda: gmls.nearby(X, T, order=2, radius=0.1),
    "reach is -1": lambda: gmls.nearby(X, T, order=2, reach=-1),
    "normal 2 is zero": lambda: gmls.Neumann([[1, 0, 0], [0, 1, 0], [0, 0, 0], [1, 0, 0]]),
    "direction 2 is zero": lambda: gmls.Components(X[:3], [[1, 0, 0], [0, 1, 0], [0, 0, 0]]),
    "curl of a scalar was asked for": lambda: stencils(wanted=[gmls.CURL]),
    "gradient of a vector was asked for": lambda: stencils(
        space=gmls.Vector(2), samples=gmls.Vectors(X), wanted=[gmls.GRADIENT]
    ),
    "the samples are of a scalar, but Vector(order=2)": lambda: stencils(space=gmls.Vector(2)),
    "the samples are of a vector, but Scalar(order=2)": lambda: stencils(samples=gmls.Vectors(X)),
    "derivative_11 was asked for in 3 dimensions": lambda: stencils(wanted=[gmls.Derivative(1, 1)]),
    'two quantities are called "value"': lambda: stencils(wanted=[gmls.VALUE, gmls.VALUE]),
    "nothing is wanted": lambda: stencils(wanted=[]),
    "value is wanted at places of shape (3, 1, 3)": lambda: stencils(wanted=[gmls.VALUE.at(T[:3, None])]),
    "there are 3 shapes for 4 targets": lambda: stencils(wanted=[gmls.Mean(gmls.boxes(T[:3], 0.1))]),
    "box 0 has widths [ 0.1 -0.1  0.1]": lambda: gmls.boxes(T, [0.1, -0.1, 0.1]),
    "these shapes have neither normals nor tangents": lambda: gmls.Along(gmls.boxes(T, 0.1)),
    "edge 0 has length or area zero": lambda: gmls.edges(T, T),
    "polygon 0 has no area": lambda: gmls.polygons(np.zeros((1, 4, 2))),
    "vertices have shape (4, 3, 2)": lambda: gmls.tetrahedra(np.zeros((4, 3, 2))),
    "the aspect is [1. 1.]": lambda: stencils(aspect=[1, 1]),
    "no meaning in coordinates of different scales": lambda: stencils(space=gmls.Harmonic(2), aspect=[1, 1, 2]),
    "no meaning in one dimension": lambda: gmls.stencils(
        T[:, :1],
        gmls.nearby(X[:, :1], T[:, :1], order=1),
        space=gmls.CurlFree(1),
        samples=gmls.Vectors(X[:, :1]),
        wanted=[gmls.VALUE],
    ),
    "they exist for scalar spaces alone": lambda: stencils(
        space=gmls.Vector(2), samples=gmls.Vectors(X), exact=[gmls.Dirichlet(T)]
    ),
    'the exact row "dirichlet" is given for 3 of 4 targets': lambda: stencils(exact=[gmls.Dirichlet(T[:3])]),
    "values have shape (7,) for 200 samples": lambda: stencils().apply(np.ones(7)),
    'these stencils have no "curl"; they have value': lambda: stencils().matrix("curl"),
    "exact data are given for []; these stencils need ['dirichlet']": lambda: stencils(exact=[gmls.Dirichlet(T)]).apply(
        np.ones(200)
    ),
    "component 3 does not exist": lambda: gmls.Basis(3, 3)(T, component=3),
    "Power(exponent=0, inner=1) has exponents": lambda: gmls.Power(0),
    "Gaussian weight has width -1": lambda: gmls.Gaussian(-1),
    "of one sign are wanted of 4 numbers": lambda: stencils(wanted=[gmls.VALUE, gmls.GRADIENT], one_sign=True),
}


@pytest.mark.parametrize("sentence", list(CASES))
def test_bad_input_gets_one_sentence(sentence):
    with pytest.raises(InputError) as caught:
        CASES[sentence]()
    text = str(caught.value)
    assert sentence in text
    assert ";" in text and "\n" not in text and not text.endswith(".")


def test_exact_rows_that_depend_on_each_other_are_refused():
    with pytest.raises(SolverError, match=r"target 0 .* its exact rows depend on each other"):
        stencils(exact=[gmls.Dirichlet(T), gmls.Dirichlet(T + 0.0)])


def test_weights_of_one_sign_reproduce_or_are_reported():
    rng = np.random.default_rng(3)
    lattice = np.stack(np.meshgrid(*[np.arange(9) + 0.5] * 2, indexing="ij"), -1).reshape(-1, 2) / 9
    x = lattice + rng.uniform(-0.2, 0.2, lattice.shape) / 9
    t = x[(np.abs(x - 0.5) < 0.25).all(axis=1)]
    near = gmls.nearby(x, t, order=2, reach=2.0)
    arguments: dict[str, Any] = dict(space=gmls.Scalar(2), samples=gmls.Points(x), wanted=[gmls.LAPLACIAN])
    plain = gmls.stencils(t, near, **arguments)
    found = gmls.stencils(t, near, one_sign=True, failed="mark", **arguments)

    def wrong(s: gmls.Stencils, i: int) -> bool:
        entries = slice(s.start[i], s.start[i + 1])
        off = (x[s.index[entries]] != t[i]).any(axis=1)
        return bool((s.weights[entries, 0][off] < 0).any())

    good = np.setdiff1d(np.arange(len(t)), found.quality.failed)
    assert any(wrong(plain, i) for i in range(len(t)))
    assert len(good) > 0.8 * len(t)
    assert not any(wrong(found, i) for i in good)
    quadratic = found.apply((x**2) @ [1.0, 2.0] + x @ [3.0, 1.0])["laplacian"]
    assert np.abs(quadratic[good] - 6).max() < 1e-8
    corner = np.array([[0.0, 0.0]])
    with pytest.raises(SolverError, match="no weights of one sign"):
        gmls.stencils(corner, gmls.nearby(x, corner, order=2, reach=2.0), one_sign=True, **arguments)

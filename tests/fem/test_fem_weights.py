"""Weights that integrate products of powers, against SciPy's optimisers."""

from __future__ import annotations

import numpy as np
import pytest
from mpi4py import MPI
from numpy.polynomial import legendre
from scipy.optimize import linprog, nnls

from amrpic import fem

LEAST = 0.01  # weight over volume


def moments(reference, degree):
    """Products of Legendre's polynomials at points, (products, n); and their integrals over [-1, 1]^3 over 8."""
    rows = [legendre.legvander(x, degree) * np.sqrt(2 * np.arange(degree + 1) + 1) for x in reference.T]
    products = np.einsum("pi,pj,pk->ijkp", *rows).reshape(-1, len(reference))
    exact = np.zeros(len(products))
    exact[0] = 1
    return products, exact


def of_elements(points):
    """For each element with points: number, places, volumes and weights in parts of its volume."""
    for element in np.unique(points.element):
        own = points.element == element
        volume = points.mesh.element_volume
        yield element, points.reference[own], points.volume[own] / volume, points.weight[own] / volume


def mesh_of(degree, cells=2):
    return fem.Mesh(MPI.COMM_SELF, 0, (1, 1.5, 0.7), cells, degree=degree)


CASES = {
    "jittered, p = 1, 3³": (1, lambda mesh: fem.jittered(mesh, 3), {1}),
    "random, p = 1, 4³": (1, lambda mesh: fem.random(mesh, 4), {1}),
    "uniform, p = 2, 4³": (2, lambda mesh: fem.uniform(mesh, 4), {3}),
    "jittered, p = 2, 4³": (2, lambda mesh: fem.jittered(mesh, 4, seed=2), {2}),
    "jittered, p = 2, 3³": (2, lambda mesh: fem.jittered(mesh, 3, seed=2), {1, 2}),
    "random, p = 2, 4³": (2, lambda mesh: fem.random(mesh, 4, seed=3), {1, 2}),
    "random, p = 2, 2³": (2, lambda mesh: fem.random(mesh, 2, seed=3), {0, 1}),
    "jittered, p = 2, 6³": (2, lambda mesh: fem.jittered(mesh, 6), {2, 3}),
    "uniform, p = 3, 6³": (3, lambda mesh: fem.uniform(mesh, 6), {5}),
}  # fmt: skip


@pytest.mark.parametrize("name", CASES)
def test_weights_are_exact_to_the_highest_degree_that_there_is_and_nearest_to_volumes(name):
    degree, make, expected = CASES[name]
    points = make(mesh_of(degree))
    assert set(points.exact_to) <= expected, points.exactness()
    assert sum(points.exactness().values()) == 8
    for element, reference, volume, weight in list(of_elements(points))[:4]:
        reached = points.exact_to[element]
        products, exact = moments(reference, reached)
        assert np.abs(products @ weight - exact).max() < 1e-12
        assert (weight >= LEAST * volume * (1 - 1e-9)).all()
        # The nearest of such weights: the excess over the least ones by non-negative least squares, moments all but exactly.
        stiff, root = 1e5, np.sqrt(volume)
        rows = np.concatenate([stiff * products, np.diag(1 / root)])
        right = np.concatenate([stiff * (exact - products @ (LEAST * volume)), (1 - LEAST) * root])
        nearest, _ = nnls(rows, right, maxiter=100 * len(volume))
        assert np.abs(nearest + LEAST * volume - weight).max() < 1e-6 * volume.max()
        if reached < 2 * degree - 1:  # linear programming finds none that are exact to the next degree
            products, exact = moments(reference, reached + 1)
            bounds = [(LEAST * v, None) for v in volume]
            more = linprog(np.zeros(len(volume)), A_eq=products, b_eq=exact, bounds=bounds, method="highs")
            assert more.status == 2, more.message


def test_most_points_reach_the_highest_degree():
    """512 points in place on a lattice reach Q7, 512 of degree 3 in disorder Q3 or more."""
    points = fem.uniform(mesh_of(4), 8)
    assert points.exactness() == {7: 8}
    assert min(fem.jittered(mesh_of(3), 8).exactness()) >= 3


def test_places_that_repeat_share_their_weights():
    mesh = mesh_of(2)
    one = fem.uniform(mesh, 4)
    twice = fem.given(
        mesh, np.repeat(one.position, 2, axis=0), volume=np.repeat(one.volume, 2) * np.tile([0.3, 0.7], len(one))
    )
    assert set(twice.exact_to) == {3}
    pairs = twice.weight.reshape(-1, 2)
    assert np.abs(pairs.sum(axis=1) - one.weight[twice.number[::2] // 2]).max() < 1e-10 * one.volume[0]
    assert np.abs(pairs[:, 0] / 0.3 - pairs[:, 1] / 0.7).max() < 1e-10 * one.volume[0]


def test_elements_that_are_not_full_keep_volumes():
    mesh = mesh_of(2)
    whole = fem.jittered(mesh, 4)
    kept = (whole.position[:, 0] > 0.25) | (whole.element % 2 == 1)
    points = fem.given(mesh, whole.position[kept], volume=whole.volume[kept])
    partly = np.bincount(points.element, minlength=8) < 64
    assert 0 < partly.sum() < 8
    assert (points.exact_to[partly] == -1).all() and (points.exact_to[~partly] >= 2).all()
    of_partly = partly[points.element]
    assert (points.weight[of_partly] == points.volume[of_partly]).all()
    assert (points.weight[~of_partly] != points.volume[~of_partly]).any()


def test_volume_weights_are_volumes():
    points = fem.jittered(mesh_of(2), 4, weights="volume")
    assert points.exactness() == {-1: 8}
    assert (points.weight == points.volume).all()


@pytest.mark.parametrize("degree", [1, 2, 3, 4])
def test_gauss_rules_are_exact(degree):
    points = fem.gauss(mesh_of(degree))
    for element, reference, _, weight in of_elements(points):
        products, exact = moments(reference, points.exact_to[element])
        assert points.exact_to[element] == 2 * degree + 1
        assert np.abs(products @ weight - exact).max() < 1e-13


@pytest.mark.parametrize("degree", [1, 2, 3])
def test_polynomials_that_weights_are_exact_for_are_solutions_of_poisson(degree):
    """The patch test: weights exact to the degree of the elements leave linear solutions linear."""
    mesh = fem.Mesh(MPI.COMM_SELF, 0, 1, 3, degree=degree)
    points = fem.jittered(mesh, {1: 3, 2: 5, 3: 8}[degree], seed=4)
    assert min(points.exact_to) >= degree
    linear = 1 + mesh.nodes @ [1.0, -2.0, 0.5]
    u, report = fem.solve(
        fem.Poisson(points), np.zeros(len(linear)), fixed=mesh.boundary, values=linear, tolerance=1e-13
    )
    assert report.converged
    assert np.abs(u - linear).max() < 1e-11

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


def holds_and_fills(cells, place, volume, free):
    """By numpy on all points: whether elements and their neighbours hold points, and volumes in and about them, over space.

    `place` (n, 3) in element widths, `volume` in elements. About an element a point counts by the mean of what two corners
    along each axis have of it, over the element's width or, at an end, half of it.
    """
    inside = np.minimum(place.astype(int), np.array(cells) - 1)
    own = np.zeros(cells)
    np.add.at(own, tuple(inside.T), volume)
    padded = np.pad(own > 0, 1, constant_values=True)
    for axis, pair in enumerate(free):
        for end, is_free in zip((0, -1), pair, strict=True):
            if is_free:
                np.moveaxis(padded, axis, 0)[end] = False
    holds = np.ones(cells, dtype=bool)
    for shift in np.ndindex(3, 3, 3):
        holds &= padded[tuple(slice(s, s + n) for s, n in zip(shift, cells, strict=True))]
    about = []
    for axis, n in enumerate(cells):
        corner = np.arange(n + 1)
        hats = np.maximum(0, 1 - np.abs(place[:, axis, None] - corner)) / np.where(
            (corner == 0) | (corner == n), 0.5, 1
        )
        about.append((hats[:, :-1] + hats[:, 1:]) / 2)
    return holds, own, np.einsum("p,pi,pj,pk->ijk", volume, *about)


@pytest.mark.mpi(ranks=(1, 2, 3), more=(4,))
@pytest.mark.parametrize("degree", [1, 2])
@pytest.mark.parametrize("size", [2, 8])
def test_elements_are_full_whose_surroundings_points_fill_on_any_ranks_and_boxes(comm, degree, size):
    """A block with a free top, whose rows are pressed together, with a slit, a corner that is gone, and pores in one half."""
    cells, free = (7, 5, 8), ((False, False), (False, True), (False, False))
    axes = [(np.arange(3 * n) + 0.5) / 3 for n in cells]
    place = np.stack(np.meshgrid(*axes, indexing="ij"), -1).reshape(-1, 3)
    rng = np.random.default_rng(1)
    slit = (np.abs(place[:, 0] - 3.5) < 0.2) & (place[:, 1] > 3)
    gone = (place > np.array(cells) - 2.5).all(axis=1)
    pores = (place[:, 2] > 4) & (rng.uniform(size=len(place)) < 0.15)
    kept = place[~(slit | gone | pores)]
    kept[:, 2] *= 0.9
    volume = np.full(len(kept), 0.9 / 27)
    mesh = fem.Mesh(comm, 0, cells, cells, degree=degree, max_grid_size=size)
    element, reference = mesh.native.locate(kept)
    own = np.flatnonzero(element >= 0)
    own = own[np.argsort(element[own], kind="stable")]
    points = fem.Points(mesh, element[own], reference[own], volume[own], own, free=free)
    holds, within, around = holds_and_fills(cells, kept, volume, free)
    assert min(np.abs(np.abs(within - 1) - 0.05).min(), np.abs(np.abs(around - 1) - 0.1).min()) > 1e-6
    full = holds & ((np.abs(within - 1) < 0.05) | (np.abs(around - 1) < 0.1))
    assert (holds & (np.abs(within - 1) < 0.05)).sum() < full.sum() < holds.sum()
    np.testing.assert_array_equal(points.exact_to >= 0, full[tuple(mesh.elements.T)])


def test_rows_that_cross_faces_leave_weights_exact():
    """Rows of two, pressed to 0.85: volumes of elements are off by up to a half, weights are exact to degree 1 in all."""
    mesh = fem.Mesh(MPI.COMM_SELF, 0, (1, 1, 5), (2, 2, 10))
    rows = fem.uniform(mesh, 2)
    place = rows.position * [1, 1, 0.85]
    kept = fem.given(mesh, place, volume=rows.volume * 0.85)
    volume = np.bincount(kept.element, kept.volume, len(mesh.elements)) / mesh.element_volume
    filled = mesh.elements[:, 2] < 7  # the rest ends in the ninth layer, or is empty
    assert np.abs(volume[filled] - 1).max() > 0.2
    assert (kept.exact_to[filled] == 1).all()
    for element, reference, _, weight in of_elements(kept):
        if filled[element]:
            products, exact = moments(reference, 1)
            assert np.abs(products @ weight - exact).max() < 1e-12


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

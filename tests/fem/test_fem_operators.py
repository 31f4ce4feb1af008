"""Operators at points against dense matrices of NumPy and of scikit-fem, on 1 to 4 ranks and for any boxes."""

from __future__ import annotations

import numpy as np
import pytest
from mpi4py import MPI

from amrpic import fem
from exact.dense_elements import matrix, of_one_dimension, on_all_nodes, rows_at, smooth_vector
from verify.operators import ragged

KINDS = [fem.Mass, fem.Poisson]
DEGREES = (1, 2, 3, 4)
DOMAIN = dict(lower=(0.1, -1, 2), upper=(1.3, 0.2, 2.9), cells=(3, 2, 4))


def mesh_of(comm, degree, boxes=8, **changed):
    return fem.Mesh(comm, **{**DOMAIN, **changed}, degree=degree, max_grid_size=boxes)


LAYOUTS = {
    "gauss": fem.gauss,
    "uniform": lambda mesh: fem.uniform(mesh, 3, weights="volume"),
    "jittered": lambda mesh: fem.jittered(mesh, 2, seed=3, weights="volume"),
    "random": lambda mesh: fem.random(mesh, 3, seed=4, weights="volume"),
    "ragged": ragged,
}


def equal(found, expected, tolerance=1e-12):
    assert np.abs(found - expected).max() <= tolerance * np.abs(expected).max()


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("degree", DEGREES)
@pytest.mark.parametrize("layout", LAYOUTS)
def test_operators_are_those_of_dense_matrices(layout, degree, kind):
    mesh = mesh_of(MPI.COMM_SELF, degree, boxes=2)
    points = LAYOUTS[layout](mesh)
    dense = matrix(points, kind)
    for components in (1, 3):
        operator, u = kind(points, components=components), smooth_vector(mesh, components)
        equal(on_all_nodes(mesh, operator @ u), dense @ on_all_nodes(mesh, u))
        on_diagonal = np.diag(dense)
        expected = on_diagonal if components == 1 else np.stack([on_diagonal] * 3, axis=1)
        equal(on_all_nodes(mesh, operator.diagonal()), expected)


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("layout", LAYOUTS)
def test_matrices_have_the_rows_of_vectors(layout, kind):
    mesh = mesh_of(MPI.COMM_SELF, 2, boxes=2)
    points = LAYOUTS[layout](mesh)
    dense = matrix(points, kind)[np.ix_(mesh.numbers, mesh.numbers)]
    for components in (1, 3):
        operator, u = kind(points, components=components), smooth_vector(mesh, components)
        matrix_of = operator.to_scipy()
        assert matrix_of is not None
        found = matrix_of.toarray()
        equal(found, np.kron(dense, np.eye(components)))
        equal(found @ u.reshape(-1), (operator @ u).reshape(-1))


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("degree", DEGREES)
def test_gauss_points_give_products_of_one_dimensional_matrices(degree, kind):
    mesh = mesh_of(MPI.COMM_SELF, degree, boxes=2)
    u = smooth_vector(mesh, 3)
    operator = kind(fem.gauss(mesh), components=3)
    equal(on_all_nodes(mesh, operator @ u), of_one_dimension(mesh, kind) @ on_all_nodes(mesh, u))
    plain = kind(
        fem.given(mesh, fem.gauss(mesh).position, volume=fem.gauss(mesh).volume, weights="volume"), components=3
    )
    equal(plain @ u, operator @ u)


@pytest.mark.parametrize("degree", [1, 2])
def test_gauss_points_give_the_matrices_of_scikit_fem(degree):
    skfem = pytest.importorskip("skfem")
    from skfem.models.poisson import laplace, mass

    domain = mesh_of(MPI.COMM_SELF, degree).domain
    lines = [
        np.linspace(low, high, n + 1) for low, high, n in zip(domain.lower, domain.upper, domain.cells, strict=True)
    ]
    element = {1: skfem.ElementHex1, 2: skfem.ElementHex2}[degree]()
    basis = skfem.Basis(skfem.MeshHex.init_tensor(*lines), element, intorder=2 * degree + 1)
    mesh = mesh_of(MPI.COMM_SELF, degree, boxes=2)
    theirs = np.lexsort(np.round(basis.doflocs, 9))  # z, then y, then x
    ours = np.argsort(mesh.numbers)
    assert np.abs(basis.doflocs[:, theirs].T - mesh.nodes[ours]).max() < 1e-12
    for kind, form in ((fem.Mass, mass), (fem.Poisson, laplace)):
        expected = form.assemble(basis).toarray()[np.ix_(theirs, theirs)]
        found = kind(fem.gauss(mesh)).to_scipy()
        assert found is not None
        equal(found.toarray()[np.ix_(ours, ours)], expected)


@pytest.mark.parametrize("layout", LAYOUTS)
@pytest.mark.parametrize("degree", DEGREES)
def test_values_slopes_and_integrals_are_those_of_dense_matrices(layout, degree):
    mesh = mesh_of(MPI.COMM_SELF, degree, boxes=2)
    points = LAYOUTS[layout](mesh)
    value, slope = rows_at(points)
    for components in (1, 3):
        u = smooth_vector(mesh, components)
        whole = on_all_nodes(mesh, u)
        equal(points.values(u), value @ whole)
        equal(points.slopes(u), np.moveaxis(slope @ whole, 0, -1))
        f = np.cos(np.arange(len(points) * components)).reshape(points.values(u).shape)
        weighed = f * (points.weight if components == 1 else points.weight[:, None])
        equal(on_all_nodes(mesh, points.integrate(f)), value.T @ weighed)


@pytest.mark.parametrize("layout", LAYOUTS)
@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("degree", DEGREES)
def test_operators_are_symmetric(degree, kind, layout):
    mesh = mesh_of(MPI.COMM_SELF, degree)
    operator, rng = kind(LAYOUTS[layout](mesh), components=3), np.random.default_rng(1)
    u, v = rng.standard_normal((2, *smooth_vector(mesh, 3).shape))
    size = np.linalg.norm(operator @ u) * np.linalg.norm(v)
    assert abs((u * (operator @ v)).sum() - (v * (operator @ u)).sum()) <= 1e-13 * size


def test_mass_of_one_is_the_volume_and_poisson_of_one_is_nothing():
    for degree in DEGREES:
        mesh = mesh_of(MPI.COMM_SELF, degree)
        for layout in ("gauss", "uniform", "random"):
            points = LAYOUTS[layout](mesh)
            one = np.ones(len(mesh.nodes))
            assert (fem.Mass(points) @ one).sum() == pytest.approx(1.2 * 1.2 * 0.9, rel=1e-13)
            stiffness = fem.Poisson(points)
            assert np.abs(stiffness @ one).max() < 1e-12 * stiffness.diagonal().max()


def everything(comm, degree, boxes, layout):
    """What a mesh gives, by numbers of nodes and of points."""
    mesh = fem.Mesh(comm, 0, (1, 2, 1), (6, 5, 8), degree=degree, max_grid_size=boxes)
    points = layout(mesh)
    found = []
    for kind in KINDS:
        operator = kind(points, components=3)
        found += [operator @ smooth_vector(mesh, 3), operator.diagonal(), kind(points) @ smooth_vector(mesh, 1)]
    found.append(points.integrate(points.position))
    by_node = [on_all_nodes(mesh, v) for v in found]
    parts = mesh.comm.allgather((points.number, points.position, points.weight, points.slopes(smooth_vector(mesh, 3))))
    number = np.concatenate([part[0] for part in parts])
    order = np.argsort(number)
    assert len(np.unique(number)) == len(number)
    return by_node + [np.concatenate([part[n] for part in parts])[order] for n in (1, 2, 3)]


@pytest.mark.mpi(ranks=(1, 2, 3), more=(4,))
@pytest.mark.parametrize("degree", [1, 2, 3])
@pytest.mark.parametrize("boxes", [2, 3, 4, 8])
@pytest.mark.parametrize("layout", ["gauss", "jittered", "ragged"])
def test_ranks_and_boxes_change_nothing(comm, degree, boxes, layout):
    make = {"gauss": fem.gauss, "jittered": lambda mesh: fem.jittered(mesh, 2, seed=9), "ragged": ragged}[layout]
    alone = everything(MPI.COMM_SELF, degree, 8, make)
    for one, other in zip(everything(comm, degree, boxes, make), alone, strict=True):
        equal(one, other, 1e-13)


@pytest.mark.mpi(ranks=(2, 3))
def test_matrices_are_gathered_on_rank_0(comm):
    mesh = mesh_of(comm, 2, boxes=2)
    operator = fem.Poisson(ragged(mesh), components=3)
    found = operator.to_scipy()
    numbers = np.concatenate(mesh.comm.allgather(mesh.numbers))
    assert (found is not None) == (mesh.comm.rank == 0)
    if found is not None:
        dense = matrix(ragged(mesh_of(MPI.COMM_SELF, 2)), fem.Poisson)[np.ix_(numbers, numbers)]
        equal(found.toarray(), np.kron(dense, np.eye(3)))

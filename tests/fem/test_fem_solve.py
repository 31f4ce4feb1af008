"""Systems of operators at points, against dense solves, on 1 to 4 ranks."""

from __future__ import annotations

import numpy as np
import pytest
from mpi4py import MPI
from scipy.sparse import csr_array

from amrpic import fem
from amrpic.errors import InputError, SolverError
from exact.dense_elements import matrix, on_all_nodes, rows_at, smooth_vector
from verify.operators import ragged


def problem(comm, degree=2, components=1, boxes=2):
    mesh = fem.Mesh(comm, 0, (1, 1.5, 1), (4, 3, 4), degree=degree, max_grid_size=boxes)
    points = fem.jittered(mesh, degree + 2, seed=2)
    f = points.integrate(points.position if components == 3 else points.position[:, 0])
    return mesh, points, f


@pytest.mark.parametrize("components", [1, 3])
@pytest.mark.parametrize("degree", [1, 2, 3])
@pytest.mark.parametrize("preconditioner", ["p-multigrid", "jacobi", "none"])
def test_the_solution_is_that_of_dense_matrices(degree, components, preconditioner):
    mesh, points, f = problem(MPI.COMM_SELF, degree, components)
    fixed, values = mesh.nodes[:, 2] == 0, smooth_vector(mesh, components)
    u, report = fem.solve(
        fem.Poisson(points, components=components), f,
        fixed=fixed, values=values, preconditioner=preconditioner, tolerance=1e-12,
    )  # fmt: skip
    assert report.converged and report.reason == "the tolerance was met"
    assert len(report.residuals) == report.iterations + 1
    assert report.residuals[-1] <= 1e-12 * report.residuals[0] < report.residuals[-2]
    dense = matrix(points, fem.Poisson)
    held, whole, right = (on_all_nodes(mesh, v) for v in (fixed, values, f))
    held = held.astype(bool)
    expected = whole.copy()
    expected[~held] = np.linalg.solve(
        dense[np.ix_(~held, ~held)], right[~held] - dense[np.ix_(~held, held)] @ whole[held]
    )
    assert np.abs(on_all_nodes(mesh, u) - expected).max() < 1e-9 * np.abs(expected).max()


def test_components_are_fixed_one_by_one():
    mesh, points, f = problem(MPI.COMM_SELF, components=3)
    fixed = np.stack([mesh.nodes[:, d] == 0 for d in range(3)], axis=1)
    u, _ = fem.solve(fem.Poisson(points, components=3), f, fixed=fixed, values=0.5, tolerance=1e-12)
    for d in range(3):
        alone, _ = fem.solve(
            fem.Poisson(points), np.ascontiguousarray(f[:, d]), fixed=fixed[:, d], values=0.5, tolerance=1e-12
        )
        assert np.abs(u[:, d] - alone).max() < 1e-9 * np.abs(alone).max()
        assert (u[fixed[:, d], d] == 0.5).all()


def test_jacobi_takes_fewer_iterations_where_weights_differ():
    mesh = fem.Mesh(MPI.COMM_SELF, 0, 1, 4, degree=2)
    whole = fem.uniform(mesh, 4)
    heavy = np.where(whole.position[:, 0] < 0.5, 1.0, 1e3)
    points = fem.given(mesh, whole.position, volume=whole.volume * heavy, weights="volume")
    f = points.integrate(np.ones(len(points)))
    taken = {
        name: fem.solve(fem.Poisson(points), f, fixed=mesh.boundary, preconditioner=name)[1].iterations
        for name in ("jacobi", "none")
    }
    assert taken["jacobi"] < 0.7 * taken["none"], taken


def test_what_is_solved_already_takes_no_iteration():
    mesh, points, f = problem(MPI.COMM_SELF)
    u, report = fem.solve(fem.Mass(points), 0 * f)
    assert report.converged and report.iterations == 0 and (u == 0).all()


@pytest.mark.parametrize("degree", [1, 2])
def test_levels_of_an_operator_serve_those_near_it_and_are_made_anew_for_others(degree):
    mesh, points, f = problem(MPI.COMM_SELF, degree)
    wave, kept = np.sin(5 * points.position).sum(axis=1), fem.Kept()

    def solved(amount, kept=None):
        weight = points.volume * np.exp(amount * wave)
        there = fem.given(mesh, points.position, weight, weights="volume")
        return fem.solve(fem.Poisson(there), f, fixed=mesh.boundary, tolerance=1e-5, kept=kept)

    made: list[object] = []
    for amount in (0.0, 0.1, 4.0, 4.0):
        u, report = solved(amount, kept)
        expected, alone = solved(amount)
        assert report.converged and np.abs(u - expected).max() < 1e-4 * np.abs(expected).max()
        made.append(kept.native)
        if amount < 1:
            assert report.iterations <= alone.iterations + 2
    assert made[0] is made[1] is not None and made[2] is None and made[3] is not None
    assert report.iterations == alone.iterations


def test_a_solve_that_is_cut_short_says_so():
    mesh, points, f = problem(MPI.COMM_SELF)
    _, report = fem.solve(fem.Poisson(points), f, fixed=mesh.boundary, most_iterations=3)
    assert not report.converged and report.iterations == 3 and report.reason == "it took the most iterations"


@pytest.mark.mpi(ranks=(1, 2))
@pytest.mark.parametrize("components", [1, 3])
def test_poisson_without_fixed_nodes_needs_a_balanced_right_hand_side(comm, components):
    """Along constants there is no curvature; what the right-hand side has there stays."""
    _, points, f = problem(comm, 2, components)
    f = f.reshape(-1, components)
    total = comm.allreduce(np.array([*f.sum(axis=0), len(f)]))
    f = (f - total[:-1] / total[-1]).reshape(-1 if components == 1 else (-1, components))
    poisson = fem.Poisson(points, components=components)
    u, report = fem.solve(poisson, f, tolerance=1e-9, preconditioner="jacobi")
    assert report.converged
    wrong = comm.allreduce(float(((poisson @ u - f) ** 2).sum())) / comm.allreduce(float((f**2).sum()))
    assert wrong < 1e-16
    more = f + 1e-3 * np.abs(f).max() * (1.0 if components == 1 else np.array([0, 1, 0]))
    with pytest.raises(InputError, match=r"no node is fixed( in component 1)?, and the right-hand side adds up to"):
        fem.solve(poisson, more, tolerance=1e-9)


MOST = {1: 10, 2: 8, 3: 11, 4: 15}  # iterations to 1e-8


@pytest.mark.parametrize("degree, cells", [(1, 8), (1, 16), (2, 4), (2, 8), (3, 4), (3, 8), (4, 4)])
def test_multigrid_takes_few_iterations_on_any_mesh(degree, cells):
    mesh = fem.Mesh(MPI.COMM_SELF, 0, 1, cells, degree=degree)
    points = fem.jittered(mesh, degree + 2, seed=2, weights="volume")
    f = points.integrate(np.ones((len(points), 3)))
    fixed = np.stack([mesh.nodes[:, d] == 0 for d in (0, 0, 2)], axis=1)
    stiffness = fem.Poisson(points, components=3)
    u, report = fem.solve(stiffness, f, fixed=fixed, tolerance=1e-8)
    assert report.converged and report.iterations <= MOST[degree], report
    plain, by_jacobi = fem.solve(stiffness, f, fixed=fixed, tolerance=1e-10, preconditioner="jacobi")
    assert by_jacobi.iterations > 3 * report.iterations
    assert np.abs(u - plain).max() < 1e-6 * np.abs(plain).max()


def coarser(points):
    """The same points and weights on elements of degree 1."""
    mesh = points.mesh
    corners = fem.Mesh(
        mesh.comm, mesh.domain.lower, mesh.domain.upper, mesh.domain.cells, 1, mesh.hierarchy.max_grid_size
    )
    return fem.Points(corners, points.element, points.reference, points.weight, points.number, weights="volume")


@pytest.mark.parametrize("kind", [fem.Mass, fem.Poisson])
@pytest.mark.parametrize("degree", [2, 3, 4])
def test_the_operator_of_degree_1_is_the_galerkin_product(degree, kind):
    mesh = fem.Mesh(MPI.COMM_SELF, (0, 0, 1), (1, 2, 3), (3, 2, 2), degree=degree)
    points = ragged(mesh)
    corners = coarser(points)
    within = fem.given(corners.mesh, mesh.nodes[np.argsort(mesh.numbers)], weights="volume")
    hats, _ = rows_at(within)
    prolongation = np.empty_like(hats)
    prolongation[within.number] = hats
    product = prolongation.T @ matrix(points, kind) @ prolongation
    direct = matrix(corners, kind)
    assert np.abs(product - direct).max() < 1e-13 * np.abs(direct).max()


@pytest.mark.mpi(ranks=(1, 2, 3))
@pytest.mark.parametrize("components", [1, 3])
def test_rows_of_degree_1_are_those_of_the_matrix(comm, components):
    mesh = fem.Mesh(comm, 0, (1, 2, 1), (4, 3, 5), degree=1, max_grid_size=2)
    operator = fem.Poisson(ragged(mesh), components=components)
    fixed = np.repeat(mesh.nodes[:, 1] == 0, components)
    start, column, value = operator.native.corner_rows(fixed)
    parts = mesh.comm.allgather((np.diff(start), column, value, fixed))
    length, column, value, fixed = (np.concatenate([part[n] for part in parts]) for n in range(4))
    size = len(fixed)
    found = csr_array((value, column, np.concatenate([[0], np.cumsum(length)])), shape=(size, size))
    expected = operator.to_scipy()
    if expected is not None:
        dense = expected.toarray()
        dense[fixed], dense[:, fixed] = 0, 0
        dense[np.diag(dense) == 0, np.diag(dense) == 0] = 1
        assert np.abs(found.toarray() - dense).max() < 1e-12 * dense.max()


def halved(count):
    """Interpolation from every second of so many elements' nodes and the last: (nodes, coarser nodes), and those nodes."""
    kept = sorted({*range(0, count + 1, 2), count})
    return np.array([np.interp(np.arange(count + 1), kept, row) for row in np.eye(len(kept))]).T, kept


@pytest.mark.mpi(ranks=(1, 2, 3))
@pytest.mark.parametrize("cells", [(4, 6, 2), (5, 3, 7), (2, 9, 4)])
@pytest.mark.parametrize("components", [1, 3])
def test_half_the_elements_have_the_galerkin_product_also_of_odd_numbers(comm, cells, components):
    mesh = fem.Mesh(comm, 0, (1, 2, 1), cells, degree=1, max_grid_size=2)
    operator = fem.Poisson(fem.jittered(mesh, 2, weights="volume"), components=components)
    fixed = np.repeat(mesh.nodes[:, 1] == 0, components)
    indices, start, column, value = operator.native.halved_rows(fixed)
    along = [halved(n) for n in cells]
    counts = [len(kept) for _, kept in along]
    parts = mesh.comm.allgather((indices, np.diff(start), column, value, mesh.numbers, fixed))
    indices, length, column, value, numbers, fixed = (np.concatenate([part[n] for part in parts]) for n in range(6))
    assert len(indices) == np.prod(counts)
    found = csr_array((value, column, np.concatenate([[0], np.cumsum(length)]))).toarray()
    expected = operator.to_scipy()
    if expected is None:
        return
    hats = np.kron(along[2][0], np.kron(along[1][0], along[0][0]))[numbers]
    order = indices[:, 0] + counts[0] * (indices[:, 1] + counts[1] * indices[:, 2])
    between = np.kron(hats[:, order], np.eye(components))
    held = np.repeat(indices[:, 1] == 0, components)
    between[fixed], between[:, held] = 0, 0
    product = between.T @ (expected @ between)
    product[held, held] = 1
    assert np.abs(found - product).max() < 1e-13 * np.abs(product).max()


@pytest.mark.parametrize("cells", [(8, 8, 8), (5, 7, 9), (3, 16, 2)])
@pytest.mark.parametrize("degree", [1, 2])
def test_half_the_elements_serve_as_well_as_aggregates(degree, cells):
    mesh = fem.Mesh(MPI.COMM_SELF, 0, np.array(cells) / 8, cells, degree=degree)
    points = fem.jittered(mesh, 3, weights="volume")
    f = points.integrate(np.cos(9 * points.position))
    taken = [
        fem.solve(fem.Poisson(points, components=3), f, fixed=mesh.boundary, tolerance=1e-8, coarse=coarse)[
            1
        ].iterations
        for coarse in ("geometric", "aggregation")
    ]
    assert taken[0] <= taken[1] + 1 and taken[0] <= 10, taken


def with_a_stiff_ball(comm, degree, components, cells, boxes=8):
    """Points of which those in a ball weigh a thousand times as much, and a right-hand side."""
    mesh = fem.Mesh(comm, 0, (1, 1.5, 1), (cells, cells - 1, cells), degree=degree, max_grid_size=boxes)
    drawn = fem.jittered(mesh, degree + 1, seed=2, weights="volume")
    stiff = np.linalg.norm(drawn.position - 0.45, axis=1) < 0.33
    volume = drawn.volume * np.where(stiff, 1.0, 1e-3)
    points = fem.Points(mesh, drawn.element, drawn.reference, volume, drawn.number, weights="volume")
    return fem.Poisson(points, components=components), points.integrate(
        np.cos(9 * points.position[:, :components].squeeze())
    )


@pytest.mark.parametrize("coarse", ["geometric", "aggregation"])
@pytest.mark.parametrize("degree, components, cells, most", [(2, 1, 6, 20), (2, 3, 6, 20), (3, 1, 4, 34)])
def test_elements_with_few_stiff_points_cost_few_iterations(degree, components, cells, most, coarse):
    """32 and 88 where the diagonal alone smooths."""
    poisson, f = with_a_stiff_ball(MPI.COMM_SELF, degree, components, cells)
    fixed = poisson.mesh.boundary
    u, report = fem.solve(poisson, f, fixed=fixed, tolerance=1e-8, coarse=coarse)
    assert report.converged and report.iterations <= most, report
    plain, _ = fem.solve(poisson, f, fixed=fixed, tolerance=1e-11, preconditioner="jacobi")
    assert np.abs(u - plain).max() < 1e-5 * np.abs(plain).max()


@pytest.mark.mpi(ranks=(1, 2, 3), more=(4,))
def test_elements_with_few_stiff_points_are_the_same_on_ranks(comm):
    found = []
    for who, boxes in ((MPI.COMM_SELF, 8), (comm, 2)):
        poisson, f = with_a_stiff_ball(who, 2, 3, 6, boxes)
        u, report = fem.solve(poisson, f, fixed=poisson.mesh.boundary, tolerance=1e-10)
        found.append((on_all_nodes(poisson.mesh, u), report.iterations))
    assert abs(found[0][1] - found[1][1]) <= 1
    assert np.abs(found[0][0] - found[1][0]).max() < 1e-8 * np.abs(found[0][0]).max()


@pytest.mark.mpi(ranks=(1, 2, 3), more=(4,))
@pytest.mark.parametrize("preconditioner", ["p-multigrid", "jacobi"])
def test_ranks_find_the_same_solution_in_as_many_iterations(comm, preconditioner):
    found = []
    for who, boxes in ((MPI.COMM_SELF, 8), (comm, 2)):
        mesh, points, f = problem(who, components=3, boxes=boxes)
        u, report = fem.solve(
            fem.Poisson(points, components=3), f,
            fixed=mesh.boundary, values=smooth_vector(mesh, 3), preconditioner=preconditioner,
        )  # fmt: skip
        found.append((on_all_nodes(mesh, u), report.iterations))
    assert abs(found[0][1] - found[1][1]) <= 1
    assert np.abs(found[0][0] - found[1][0]).max() < 1e-9


@pytest.mark.mpi(ranks=(1, 2))
def test_free_nodes_without_points_are_refused(comm):
    mesh = fem.Mesh(comm, 0, 1, 4, degree=2, max_grid_size=2)
    points = fem.given(mesh, [[0.1, 0.1, 0.1]] * 30)
    with pytest.raises(
        SolverError, match=r"no point says anything about \d+ unknowns.*; fix these nodes or put points there"
    ):
        fem.solve(fem.Mass(points), points.integrate(np.ones(len(points))))

"""Order 4: each row is the oracle's, fluxes cancel, errors fall by h⁴, on every mesh, for every kind of wall."""

from __future__ import annotations

from dataclasses import replace
from itertools import product
from typing import Any

import numpy as np
import pytest
from mpi4py import MPI
from scipy.constants import epsilon_0
from scipy.sparse.linalg import spsolve

import amrpic
from amrpic import PoissonSolver, _native
from amrpic.errors import InputError, SolverError
from amrpic.mesh.field import Field
from exact.errors import errors, observed_order
from exact.meshes import MESHES, Mesh
from exact.sources import Gaussian, Product, Source, Wave, fill
from fourth_order_oracle import Oracle
from fuzz import CYCLE_LIMITS
from hierarchies import Case, all_cases
from rank_subsets import hierarchy_of
from verify.convergence import outward_slope, smooth

TURN = 2 * np.pi
MIXED = {"x": ("dirichlet", "neumann"), "y": "neumann", "z": ("neumann", "dirichlet")}
WAVES = Product((Wave(TURN, 0.3), Wave(TURN, 1.0), Wave(2 * TURN, 0.2)))
ONE_AXIS = {"x": "periodic", "y": ("dirichlet", "neumann"), "z": "dirichlet"}
MOST_ROWS, OF_LONG_TESTS = 800, 3000  # that the oracle makes of a case, cell by cell


def closed(case: Case) -> Case:
    """The case with Dirichlet walls in place of open ones."""

    def kept(kind: str) -> str:
        return "dirichlet" if kind == "open" else kind

    return replace(case, boundary={axis: (kept(lower), kept(upper)) for axis, (lower, upper) in case.boundary.items()})


CASES = {name: closed(case) for name, case in all_cases().items()}


def _rows(case: Case) -> int:
    boxes = [box for level in case.all_boxes() for box in level]
    return sum(int(np.prod([box[3 + d] - box[d] + 1 for d in range(3)])) for box in boxes)


SMALL = [
    pytest.param(name, marks=[pytest.mark.long] if _rows(case) > MOST_ROWS else [])
    for name, case in sorted(CASES.items())
    if _rows(case) <= OF_LONG_TESTS
]


def drawn(hierarchy: amrpic.Hierarchy, seed: int) -> Field:
    """Values without any pattern, the same on any boxes and ranks."""
    field = Field(hierarchy)
    for patch in field.patches:
        low, shape = np.array(patch.lower), patch.data.shape
        at = np.meshgrid(*(low[d] + np.arange(shape[d]) for d in range(3)), indexing="ij")
        patch.data[...] = np.sin(12.9898 * at[0] + 78.233 * at[1] + 37.719 * at[2] + 7.1 * patch.level + seed) * 2
    field.native.average_down()
    field.holds = "means"
    return field


def walls(solver: PoissonSolver) -> tuple[list[np.ndarray], dict[tuple, float]]:
    """Data without any pattern for each level's walls, and the same by level, cell, axis and side."""
    lists, by_face = [], {}
    hierarchy = solver.hierarchy
    lower, upper = np.array(hierarchy.domain.lower), np.array(hierarchy.domain.upper)
    for level in range(hierarchy.levels):
        _, axes, points = solver.native.wall_faces(level)
        width = hierarchy.spacing(level)
        data = np.sin(3.1 * points @ [1.0, 2.0, 3.0] + 5 * level + axes)
        for axis, point, value in zip(axes, points, data, strict=True):
            side = -1 if point[axis] < (lower + upper)[axis] / 2 else 1
            inside = point.copy()
            inside[axis] -= side * width[axis] / 2
            cell = tuple(int(i) for i in np.floor((inside - lower) / width))
            by_face["wall", level, cell, int(axis), side] = float(value)
        lists.append(data)
    return lists, by_face


def leaf_values(field: Field) -> np.ndarray:
    """The uncovered cells, level by level, box by box, x fastest."""
    return np.concatenate([np.zeros(0), *(p.data.ravel(order="F")[~p.covered.ravel(order="F")] for p in field.patches)])


@pytest.mark.parametrize("name", SMALL)
def test_each_row_is_that_of_the_oracle(name):
    hierarchy = hierarchy_of(CASES[name], MPI.COMM_SELF)
    solver = PoissonSolver(hierarchy, order=4)
    data, by_face = walls(solver)
    phi, rho = drawn(hierarchy, 1), drawn(hierarchy, 2)
    laplacian = _native.CompositeLaplacian(hierarchy.native, [1.0] * 3, shift=0.7, order=4)
    largest, residual, clean = laplacian.residual(
        rho.native, 0.0, data, phi.native, _native.Norm.max, [1.0] * hierarchy.levels
    )
    matrix, of_walls, _ = Oracle(hierarchy, shift=0.7).matrix()
    expected = -leaf_values(rho) / epsilon_0 - matrix @ leaf_values(phi)
    for wall, weights in of_walls.items():
        for row, weight in weights:
            expected[row] -= weight * by_face[wall]
    found = Field(hierarchy)
    for level in range(hierarchy.levels):
        found.array(level)[:] = residual[level]
    rounding = 1e-13 * np.abs(expected).max()
    assert clean and leaf_values(found) == pytest.approx(expected, abs=rounding)
    assert largest == pytest.approx(np.abs(expected).max(), rel=1e-12)


@pytest.mark.parametrize("name", ["nested cubes", "L-shape", "patch at a corner"])
def test_the_potential_is_that_of_scipy(name):
    hierarchy = MESHES[name].hierarchy(MPI.COMM_SELF, 8, MIXED)
    rho = drawn(hierarchy, 3)
    rho.native.average_down()
    phi, report = PoissonSolver(hierarchy, order=4, tolerance=1e-12).solve(rho)
    matrix, _, _ = Oracle(hierarchy).matrix()
    exact = spsolve(matrix.tocsc(), -leaf_values(rho) / epsilon_0)
    assert report.converged
    assert phi.holds == "means"
    assert leaf_values(phi) == pytest.approx(exact, abs=1e-9 * np.abs(exact).max())


@pytest.mark.mpi(ranks=3)
@pytest.mark.parametrize("name", sorted(CASES)[::4])
def test_residuals_depend_neither_on_ranks_nor_on_boxes(comm, name):
    """Not even by rounding."""
    sums = []
    for size, of in ((CASES[name].max_grid_size, MPI.COMM_SELF), (8, comm)):
        hierarchy = hierarchy_of(replace(CASES[name], max_grid_size=size), of)
        laplacian = _native.CompositeLaplacian(hierarchy.native, [1.0] * 3, order=4)
        solver = PoissonSolver(hierarchy, order=4)
        data, _ = walls(solver)
        rho, phi = drawn(hierarchy, 2), drawn(hierarchy, 1)
        arguments = rho.native, 0.0, data, phi.native, _native.Norm.max, [1.0] * hierarchy.levels
        largest, residual, _ = laplacian.residual(*arguments)
        out = Field(hierarchy)
        for level in range(hierarchy.levels):
            out.array(level)[:] = residual[level]
        sums.append((largest, np.sort(np.concatenate(of.allgather(leaf_values(out))))))
    assert sums[0][0] == sums[1][0]
    assert np.array_equal(sums[0][1], sums[1][1])


@pytest.mark.parametrize("name", sorted(MESHES))
def test_one_flux_passes_each_face(name):
    """Between walls that let none pass, and around periodic axes, the residuals of any potential add up to the charge."""
    for boundary in ("neumann", "periodic"):
        hierarchy = MESHES[name].hierarchy(MPI.COMM_SELF, 8, boundary)
        laplacian = _native.CompositeLaplacian(hierarchy.native, [1.0] * 3, order=4)
        solver = PoissonSolver(hierarchy, order=4, background="neutralizing")
        phi, rho = drawn(hierarchy, 1), Field(hierarchy)
        zero = [np.zeros(len(solver.native.wall_data(level))) for level in range(hierarchy.levels)]
        _, residual, _ = laplacian.residual(
            rho.native, 0.0, zero, phi.native, _native.Norm.max, [1.0] * hierarchy.levels
        )
        out = Field(hierarchy)
        for level in range(hierarchy.levels):
            out.array(level)[:] = residual[level]
        assert abs(out.integral()) < 1e-13 * abs(out).integral(), boundary


def measured(
    mesh: Mesh, source: Source, boundary: Any, cells: tuple[int, ...], means: bool = True
) -> tuple[np.ndarray, int]:
    """Orders of φ (L2, max) and E (L2, max) at points, and the most cycles."""
    rows, most = [], 0
    for n in cells:
        hierarchy = mesh.hierarchy(MPI.COMM_SELF, n, boundary)
        singular = hierarchy.domain.singular
        solver = PoissonSolver(hierarchy, order=4, background="neutralizing" if singular else None)
        rho = fill(Field(hierarchy), source)
        rho.holds = "means"
        if not means:
            rho = rho.as_points()
        slope = outward_slope(hierarchy, source)
        phi, report = solver.solve(rho, boundary_values=source.potential, boundary_flux=slope)
        assert report.converged, report.reason
        most = max(most, report.cycles)
        of_phi = errors([phi.as_points()], source.potential, shift=singular)
        rows.append([*of_phi, *errors(solver.electric_field(phi).components, source.field)])
    table = np.array(rows)
    return np.array([observed_order(cells, table[:, c].tolist()) for c in range(4)]), most


@pytest.mark.parametrize("boundary", ["dirichlet", "neumann"])
@pytest.mark.parametrize("name", sorted(MESHES))
def test_orders_on_all_meshes(name, boundary):
    order, cycles = measured(MESHES[name], smooth(MESHES[name].size), boundary, (16, 32))
    dirichlet = boundary == "dirichlet"
    assert order[1] > 3.7
    assert order[2] > (3.9 if dirichlet else 3.7)  # 3.73 by differences to the potential of the wall
    assert order[3] > (2.8 if dirichlet else 3.5)
    assert cycles <= (17 if dirichlet else 13)


@pytest.mark.parametrize("name", sorted(MESHES))
def test_orders_between_open_walls(name):
    """Charge lies on coarse-fine faces of most of these meshes."""
    mesh = MESHES[name]
    place = {"face": (0.48, 0.5, 0.5), "edge": (0.42, 0.42, 0.5), "corner": (0.42, 0.42, 0.42)}
    centre = place.get(name.rsplit(" ", 1)[-1], (0.5, 0.5, 0.5))
    source = Gaussian(tuple(0.068 * np.array(mesh.size)), tuple(np.array(centre) * mesh.size))
    fine = len(mesh.levels) > 2 or mesh.size[2] > 1
    order, cycles = measured(mesh, source, "open", (32, 48) if fine else (64, 96))
    assert min(order[1:3]) > 3.7
    assert order[3] > 3.5
    assert cycles <= 13


@pytest.mark.parametrize("means", [True, False])
def test_orders_around_periodic_axes(means):
    order, cycles = measured(MESHES["nested cubes"], WAVES, "periodic", (16, 32), means)
    assert min(order[1:3]) > 3.7 and order[3] > 3.5
    assert cycles <= 13


def test_orders_where_charge_lies_on_a_coarse_fine_face():
    on_face = Mesh(MESHES["nested cubes"].levels[:1])
    source = Gaussian((0.1,) * 3, (0.25, 0.5, 0.5))
    order, cycles = measured(on_face, source, "dirichlet", (32, 48))
    assert min(order[1:3]) > 3.7 and order[3] > 3.5
    assert cycles <= 17


def test_points_and_means_differ_by_the_second_differences():
    """The mean of cos kx over a cell is sin(kh/2)/(kh/2) of its value at the centre."""
    hierarchy = MESHES["L-shape"].hierarchy(MPI.COMM_SELF, 32, "neumann")
    points = Field(hierarchy).fill(lambda x, y, z: np.cos(2 * x + 0.3) + 0 * y + np.cos(3 * z) + 0 * y)
    means = points.as_means()
    assert (points.holds, means.holds, means.as_means() is means) == ("points", "means", True)
    worst = 0.0
    for patch in means.patches:
        x, _, z = patch.centres()
        h = hierarchy.spacing(patch.level)
        exact = np.cos(2 * x + 0.3) * np.sinc(2 * h[0] / TURN) + np.cos(3 * z) * np.sinc(3 * h[2] / TURN)
        worst = max(worst, float(np.abs(patch.data - exact).max(where=~patch.covered, initial=0)))
    step = 1 / 32
    assert worst < 30 * step**3 / 24  # the third derivative where levels end
    back = means.as_points()
    assert leaf_values(back) == pytest.approx(leaf_values(points), abs=2 * worst)
    with pytest.raises(InputError, match="one field holds means, the other points"):
        means + points


def test_e_comes_as_means_or_at_points():
    hierarchy = MESHES["nested cubes"].hierarchy(MPI.COMM_SELF, 16, "periodic")
    solver = PoissonSolver(hierarchy, order=4, background="neutralizing")
    rho = fill(Field(hierarchy), WAVES)
    rho.holds = "means"
    phi, _ = solver.solve(rho)
    points, means = (solver.electric_field(phi, holds=holds) for holds in ("points", "means"))
    assert [c.holds for c in means.components] == ["means"] * 3
    assert leaf_values(means.x.as_points()) == pytest.approx(leaf_values(points.x), abs=1e-12 * points.x.max_abs())
    with pytest.raises(SolverError, match="order 4 knows"):
        PoissonSolver(hierarchy, background="neutralizing").electric_field(phi, holds="means")


@pytest.mark.mpi(ranks=(2, 3, 4))
def test_cycles_and_potentials_are_the_same_on_any_boxes_and_ranks(comm):
    points = np.random.default_rng(3).uniform(0.02, 0.98, (200, 3))
    for name, boundary in product(("nested cubes", "patch at a corner"), ("dirichlet", "neumann", "open")):
        cycles, sampled, fields = [], [], []
        for size, of in ((32, MPI.COMM_SELF), (8, comm), (16, comm)):
            hierarchy = MESHES[name].hierarchy(of, 16, boundary, max_grid_size=size)
            solver = PoissonSolver(hierarchy, order=4, background="neutralizing" if boundary == "neumann" else None)
            phi, report = solver.solve(fill(Field(hierarchy), Gaussian((0.1,) * 3, (0.4, 0.4, 0.4))))
            assert report.converged
            cycles.append(report.cycles)
            sampled.append(phi.sample(points))
            fields.append(solver.electric_field(phi).sample(points))
        assert max(cycles) - min(cycles) <= 1, (name, boundary)
        for other in sampled[1:]:
            assert other == pytest.approx(sampled[0], abs=1e-8 * np.abs(sampled[0]).max()), (name, boundary)
        for other in fields[1:]:
            assert other == pytest.approx(fields[0], abs=1e-7 * np.abs(fields[0]).max()), (name, boundary)


def _long_cases() -> list[tuple[str, tuple[float, ...], str]]:
    """Meshes, lengths of the domain of as many cells along each axis, and walls: cells from 1:1 to 1:20."""
    random = np.random.default_rng(24)
    cases = []
    for name, boundary in product(("uniform", "nested cubes", "L-shape"), ("dirichlet", "neumann", "periodic", "open")):
        longest = float(random.choice([2, 5, 10, 20]))
        size = random.permutation([1.0, longest, float(random.choice([1, longest ** random.uniform(), longest]))])
        cases.append((name, tuple(size.tolist()), boundary))
    return [*cases, ("nested cubes", (1.0, 20.0, 20.0), "neumann"), ("L-shape", (1.0, 1.0, 20.0), "dirichlet")]


@pytest.mark.parametrize(("name", "size", "boundary"), _long_cases())
def test_on_long_cells_solves_take_at_most_twice_what_the_fuzz_allows(name, size, boundary):
    """Whatever the charge."""
    hierarchy = replace(MESHES[name], size=size).hierarchy(MPI.COMM_SELF, 16, boundary)
    singular = hierarchy.domain.singular
    aspect = max(size) / min(size)
    most = 2 * next(cycles for up_to, cycles in CYCLE_LIMITS if aspect <= up_to)
    smooth_one = fill(Field(hierarchy), Gaussian(tuple(0.1 * np.array(size)), tuple(0.5 * np.array(size))))
    for rho in (smooth_one, drawn(hierarchy, 4)):
        rho.holds = "means"
        solver = PoissonSolver(hierarchy, order=4, background="neutralizing" if singular else None)
        _, report = solver.solve(rho)
        assert report.converged, report.reason
        assert report.cycles <= most


def test_to_the_discretization_error_takes_fewer_cycles_and_costs_little_accuracy():
    source = Gaussian((0.08,) * 3, (0.5, 0.5, 0.5))
    hierarchy = MESHES["nested cubes"].hierarchy(MPI.COMM_SELF, 32, "dirichlet")
    rho = fill(Field(hierarchy), source)
    rho.holds = "means"
    found = {}
    for tolerance in (1e-10, "discretization"):
        solver = PoissonSolver(hierarchy, order=4, tolerance=tolerance)
        phi, report = solver.solve(rho, boundary_values=source.potential)
        assert report.converged, report.reason
        found[tolerance] = report, errors([phi.as_points()], source.potential)[1]
    (full, error), (short, near) = found.values()
    assert short.cycles < full.cycles - 2
    assert near < 1.3 * error
    largest = max(float(source.potential(np.array(0.5), np.array(0.5), np.array(0.5))), 0)
    assert 0.1 < short.discretization_error / (error * largest) < 10


def test_what_order_4_cannot_do_is_refused():
    hierarchy = MESHES["uniform"].hierarchy(MPI.COMM_SELF, 8, "dirichlet")
    with pytest.raises(SolverError, match="order is 4, which is what the matrix-free backend has alone"):
        PoissonSolver(hierarchy, order=4, backend="crs")
    opened = MESHES["uniform"].hierarchy(MPI.COMM_SELF, 8, "open")
    with pytest.raises(SolverError, match="reuse comes from a solver of another domain, order"):
        PoissonSolver(opened, order=4, reuse=PoissonSolver(opened).base_setup)
    with pytest.raises(SolverError, match="order"):
        PoissonSolver(hierarchy, order=3)
    laplacian = _native.CompositeLaplacian(opened.native, [1.0] * 3, order=4)
    data = [PoissonSolver(opened).native.wall_data(0)]
    rho, phi = Field(opened), Field(opened)
    with pytest.raises(_native.SolverError, match="behind open walls the Laplacian of order 4 reads two layers"):
        laplacian.residual(rho.native, 0.0, data, phi.native, _native.Norm.max, [1.0])

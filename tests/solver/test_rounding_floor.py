"""The residual that rounding leaves: its estimate against what is reached, on 50 meshes.

An ordinary run of the tests takes a few of them on coarse meshes; the long form (`pytest -m long`) all, by both backends.
"""

from __future__ import annotations

import itertools

import numpy as np
import pytest
from mpi4py import MPI

import amrpic
import backends
from amrpic.stages.poisson import PoissonSolver
from static_case import EPS0


def smooth(x, y, z):
    return EPS0 * np.exp(-((x - 0.45) ** 2 + (y - 0.5) ** 2 + (z - 0.55) ** 2) / 0.02)


def random(x, y, z):
    return EPS0 * np.random.default_rng(5).standard_normal(np.broadcast(x, y, z).shape)


def nearly_uniform(x, y, z):
    return EPS0 * (1 + 1e-5 * np.cos(2 * np.pi * x) * np.cos(2 * np.pi * y)) + 0 * z


WALLS = ("dirichlet", "open", "neumann", "periodic", {"x": "dirichlet", "y": "neumann", "z": "periodic"})
MESHES = [
    (*mesh, (smooth, random, nearly_uniform)[n % 3], ("max", "l2", "l1")[n // 2 % 3])
    for n, mesh in enumerate(itertools.product(WALLS, (False, True), (1, 3, 10, 30, 100)))
]


def solver_and_charge(mesh, backend, tolerance, finer):
    walls, refined, aspect, source, norm = mesh
    cells = 32 if aspect < 30 and finer else 16
    middle = [[((cells // 2,) * 3, (3 * cells // 2 - 1,) * 3)]] if refined else ()
    domain = amrpic.Domain((0, 0, 0), (1, 1, 1), (cells,) * 3, boundary=walls)
    hierarchy = amrpic.Hierarchy(MPI.COMM_SELF, domain, middle, blocking_factor=4)
    solver = PoissonSolver(
        hierarchy, tolerance, norm, backend, stretch=(1, 1, aspect), background="neutralizing", max_cycles=200
    )
    return solver, amrpic.Field(hierarchy).fill(source)


FEW = [(number, backends.DEFAULT, False) for number in range(0, 50, 6)]
ALL = [
    pytest.param(number, backend, True, marks=pytest.mark.long)
    for number in range(50)
    for backend in (backends.DEFAULT, "crs")
]


@pytest.mark.parametrize(("number", "backend", "finer"), [*FEW, *ALL])
def test_floor_is_what_a_solve_without_tolerance_reaches(number, backend, finer):
    solver, rho = solver_and_charge(MESHES[number], backend, 0.0, finer)
    _, report = solver.solve(rho)
    assert report.converged and "rounding floor" in report.reason
    reached = min(report.residuals)
    assert report.floor / 10 < reached < 10 * report.floor

    solver, rho = solver_and_charge(MESHES[number], backend, 1.5 * reached, finer)
    _, report = solver.solve(rho)
    assert report.reason == "tolerance reached" and report.floor == 0


def test_a_tolerance_that_is_met_is_not_called_out_of_reach():
    """Very long cells: cycles that gain little, near the floor but not yet there."""
    domain = amrpic.Domain((-1, -1, -1), (1, 1, 1), (32,) * 3, boundary="dirichlet")
    hierarchy = amrpic.Hierarchy(MPI.COMM_SELF, domain, [[((16,) * 3, (47,) * 3)]], blocking_factor=8)
    rho = amrpic.Field(hierarchy).fill(lambda x, y, z: EPS0 * np.exp(-20 * (x**2 + y**2 + z**2)))
    for gamma in (100, 1000):
        found = PoissonSolver(hierarchy, 0.0, stretch=(1, 1, gamma), max_cycles=200).solve(rho)[1]
        for tolerance in (1.2 * min(found.residuals), 3 * min(found.residuals), 1e-10):
            report = PoissonSolver(hierarchy, tolerance, stretch=(1, 1, gamma), max_cycles=200).solve(rho)[1]
            assert report.reason == "tolerance reached" and report.floor == 0


LONG_BOXES = [
    *[((0, 4, 12), (3, 7, 15)), ((0, 8, 20), (13, 11, 23)), ((0, 8, 24), (7, 11, 27)), ((4, 8, 8), (13, 11, 15))],
    *[((4, 8, 16), (7, 11, 19)), ((4, 8, 28), (7, 11, 31)), ((4, 8, 36), (7, 11, 37)), ((8, 0, 0), (11, 7, 3))],
    *[((8, 0, 8), (11, 7, 15)), ((8, 0, 20), (11, 7, 23)), ((8, 4, 4), (13, 11, 7)), ((12, 4, 20), (13, 7, 23))],
    ((12, 4, 28), (13, 11, 31)),
]


@pytest.mark.parametrize("backend", [backends.DEFAULT, "crs"])
def test_cycles_end_where_rounding_at_refined_long_cells_leaves_more_than_the_estimate(backend):
    """Cells of 1:250 that nothing holds: the matrix's rows at refined ones leave 20 times the estimate."""
    faces = {"x": "periodic", "y": "periodic", "z": "neumann"}
    domain = amrpic.Domain((0, 0, 0), (7.0, 1503.0, 4759.5), (7, 6, 19), boundary=faces)
    hierarchy = amrpic.Hierarchy(MPI.COMM_SELF, domain, [LONG_BOXES], blocking_factor=2)
    solver = PoissonSolver(hierarchy, tolerance=1e-10, backend=backend, background="neutralizing")
    place, width = np.multiply(domain.upper, (0.41, 0.55, 0.47)), 0.06 * np.array(domain.upper)
    rho = amrpic.Field(hierarchy).fill(
        lambda *at: EPS0 * np.exp(-sum(((x - p) / w) ** 2 for x, p, w in zip(at, place, width, strict=True)) / 2)
    )
    _, report = solver.solve(rho)
    assert report.converged and report.cycles <= 40 and report.residuals[-1] < 2e-9

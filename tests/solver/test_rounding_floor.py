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

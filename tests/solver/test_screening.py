"""Screened Poisson, −Δφ + κ²φ = ρ/ε₀, on refined meshes: manufactured solutions, both backends, weak and strong screening."""

from __future__ import annotations

import numpy as np
import pytest
from mpi4py import MPI
from scipy.constants import epsilon_0

import amrpic
import backends
from amrpic.errors import SceneError, SolverError

WAVE = 2 * np.pi
BACKENDS = (backends.DEFAULT, "crs")
SCREENINGS = (0.01, 0.1, 1.0, 10.0)  # κ times the width of a base cell
BASE = 32


def wave(boundary: str):
    """A potential in V, and −Δ of it: along each axis one period, or half of one between grounded walls."""
    function, k = (np.cos, WAVE) if boundary == "periodic" else (np.sin, WAVE / 2)

    def phi(x, y, z):
        return function(k * x) * function(k * y) * function(k * z)

    return phi, lambda x, y, z: 3 * k**2 * phi(x, y, z)


def nested(comm: MPI.Comm, n: int, boundary: str) -> amrpic.Hierarchy:
    """A base of n³ cells of the unit cube and two nested levels in its middle."""
    domain = amrpic.Domain((0, 0, 0), (1, 1, 1), (n, n, n), boundary=boundary)
    first = ((n // 2,) * 3, (3 * n // 2 - 1,) * 3)
    second = ((3 * n // 2,) * 3, (5 * n // 2 - 1,) * 3)
    return amrpic.Hierarchy(comm, domain, [[first], [second]], max_grid_size=24, blocking_factor=4)


def solved(comm: MPI.Comm, n: int, boundary: str, screening: float, backend: str, **options):
    """The largest error of φ, φ and how the solve went; `screening` in 1/m."""
    hierarchy = nested(comm, n, boundary)
    phi, minus_laplacian = wave(boundary)
    rho = amrpic.Field(hierarchy).fill(
        lambda x, y, z: epsilon_0 * (minus_laplacian(x, y, z) + screening**2 * phi(x, y, z))
    )
    solver = amrpic.PoissonSolver(hierarchy, backend=backend, screening=screening, **options)
    found, report = solver.solve(rho)
    exact = amrpic.Field(hierarchy).fill(phi)
    error = max(float(np.abs(found.array(level) - exact.array(level)).max(initial=0)) for level in range(3))
    return comm.allreduce(error, op=MPI.MAX), found, report


@pytest.mark.parametrize("backend", BACKENDS)
@pytest.mark.parametrize("boundary", ["dirichlet", "periodic"])
@pytest.mark.parametrize("kappa_h", SCREENINGS)
def test_second_order_and_few_cycles_on_two_nested_levels(comm, boundary, kappa_h, backend):
    """κh from 0.01 to 10 on a base of 32 cells; κ stays as the mesh is refined."""
    screening = kappa_h * BASE
    errors = []
    for n in (16, 32):
        error, _, report = solved(comm, n, boundary, screening, backend)
        assert report.converged and report.cycles <= 8
        errors.append(error)
    assert np.log2(errors[0] / errors[1]) > 1.8


@pytest.mark.mpi(ranks=(1, 2, 3))
def test_both_backends_give_the_same_potential_on_any_ranks(comm):
    potentials = [solved(comm, 32, "periodic", 5.0, backend, tolerance=1e-12)[1] for backend in BACKENDS]
    for level in range(3):
        a, b = (phi.array(level) for phi in potentials)
        assert np.abs(a - b).max(initial=0) < 1e-10


def test_a_screened_potential_between_neumann_walls_has_a_mean_and_takes_any_net_charge(comm):
    domain = amrpic.Domain((0, 0, 0), (1, 1, 1), (16, 16, 16), boundary="neumann")
    hierarchy = amrpic.Hierarchy(comm, domain)
    rho = amrpic.Field(hierarchy).fill(lambda x, y, z: epsilon_0 + 0 * (x + y + z))
    phi, report = amrpic.PoissonSolver(hierarchy, screening=2.0).solve(rho)
    assert report.converged
    assert np.allclose(phi.array(0), 1 / 4, rtol=1e-9)


def test_screening_is_refused_behind_open_walls_and_below_zero(comm):
    walls = amrpic.Hierarchy(
        comm, amrpic.Domain((0, 0, 0), (1, 1, 1), (16, 16, 16), boundary={"x": "dirichlet", "y": "neumann"})
    )
    with pytest.raises(SolverError, match="screening"):
        amrpic.PoissonSolver(walls, screening=1.0)
    closed = amrpic.Hierarchy(comm, amrpic.Domain((0, 0, 0), (1, 1, 1), (16, 16, 16), boundary="periodic"))
    with pytest.raises(SolverError, match="screening"):
        amrpic.PoissonSolver(closed, screening=-1.0)
    with pytest.raises(SceneError, match="screening"):
        amrpic.Scene.from_dict({"domain": {"lower": -1, "upper": 1, "cells": 16}, "solver": {"screening": 1.0}})

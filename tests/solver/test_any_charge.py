"""Charge as it comes: nearly uniform, cancelled by hand, very small and very large; both backends, one rank and more."""

from __future__ import annotations

import functools
import re

import numpy as np
import pytest
from mpi4py import MPI

import amrpic
import backends
from amrpic.errors import SolverError
from amrpic.stages.poisson import PoissonSolver
from static_case import EPS0

BACKENDS = (backends.DEFAULT, "crs")


def cube(comm, cells=16, boundary="periodic", levels=()):
    domain = amrpic.Domain((0, 0, 0), (1, 1, 1), (cells,) * 3, boundary=boundary)
    return amrpic.Hierarchy(comm, domain, levels, max_grid_size=8, blocking_factor=4)


def middle(cells):
    return [[((cells // 2,) * 3, (3 * cells // 2 - 1,) * 3)]]


def largest(field):
    return field.max_abs()


def wave(x, y, z):
    return np.cos(2 * np.pi * x) + 0 * y * z


# ---- nearly uniform charge on a neutralizing background ----


@pytest.mark.mpi(ranks=(1, 2))
@pytest.mark.parametrize("density", [0.1, 1 / 3, 1e30])
@pytest.mark.parametrize("backend", BACKENDS)
def test_uniform_charge_on_its_background_makes_no_potential(comm, backend, density):
    for cells, levels in ((4, ()), (8, middle(8))):
        hierarchy = cube(comm, cells, levels=levels)
        rho = amrpic.Field(hierarchy).fill(lambda x, y, z: density + 0 * x)
        phi, report = PoissonSolver(hierarchy, backend=backend, background="neutralizing").solve(rho)
        assert report.converged and report.cycles == 0
        assert report.reason in (
            "the charge is uniform to rounding, so the potential is zero",
            "the right-hand side is zero",
        )
        assert largest(phi) == 0


@pytest.mark.mpi(ranks=(1, 2))
@pytest.mark.parametrize("share", [1e-6, 1e-12])
@pytest.mark.parametrize("backend", BACKENDS)
def test_a_wave_on_a_uniform_charge_converges_however_weak_it_is(comm, backend, share):
    """φ of the wave itself, less what rounding to doubles took from the wave in ρ."""
    potentials = []
    for uniform, wanted in ((0.1, share), (0.0, 1.0)):
        hierarchy = cube(comm, 16, levels=middle(16))
        rho = amrpic.Field(hierarchy).fill(lambda *x, u=uniform, w=wanted: u + 0.1 * w * wave(*x))
        phi, report = PoissonSolver(hierarchy, backend=backend, background="neutralizing").solve(rho)
        assert report.converged and report.reason == "tolerance reached" and report.cycles <= 9
        potentials.append(phi)
    rounded, exact = potentials
    points = np.random.default_rng(1).uniform(0, 1, (200, 3))
    difference = rounded.sample(points) / share - exact.sample(points)
    lost = np.finfo(float).eps / share  # of ρ, relative
    assert np.abs(difference).max() <= (1e-9 + lost) * largest(exact)


# ---- a background that was taken away by hand ----


@pytest.mark.mpi(ranks=(1, 2))
@pytest.mark.parametrize("share", [0.0, 1e-9])
@pytest.mark.parametrize("uniform", [0.1, 1e-9])
@pytest.mark.parametrize("backend", BACKENDS)
def test_rounding_left_by_hand_is_no_net_charge(comm, backend, uniform, share):
    hierarchy = cube(comm)
    missed = 1 + 3 * np.finfo(float).eps
    rho = amrpic.Field(hierarchy).fill(lambda *x: uniform * (1 + share * wave(*x)) - uniform * missed)
    phi, report = PoissonSolver(hierarchy, backend=backend).solve(rho)
    assert report.converged
    if share == 0:
        assert largest(phi) == 0 and "zero" in report.reason
    else:
        amplitude = share * uniform / EPS0 / (32 * np.sin(np.pi / 16)) ** 2  # of the lattice's wave
        assert largest(phi) == pytest.approx(amplitude * np.cos(np.pi / 16), rel=1e-8 + 1e-15 / share)


@pytest.mark.mpi(ranks=(1, 2))
@pytest.mark.parametrize("density", [1.0, 1e-17, 1e-280])
@pytest.mark.parametrize("backend", BACKENDS)
def test_a_net_charge_is_refused_whatever_its_size(comm, backend, density):
    hierarchy = cube(comm)
    solver = PoissonSolver(hierarchy, backend=backend)
    with pytest.raises(SolverError, match="net charge .* is " + re.escape(f"{density:.2e} C")):
        solver.solve(amrpic.Field(hierarchy).fill(lambda x, y, z: density + 0 * x))
    with pytest.raises(SolverError, match="net charge"):
        solver.solve(amrpic.Field(hierarchy).fill(lambda x, y, z: density * np.exp(-20 * (x - 0.5) ** 2)))


# ---- magnitudes ----


@pytest.mark.mpi(ranks=(1, 2))
@pytest.mark.parametrize("norm", ["l1", "l2", "max"])
@pytest.mark.parametrize("backend", BACKENDS)
def test_potential_is_proportional_to_charge_of_any_size(comm, backend, norm):
    for boundary in ("dirichlet", "open", "neumann"):
        hierarchy = cube(comm, 16, boundary, middle(16))
        solver = PoissonSolver(hierarchy, norm=norm, backend=backend, krylov="bicgstab" if backend == "crs" else "none")
        found = []
        for size in (1.0, 1e-280, 1e-150, 1e200):
            rho = amrpic.Field(hierarchy).fill(lambda *x, s=size: s * np.cos(2 * np.pi * x[0]) * np.cos(np.pi * x[1]))
            phi, report = solver.solve(rho)
            assert report.converged and report.cycles > 0 and "rounding" not in report.reason
            found.append((largest(phi) / size, report.cycles))
        assert all(f == pytest.approx(found[0], rel=1e-9) for f in found)


def ramp(size, x, y, z):
    return size * (1 + x)


@pytest.mark.parametrize("backend", BACKENDS)
def test_charge_beyond_double_precision_is_refused_in_one_sentence(backend):
    hierarchy = cube(MPI.COMM_SELF, boundary="dirichlet")
    solver = PoissonSolver(hierarchy, backend=backend)
    for size, word in ((1e-312, "small"), (1e296, "large")):
        with pytest.raises(SolverError, match=f"which is too {word} for double precision to hold the potential"):
            solver.solve(amrpic.Field(hierarchy).fill(functools.partial(ramp, size)))


@pytest.mark.mpi(ranks=(1, 2))
@pytest.mark.parametrize("backend", BACKENDS)
def test_a_guess_of_another_order_of_magnitude_does_no_harm(comm, backend):
    hierarchy = cube(comm, boundary="dirichlet")
    solver = PoissonSolver(hierarchy, backend=backend, norm="l2")
    rho = amrpic.Field(hierarchy).fill(lambda x, y, z: 1e-200 * x * y)
    wanted, _ = solver.solve(rho)
    guess = amrpic.Field(hierarchy).fill(lambda x, y, z: 1e150 * np.sin(9 * x))
    phi, report = solver.solve(rho, guess=guess)
    assert report.converged and largest(phi) == pytest.approx(largest(wanted), rel=1e-9)

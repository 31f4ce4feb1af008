"""Potentials that little holds: long domains, long cells and weak screening between Neumann or periodic faces.

Right is what a sum in one dimension gives, or the mean of the charge over κ². In single precision, in which cycles correct,
such a potential was lost: the smoothest one is 1e5 to 1e14 times softer than one that oscillates from cell to cell.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from mpi4py import MPI
from scipy.constants import epsilon_0

import amrpic
from amrpic.stages.poisson import SolveReport

BACKENDS = ("matrix-free", "kokkos", "crs")
ALONG_Z = {"x": "periodic", "y": "neumann", "z": ("dirichlet", "neumann")}


def solved_along_z(density: np.ndarray, width: float) -> np.ndarray:
    """φ in cells of a width along z, constant across, between a grounded plate and a symmetry plane: the flux through each face
    is the charge beyond it, and that through the plate 3 φ₁ − φ₂/3 over the width, by the parabola."""
    flux = np.cumsum(density[::-1])[::-1] * width / epsilon_0  # through the lower face of each cell
    rises = flux[1:] * width
    first = (flux[0] * width + rises[0] / 3) / (8 / 3)
    return first + np.concatenate([[0.0], np.cumsum(rises)])


@pytest.mark.mpi(ranks=(1, 3))
@pytest.mark.parametrize("backend", BACKENDS)
@pytest.mark.parametrize(("cells", "length"), [((4, 4, 256), 1.024), ((4, 4, 64), 12.8), ((5, 6, 63), 1.3)])
def test_a_long_pipe_has_the_potential_of_one_dimension(comm, cells, length, backend):
    domain = amrpic.Domain((0, 0, 0), (0.2e-3 * cells[0], 0.2e-3 * cells[1], length), cells, ALONG_Z)
    hierarchy = amrpic.Hierarchy(comm, domain, max_grid_size=16, blocking_factor=2)
    rho = amrpic.Field(hierarchy).fill(lambda x, y, z: 1e-6 * (1 + 0.5 * np.sin(40 * z / length)) + 0 * (x + y))
    phi, report = amrpic.PoissonSolver(hierarchy, backend=backend).solve(rho)
    assert report.converged and report.cycles <= 8
    width = length / cells[2]
    centres = (np.arange(cells[2]) + 0.5) * width
    exact = solved_along_z(1e-6 * (1 + 0.5 * np.sin(40 * centres / length)), width)
    bound = max(1e-8, 30 * np.finfo(float).eps * (length / 0.2e-3) ** 2) * exact.max()
    for patch in phi.patches:
        lower, upper = patch.lower[2], patch.upper[2] + 1
        assert np.abs(patch.data - exact[lower:upper]).max() < bound


@pytest.mark.mpi(ranks=(1, 2))
@pytest.mark.parametrize("backend", BACKENDS)
@pytest.mark.parametrize("kappa_h", [1e-7, 1e-5, 1e-3, 0.1])
@pytest.mark.parametrize("refined", [False, True])
def test_weak_screening_holds_the_mean_and_the_rest_is_as_without(comm, refined, kappa_h, backend):
    """The mean is that of ρ over ε₀ κ²; a cosine is found to the error of the mesh, as far as φ has digits for it."""
    n, levels = 32, [[((16, 16, 16), (47, 47, 47))]]
    hierarchy = amrpic.Hierarchy(comm, amrpic.Domain(0, 1, n, "neumann"), levels if refined else [], blocking_factor=8)
    rho = amrpic.Field(hierarchy).fill(lambda x, y, z: epsilon_0 * (1 + np.cos(np.pi * x)) + 0 * (y + z))
    kappa = kappa_h * n
    phi, report = amrpic.PoissonSolver(hierarchy, screening=kappa, backend=backend).solve(rho)
    assert report.converged and report.cycles <= 9
    integral = phi.integral()
    assert integral * kappa**2 == pytest.approx(1, rel=1e-9)
    digits = 30 * np.finfo(float).eps / kappa**2
    for patch in phi.patches:
        x, _, _ = patch.centres()
        wave = patch.data - integral - np.cos(np.pi * x) / (np.pi**2 + kappa**2)
        assert np.abs(wave).max() < 3e-4 + digits


@pytest.mark.parametrize("backend", BACKENDS)
@pytest.mark.parametrize("levels", [[], [[((0, 0, 100), (3, 11, 199))]]])
def test_cycles_do_not_depend_on_how_weakly_screening_holds_the_mean(backend, levels):
    """κ² over the square of the longest wave's number, across those from which on cycles correct the mean; also from a guess
    with a mean, which is far from the answer."""
    cells = (2, 6, 149)
    domain = amrpic.Domain(0, cells, cells, "neumann")
    hierarchy = amrpic.Hierarchy(MPI.COMM_SELF, domain, levels, max_grid_size=24, blocking_factor=2)
    rho = amrpic.Field(hierarchy).fill(lambda x, y, z: epsilon_0 * ((x < 1) & (y > 3) & (abs(z - 57) < 36)))
    guess = amrpic.Field(hierarchy).fill(lambda x, y, z: 1e5 + 1e4 * (z > 30))

    def cycles(screening: float) -> np.ndarray:
        background = None if screening else "neutralizing"
        solver = amrpic.PoissonSolver(
            hierarchy, tolerance=1e-10, screening=screening, backend=backend, background=background
        )
        reports = [solver.solve(rho)[1], solver.solve(rho, guess=guess)[1]]
        assert all(report.converged for report in reports)
        return np.array([report.cycles for report in reports])

    without = cycles(0)
    for of_wave in (2e-11, 1e-10, 9e-10, 2e-9, 1e-8, 1e-6, 1e-4, 1e-2, 1):
        assert np.all(cycles(np.sqrt(of_wave) * np.pi / cells[2]) <= without + 1)


@pytest.mark.parametrize("backend", BACKENDS)
def test_screening_too_weak_for_double_precision_is_said_to_be(backend):
    """κ²h² of 1e-17: φ is 1e17 times the difference between two cells."""
    hierarchy = amrpic.Hierarchy(MPI.COMM_SELF, amrpic.Domain(0, 1, 16, "periodic"))
    rho = amrpic.Field(hierarchy).fill(lambda x, y, z: epsilon_0 * (1 + np.cos(2 * np.pi * x)) + 0 * (y + z))
    _, report = amrpic.PoissonSolver(hierarchy, screening=16 * 10**-8.5, backend=backend).solve(rho)
    assert not report.converged and report.floor > 10
    assert "too large for double precision" in report.reason and "stronger screening" in report.remedy


def test_advice_is_what_can_help():
    falls = SolveReport(False, 4, [1, 0.1, 0.01, 1e-3, 1e-4], {}, "no convergence in 4 cycles", 0.0)
    assert "max_cycles" in falls.remedy
    histories: list[list[float]] = [[1, 1e-3, 1e-4, 1e-4, 1e-4], [1, 1, 1, 1, 1], [1, 1e4, 1e8]]
    for stuck in histories:
        assert "raise solver.max_cycles" not in replace(falls, residuals=stuck).remedy
        assert "or solver.max_cycles" not in replace(falls, residuals=stuck).remedy


@pytest.mark.parametrize("backend", BACKENDS)
@pytest.mark.parametrize("closed", ["neumann", "periodic"])
def test_cells_of_one_to_a_thousand_between_closed_faces(closed, backend):
    domain = amrpic.Domain((0, 0, 0), (16, 15, 16000), (16, 15, 16), closed)
    hierarchy = amrpic.Hierarchy(MPI.COMM_SELF, domain)
    rho = amrpic.Field(hierarchy).fill(
        lambda x, y, z: epsilon_0 * np.cos(np.pi * z / 8000) * (1 + np.cos(np.pi * x / 8) * np.cos(2 * np.pi * y / 15))
    )
    phi, report = amrpic.PoissonSolver(hierarchy, backend=backend, background="neutralizing").solve(rho)
    assert report.converged and report.cycles <= 8
    wave = (2 * np.sin(np.pi / 16) / 1000) ** 2  # of what depends on z alone
    z = np.cos(np.pi * (np.arange(16) + 0.5) / 8)
    along = sum(np.array(p.data).sum(axis=(0, 1)) for p in phi.patches) / (16 * 15)
    assert np.abs(along - z / wave).max() < 1e-6 / wave


@pytest.mark.long
@pytest.mark.parametrize("backend", BACKENDS)
def test_two_cells_across_and_65536_along(backend):
    n = 65536
    domain = amrpic.Domain((0, 0, 0), (2, 2, n), (2, 2, n), ALONG_Z)
    hierarchy = amrpic.Hierarchy(MPI.COMM_SELF, domain, max_grid_size=256)
    rho = amrpic.Field(hierarchy).fill(
        lambda x, y, z: epsilon_0 * np.exp(-(((z - 30000) / 5000) ** 2)) * (1 + 0.5 * np.sin(3 * x + 5 * y))
    )
    phi, report = amrpic.PoissonSolver(hierarchy, backend=backend).solve(rho)
    assert report.converged and report.cycles <= 12
    centres = np.arange(n) + 0.5
    across = 1 + 0.5 * np.mean([np.sin(3 * x + 5 * y) for x in (0.5, 1.5) for y in (0.5, 1.5)])
    exact = solved_along_z(epsilon_0 * np.exp(-(((centres - 30000) / 5000) ** 2)) * across, 1.0)
    bound = 30 * np.finfo(float).eps * n**2 * exact.max()
    for patch in phi.patches:
        lower, upper = patch.lower[2], patch.upper[2] + 1
        assert np.abs(np.array(patch.data).mean(axis=(0, 1)) - exact[lower:upper]).max() < bound

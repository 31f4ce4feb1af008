"""The field of a moving bunch: `stretch` turns the solve into the one in the frame of the bunch."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from mpi4py import MPI

import amrpic
from amrpic.errors import SceneError, SolverError
from amrpic.scene.scene import Scene
from amrpic.stages.poisson import PoissonSolver
from amrpic.units import VACUUM_PERMITTIVITY
from static_case import Gaussian

GAMMA = 8.0
BUNCH = Gaussian((0.06,) * 3, (0.5, 0.5, 0.45))
REFINED = [[((8, 8, 4), (23, 23, 19))]]


def solved(comm, boundary: Any, gamma: float, slope: float = 0.0):
    """φ and E of the bunch at rest (gamma 1), or of the same bunch in motion along z, and how the solve went."""
    domain = amrpic.Domain((0, 0, 0), (1, 1, 1 / gamma), (16, 16, 16), boundary=boundary)
    hierarchy = amrpic.Hierarchy(comm, domain, REFINED, max_grid_size=16, blocking_factor=4)
    rho = amrpic.Field(hierarchy).fill(lambda x, y, z: gamma * BUNCH.density(x, y, gamma * z))
    solver = PoissonSolver(hierarchy, stretch=(1, 1, gamma), tolerance=1e-12)
    phi, report = solver.solve(
        rho,
        boundary_values=lambda x, y, z: gamma * (x + gamma * z),
        boundary_flux=lambda x, y, z: slope * gamma * np.where(abs(z * gamma - 1) < 1e-9, gamma, 1.0),
    )
    return phi, solver.electric_field(phi), report


@pytest.mark.mpi(ranks=(1, 2))
@pytest.mark.parametrize("boundary", ["open", {"x": "dirichlet", "y": "neumann", "z": ("dirichlet", "neumann")}])
def test_field_of_a_moving_bunch_is_the_lorentz_transform_of_that_at_rest(comm, boundary):
    """φ = γ φ', E⊥ = γ E'⊥, E∥ = E'∥, at places whose z is contracted: the same discrete problem, so to solver tolerance."""
    (phi, field, moving), (phi0, field0, rest) = (solved(comm, boundary, gamma, slope=0.5) for gamma in (GAMMA, 1.0))
    assert moving.converged and moving.cycles == rest.cycles
    for level in range(2):
        pairs = [(phi, phi0, GAMMA), *zip(field.components, field0.components, (GAMMA, GAMMA, 1), strict=True)]
        for seen, own, factor in pairs:
            largest = comm.allreduce(np.abs(own.array(level)).max(initial=0), op=MPI.MAX)
            assert np.allclose(seen.array(level), factor * own.array(level), rtol=0, atol=1e-8 * factor * largest)


def test_net_charge_of_a_stretched_problem_is_reported_in_coulombs(comm):
    domain = amrpic.Domain((0, 0, 0), (1, 1, 1), (16, 16, 16), boundary="periodic")
    hierarchy = amrpic.Hierarchy(comm, domain)
    rho = amrpic.Field(hierarchy).fill(lambda x, y, z: 2e-9 + 0 * (x + y + z))
    with pytest.raises(SolverError, match=r"is 2\.00e-09 C"):
        PoissonSolver(hierarchy, stretch=(1, 1, GAMMA)).solve(rho)


@pytest.mark.mpi(ranks=(1, 2))
@pytest.mark.parametrize("backend", ["matrix-free", "crs"])
def test_slopes_of_walls_balance_charge_by_their_flux_of_the_stretched_field(comm, backend):
    """E_d = -s_d⁻² ∂φ/∂x_d, so by Gauss Q + ε0 Σ slope A / s_d² = 0; what is missing is reported in coulombs."""
    stretch = np.array([1, 2, GAMMA])
    domain = amrpic.Domain((0, 0, 0), (1, 0.5, 0.25), (16, 16, 16), boundary="neumann")
    hierarchy = amrpic.Hierarchy(comm, domain, REFINED, max_grid_size=16, blocking_factor=4)
    areas, slopes = np.array([0.125, 0.25, 0.5]), np.array([30.0, -500.0, 7000.0])
    balance = -VACUUM_PERMITTIVITY * (slopes * areas / stretch**2).sum()
    solver = PoissonSolver(hierarchy, stretch=tuple(stretch), tolerance=1e-10, backend=backend)

    def slope(x, y, z):
        """On the upper faces of x and z, and the lower one of y."""
        return slopes[0] * (x == 1) + slopes[1] * (y == 0) + slopes[2] * (z == 0.25)

    for excess in (0.0, 2e-9):
        rho = amrpic.Field(hierarchy).fill(lambda x, y, z: 1 + 0 * (x + y + z))
        for level in range(2):
            rho.array(level)[:] = (balance + excess) / 0.125
        if excess:
            with pytest.raises(SolverError, match=r"the net charge \(with the flux through the walls\) is 2\.00e-09 C"):
                solver.solve(rho, boundary_flux=slope)
            continue
        phi, report = solver.solve(rho, boundary_flux=slope)
        assert report.converged
        # uniform charge and constant slopes: of each axis a parabola
        points = np.random.default_rng(1).uniform((0.2, 0.1, 0.05), (0.8, 0.4, 0.2), (20, 3))
        expected = (slopes / (1, 0.5, 0.25) * ((points - (0, 0.5, 0)) ** 2) / 2).sum(axis=1)
        found = phi.sample(points)
        assert found - found[0] == pytest.approx(expected - expected[0], abs=1e-2 * np.ptp(expected))


def test_meaningless_stretch_is_refused(comm):
    hierarchy = amrpic.Hierarchy(comm, amrpic.Domain((0, 0, 0), (1, 1, 1), (16, 16, 16)))
    with pytest.raises(SolverError, match="stretch"):
        PoissonSolver(hierarchy, stretch=(1, 0, 1))
    domain = {"lower": -1, "upper": 1, "cells": 16}
    for factor in (-2, 1e300):
        with pytest.raises(SceneError, match="stretch"):
            Scene.from_dict({"domain": domain, "solver": {"stretch": [1, 1, factor]}})
    with pytest.raises(SceneError, match=r"motion\.frame"):
        motion = {"kind": "leapfrog", "dt": 1e-9}
        Scene.from_dict({"domain": domain, "solver": {"stretch": [1, 1, 3]}, "motion": motion})

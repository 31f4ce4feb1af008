"""Solutions with electrodes equal those of an independent assembly, solved by a sparse direct method."""

from __future__ import annotations

import numpy as np
import pytest
from mpi4py import MPI
from scipy.constants import epsilon_0

import amrpic
from cut_rows import CutRows
from metal_cases import draw


def wall_potential(x, y, z):
    return np.cos(2 * x) * np.sin(y + 0.5) + 0.5 * z**2


def wall_slope(x, y, z):
    return np.sin(3 * x - y) + z


def largest(*arrays) -> float:
    return float(max(abs(array).max(initial=0) for array in arrays))


# what a wall of the domain does to arms beside it: metal behind it, metal before it, metal at the opposite arm
AT_WALLS = (27, 29, 32, 95, 99, 107, 152, 185)
SHORT = (*range(12), *AT_WALLS)


@pytest.mark.parametrize("seed", [*SHORT, *(pytest.param(n, marks=pytest.mark.long) for n in range(200, 400))])
def test_random_bodies_are_solved_as_by_a_direct_solve(seed):
    """Up to three electrodes, some floating; cells of any shape, walls of all kinds with data, noise as charge."""
    case = draw(seed)
    rows = CutRows(case.domain, case.electrodes, wall_potential, wall_slope, case.stretch)
    density = np.random.default_rng(seed).normal(size=case.domain.cells) * 5 * epsilon_0
    expected = rows.solve(density)
    hierarchy = case.hierarchy(MPI.COMM_SELF)
    solver = amrpic.PoissonSolver(hierarchy, tolerance=1e-11, electrodes=case.electrodes, stretch=case.stretch)
    rho = amrpic.Field(hierarchy)
    rho.patches[0].data[...] = density
    phi, report = solver.solve(rho, boundary_values=wall_potential, boundary_flux=wall_slope)
    assert report.converged, report.reason
    size = largest(expected.phi)
    assert largest(phi.patches[0].data - expected.phi) < 1e-8 * size
    names = [electrode.name for electrode in case.electrodes]
    assert [report.voltages[name] for name in names] == pytest.approx(expected.voltages, abs=1e-8 * size)
    charges = np.array([report.charges[name] for name in names])
    of_domain = epsilon_0 * size * float(min(case.domain.spacing * case.domain.cells))
    assert charges == pytest.approx(expected.charges(), abs=1e-7 * max(of_domain, largest(expected.charges())))
    efield = [component.patches[0].data for component in solver.electric_field(phi).components]
    of_rows = [expected.efield(axis) for axis in range(3)]
    outside = rows.fluid
    errors = [e[outside] - f[outside] for e, f in zip(efield, of_rows, strict=True)]
    assert largest(*errors) < 1e-7 * largest(*of_rows)
    # Gauss's law, by the rows' own fluxes
    inside = density.sum() * np.prod(rows.spacing)
    assert abs(charges.sum() + inside + expected.through_walls()) < 1e-7 * abs(density).sum() * np.prod(rows.spacing)

"""Problems with known answers, and how far a field is from them. Charge densities are in C/m^3, lengths in m."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from mpi4py import MPI
from scipy.special import erf

import amrpic
from amrpic.poisson import PoissonSolver

EPS0 = 8.8541878188e-12


@dataclass(frozen=True)
class Gaussian:
    """A round Gaussian charge in free space; charge over eps0 in V m."""

    sigma: float
    centre: tuple[float, float, float] = (0.5, 0.5, 0.5)
    charge: float = 1.0

    def _radius(self, *x: np.ndarray) -> np.ndarray:
        return np.sqrt(sum((a - c) ** 2 for a, c in zip(x, self.centre, strict=True))) + 1e-300

    def density(self, *x: np.ndarray) -> np.ndarray:
        s = self.sigma
        return EPS0 * self.charge * np.exp(-(self._radius(*x) ** 2) / (2 * s**2)) / (2 * np.pi * s**2) ** 1.5

    def potential(self, *x: np.ndarray) -> np.ndarray:
        r = self._radius(*x)
        return self.charge * erf(r / (np.sqrt(2) * self.sigma)) / (4 * np.pi * r)

    def field(self, axis: int, *x: np.ndarray) -> np.ndarray:
        r, s = self._radius(*x), self.sigma
        radial = erf(r / (np.sqrt(2) * s)) / r**2 - np.sqrt(2 / np.pi) / s * np.exp(-(r**2) / (2 * s**2)) / r
        return self.charge * radial / (4 * np.pi) * (x[axis] - self.centre[axis]) / r


STATIC = Gaussian(sigma=0.03)


def static_hierarchy(comm: MPI.Comm, n0: int, max_grid_size: int) -> amrpic.Hierarchy:
    """Case `static n0`: the unit cube, two nested cubes of n0^3 cells in its middle, Dirichlet walls."""
    domain = amrpic.Domain((0, 0, 0), (1, 1, 1), (n0, n0, n0), boundary="dirichlet")
    first = [((n0 // 2,) * 3, (3 * n0 // 2 - 1,) * 3)]
    second = [((3 * n0 // 2,) * 3, (5 * n0 // 2 - 1,) * 3)]
    return amrpic.Hierarchy(comm, domain, [first, second], max_grid_size=max_grid_size)


def solve_static(comm: MPI.Comm, n0: int, max_grid_size: int = 24, **options):
    """Solve case `static n0`: (solver, phi, report)."""
    hierarchy = static_hierarchy(comm, n0, max_grid_size)
    solver = PoissonSolver(hierarchy, **options)
    rho = amrpic.Field(hierarchy).fill(STATIC.density)
    phi, report = solver.solve(rho, boundary_values=STATIC.potential)
    return solver, phi, report


def errors(fields: Sequence[amrpic.Field], exact: Sequence) -> list[tuple[float, float]]:
    """Per level over uncovered cells: L2 error over the level's own L2 norm, and largest error over the largest exact value of
    all levels; several fields are the components of a vector."""
    hierarchy, comm = fields[0].hierarchy, fields[0].comm
    values = [amrpic.Field(hierarchy).fill(f) for f in exact]
    sums = np.zeros((hierarchy.levels, 2))
    largest = np.zeros((hierarchy.levels, 2))
    for i, patch in enumerate(fields[0].patches):
        use = ~patch.covered
        there = np.array([v.patches[i].data[use] for v in values])
        wrong = ((np.array([f.patches[i].data[use] for f in fields]) - there) ** 2).sum(axis=0)
        right = (there**2).sum(axis=0)
        sums[patch.level] += wrong.sum(), right.sum()
        top = wrong.max(initial=0.0), right.max(initial=0.0)
        largest[patch.level] = np.maximum(largest[patch.level], top)
    comm.Allreduce(MPI.IN_PLACE, sums, op=MPI.SUM)
    comm.Allreduce(MPI.IN_PLACE, largest, op=MPI.MAX)
    largest = np.sqrt(largest)
    return [
        (float(np.sqrt(sums[level, 0] / sums[level, 1])), float(largest[level, 0] / largest[:, 1].max()))
        for level in range(hierarchy.levels)
    ]


def observed_order(cells: Sequence[int], error: Sequence[float]) -> float:
    """Slope of the error over the cell width, by least squares."""
    return -float(np.polyfit(np.log(cells), np.log(error), 1)[0])

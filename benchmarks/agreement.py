"""Solve on the meshes of the verification by both backends and measure how far their potentials and residuals are apart.

Charge, and the potential whose residual both take, are rough, so that every row of every operator counts. A worker of
`bench`.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from functools import partial

import numpy as np
from mpi4py import MPI

import amrpic
from amrpic.stages.poisson import PoissonSolver, SolveReport
from cases import problem
from exact.meshes import MESHES, Mesh, around
from measuring import BACKENDS, Quick, Record, timed

TOLERANCE = 1e-11
BOUNDARIES = ("dirichlet", "neumann", "open")


def meshes(comm: MPI.Comm, quick: bool) -> Iterator[tuple[str, amrpic.Hierarchy]]:
    """Yield the meshes by name: those that order is measured on, each with each boundary, and those that are hard."""
    cells = 16 if quick else 32
    for (name, mesh), boundary in ((item, kind) for item in MESHES.items() for kind in BOUNDARIES):
        yield f"{name}, {boundary}", mesh.hierarchy(comm, cells, boundary, max_grid_size=16)
    mixed = {"x": "periodic", "y": ("dirichlet", "neumann"), "z": "dirichlet"}
    yield "L-shape, mixed", MESHES["L-shape"].hierarchy(comm, cells, mixed, max_grid_size=16)
    yield "ten levels", Mesh(around(10)).hierarchy(comm, 16, "dirichlet")
    yield "checkerboard", blocks(comm, lambda place: sum(place) % 2 == 0)
    yield "tunnels", blocks(comm, lambda place: list(place).count(3) >= 2)
    if not quick:
        for case in ("static 64", "bunch 64"):
            yield case, problem(comm, case, 24).hierarchy


def blocks(comm: MPI.Comm, chosen: Callable[[tuple[int, ...]], bool]) -> amrpic.Hierarchy:
    """The unit cube of 16³ cells, the chosen ones of 8³ blocks of 4³ fine cells refined. Collective."""
    places = [place for place in np.ndindex(8, 8, 8) if chosen(place)]
    boxes = [(tuple(4 * i for i in place), tuple(4 * i + 3 for i in place)) for place in places]
    domain = amrpic.Domain((0, 0, 0), (1, 1, 1), (16, 16, 16), boundary="dirichlet")
    return amrpic.Hierarchy(comm, domain, [boxes], max_grid_size=16, blocking_factor=4)


def rough(x: np.ndarray, y: np.ndarray, z: np.ndarray) -> np.ndarray:
    """A function without a scale of its own, the same whatever boxes and ranks there are."""
    return np.sin(1e3 * (x + 1.3 * y + 1.7 * z) ** 2)


def apart(comm: MPI.Comm, name: str, hierarchy: amrpic.Hierarchy) -> Record:
    """Return the record of a mesh: how far potentials are apart, over the largest, and residuals; cycles. Collective."""
    rho = amrpic.Field(hierarchy).fill(lambda *x: 1e-12 * rough(*x))
    guess = amrpic.Field(hierarchy).fill(lambda *x: rough(*x[::-1]))
    background = "neutralizing" if hierarchy.domain.singular else None
    found = {}
    for backend in BACKENDS:
        solver = PoissonSolver(hierarchy, tolerance=TOLERANCE, backend=backend, background=background)
        seconds, (phi, report) = timed(comm, 1, partial(solver.solve, rho))
        _, of_guess = solver.solve(rho, guess=guess)
        found[backend] = phi, report, seconds, of_guess.residuals[0]
    (phi, _, seconds, residual), *others = found.values()
    difference = residuals = 0.0
    for other, _, _, others_residual in others:
        residuals = max(residuals, abs(others_residual / residual - 1))
        worst = max(float(np.abs(phi.array(l) - other.array(l)).max(initial=0.0)) for l in range(hierarchy.levels))
        difference = max(difference, comm.allreduce(worst, op=MPI.MAX) / phi.max_abs())
    facts = {
        "difference": difference,
        "residuals apart": residuals,
        "backends": list(found),
        "cycles of each": [cycles_of(report) for _, report, _, _ in found.values()],
        "converged": all(report.converged for _, report, _, _ in found.values()),
    }
    cells = sum(hierarchy.cells(level) for level in range(hierarchy.levels))
    return Record(f"agreement, {name}", seconds, cells=cells, facts=facts)


def cycles_of(report: SolveReport) -> int:
    """Cycles to the tolerance, or to within ten times of what rounding leaves: how many come after that is chance."""
    enough = max(TOLERANCE, 10 * report.floor)
    return next((n for n, residual in enumerate(report.residuals) if residual <= enough), report.cycles)


def run(quick: Quick = False) -> Iterator[Record]:
    """All meshes. Collective."""
    comm = MPI.COMM_WORLD
    return (apart(comm, name, hierarchy) for name, hierarchy in meshes(comm, quick))

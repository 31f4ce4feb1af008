# mypy: disable-error-code="arg-type, union-attr"
"""Electrodes on every execution: residual, potential, charges and cycles are those of the matrix-free backend."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import pytest
from mpi4py import MPI

from amrpic import Domain, Electrode, Field, Hierarchy, PoissonSolver, shapes
from rank_subsets import first_ranks, wait_quietly

N = 16
H = 2 / N
FACES = {"x": ("dirichlet", "neumann"), "y": "periodic", "z": "dirichlet"}
OTHERS = ["kokkos", pytest.param("crs", marks=pytest.mark.long)]


def ball(x, y, z, radius, **drive):
    return Electrode(
        "free" if "charge" in drive else "ball", shapes.Sphere((x, y, z), radius), **(drive or {"voltage": 1})
    )


def wires():
    """Wires of a quarter of a cell, which a refined level alone sees."""
    out: shapes.Shape = shapes.Cylinder((-0.7, -3, 0.03), (-0.7, 3, 0.03), 0.27 * H)
    for place in (-0.2, 0.3, 0.8):
        out = out | shapes.Cylinder((place, -3, 0.03), (place, 3, 0.03), 0.27 * H)
    return [Electrode("wires", out, voltage=1)]


@dataclass(frozen=True)
class Case:
    levels: tuple = ()
    electrodes: tuple = ()
    boundary: Any = "dirichlet"
    upper: Any = 1.0

    def mesh(self, comm=MPI.COMM_SELF, size=8) -> Hierarchy:
        return Hierarchy(comm, Domain(-1, self.upper, N, self.boundary), list(self.levels), size, 4)


CORNER = ([((16, 16, 16), (27, 27, 27))],)
DEEP = ([((8, 8, 8), (23, 23, 23))], [((24, 24, 20), (39, 39, 35))])
FOIL = (Electrode("foil", shapes.Disk((0.07, 0.03, 0.04), (1, 2, 9), 5.0), voltage=1),)
PAIR = (ball(-0.4, 0.03, 0.02, 0.3), ball(0.4, 0.03, 0.02, 0.3, charge=1e-12))
CASES = {
    "one level": Case((), PAIR, FACES),
    "on a corner of a refined box": Case(CORNER, (ball(0.013, -0.021, 0.008, 0.45),), FACES),
    "a foil through three levels": Case(DEEP, FOIL),
    "three levels between walls without flux": Case(DEEP, PAIR, {"x": "neumann", "y": "periodic", "z": "neumann"}),
    "between open faces": Case(CORNER, (ball(0.013, -0.021, 0.008, 0.45),), "open"),
    "long cells": Case(CORNER, (ball(0.013, -0.021, 0.1, 0.6),), FACES, (1.0, 1.0, 7.0)),
    "wires that a refined level alone sees": Case(([((0, 0, 8), (31, 31, 23))],), tuple(wires())),
}


def charge(x, y, z):
    return 1e-10 * np.sin(91 * x + 53 * y + 77 * z + 1)


def noise(x, y, z):
    return 0.3 * np.sin(71 * x - 43 * y + 37 * z)


def solver_of(mesh: Hierarchy, case: Case, backend: str, **options) -> PoissonSolver:
    return PoissonSolver(mesh, electrodes=case.electrodes, backend=backend, **options)


def solved(mesh: Hierarchy, case: Case, backend: str, **options):
    walls = {"boundary_values": lambda x, y, z: x + z} if "dirichlet" in str(case.boundary) else {}
    return solver_of(mesh, case, backend, **options).solve(Field(mesh).fill(charge), **walls)


def values(field: Field) -> list[np.ndarray]:
    return [field.array(level).copy() for level in range(field.hierarchy.levels)]


@pytest.mark.parametrize("backend", OTHERS)
@pytest.mark.parametrize("name", CASES)
def test_residual_potential_charges_and_cycles_are_those_of_the_matrix_free_backend(name, backend):
    case = CASES[name]
    mesh = case.mesh()
    first, second = (
        solver_of(mesh, case, which).solve(Field(mesh).fill(charge), guess=Field(mesh).fill(noise))[1].residuals[0]
        for which in ("matrix-free", backend)
    )
    assert second == pytest.approx(first, rel=1e-12)
    (phi, report), (other, said) = (solved(mesh, case, which, tolerance=1e-13) for which in ("matrix-free", backend))
    size = max(abs(level).max() for level in values(phi))
    for ours, theirs in zip(values(phi), values(other), strict=True):
        assert theirs == pytest.approx(ours, abs=(1e-11 if "flux" in name else 1e-12) * size)  # of residuals of 1e-13
    # each cycle leaves as much: none reads what sweeps leave in metal
    assert np.log10(said.residuals[1:4]) == pytest.approx(np.log10(report.residuals[1:4]), abs=0.15)
    cycles, others = (int(np.argmax(np.array(of.residuals) < 1e-10)) for of in (report, said))
    # the bottoms take open faces differently
    assert abs(others - cycles) <= (backend == "crs" and case.boundary == "open")
    largest = max(map(abs, report.charges.values()))
    assert list(said.charges.values()) == pytest.approx(list(report.charges.values()), abs=1e-11 * largest)


@pytest.mark.long
@pytest.mark.mpi(ranks=4, timeout=180)
@pytest.mark.parametrize("backend", OTHERS)
@pytest.mark.parametrize("name", ["on a corner of a refined box", "a foil through three levels"])
def test_ranks_change_the_last_digits_at_most(comm, name, backend):
    for ranks in (1, 2, 3, 4):
        part = first_ranks(ranks)
        if part:
            mesh = CASES[name].mesh(part)
            (phi, report), (other, said) = (
                solved(mesh, CASES[name], which, tolerance=1e-13) for which in ("matrix-free", backend)
            )
            size = part.allreduce(max(abs(level).max(initial=0) for level in values(phi)), MPI.MAX)
            for ours, theirs in zip(values(phi), values(other), strict=True):
                assert theirs == pytest.approx(
                    ours, abs=(1e-11 if "flux" in name else 1e-12) * size
                )  # of residuals of 1e-13
            assert said.cycles == report.cycles
        wait_quietly(comm)

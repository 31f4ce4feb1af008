"""The matrix-free backend finds what compressed rows find, in as many cycles, on any decomposition."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from mpi4py import MPI

import amrpic
from amrpic import PoissonSolver, Scene
from amrpic.errors import SceneError, SolverError
from amrpic.verify.meshes import MESHES

BOUNDARIES: dict[str, Any] = {
    "open": "open",
    "dirichlet": "dirichlet",
    "periodic": "periodic",
    "neumann": "neumann",
    "periodic along x alone": {"x": "periodic", "y": ("dirichlet", "neumann"), "z": "dirichlet"},
    "periodic along z alone": {"x": "neumann", "y": ("open", "dirichlet"), "z": "periodic"},
    "open beside walls": {"x": "dirichlet", "y": ("open", "open"), "z": "neumann"},
}
REFUSED = {key for key, spec in BOUNDARIES.items() if "open" in str(spec) and "periodic" in str(spec)}


def solved(hierarchy: amrpic.Hierarchy, **options) -> tuple[amrpic.Field, amrpic.SolveReport]:
    """Charge off the centre. Collective."""
    size = np.array(hierarchy.domain.upper) - hierarchy.domain.lower
    rho = amrpic.Field(hierarchy).fill(
        lambda x, y, z: (
            1e-9 * np.exp(-((x / size[0] - 0.4) ** 2 + (y / size[1] - 0.55) ** 2 + (z / size[2] - 0.5) ** 2) / 0.02)
        )
    )
    solver = PoissonSolver(hierarchy, background="neutralizing", max_cycles=40, **options)
    phi, report = solver.solve(rho)
    assert report.converged, report.reason
    return phi, report


def apart(phi: amrpic.Field, other: amrpic.Field) -> float:
    """Largest difference over the largest value. Collective."""
    worst = max((np.abs(a.data - b.data).max() for a, b in zip(phi.patches, other.patches, strict=True)), default=0.0)
    return phi.comm.allreduce(float(worst), op=MPI.MAX) / other.max_abs()


def rounding(name: str) -> float:
    """How far single precision lets residuals differ on the way: it shows first in the smallest cells and in long ones."""
    return {"six levels off centre": 0.1, "cells 1:1:10": 3e-3}.get(name, 1e-3)


@pytest.mark.mpi(ranks=(1, 3), timeout=300)
@pytest.mark.parametrize("boundary", sorted(set(BOUNDARIES) - REFUSED))
def test_both_backends_find_the_same_potential_in_as_many_cycles(comm, boundary):
    for name, mesh in MESHES.items():
        if mesh.size != (1.0, 1.0, 1.0) and boundary == "open":
            continue  # lattice sums of long cells take minutes; the other boundaries have them
        hierarchy = mesh.hierarchy(comm, 16, BOUNDARIES[boundary], max_grid_size=16)
        phi, report = solved(hierarchy)
        expected, crs = solved(hierarchy, backend="crs")
        assert apart(phi, expected) < 1e-8, name
        assert report.cycles <= crs.cycles + 1, (name, report.cycles, crs.cycles)


@pytest.mark.mpi(ranks=4, timeout=300)
@pytest.mark.parametrize("name", ["uniform", "L-shape", "six levels off centre", "cells 1:1:10"])
def test_cycles_depend_neither_on_ranks_nor_on_boxes(comm, name):
    for boundary in ("dirichlet", "periodic"):
        alone, report = solved(MESHES[name].hierarchy(MPI.COMM_SELF, 16, boundary, max_grid_size=32))
        for size in (8, 16):
            phi, found = solved(MESHES[name].hierarchy(comm, 16, boundary, max_grid_size=size))
            assert found.cycles == report.cycles
            assert found.residuals[1:4] == pytest.approx(report.residuals[1:4], rel=rounding(name))
            points = np.random.default_rng(3).uniform(0.05, 0.95, (50, 3)) * MESHES[name].size
            assert phi.sample(points) == pytest.approx(alone.sample(points), abs=1e-8 * alone.max_abs())


@pytest.mark.mpi(ranks=(1, 2), timeout=300)
@pytest.mark.parametrize("name", sorted(MESHES))
def test_tuned_and_portable_kernels_give_the_same_answer(comm, name):
    for boundary in ("dirichlet", "periodic"):
        hierarchy = MESHES[name].hierarchy(comm, 16, boundary, max_grid_size=8)
        phi, report = solved(hierarchy)
        expected, portable = solved(hierarchy, kernels="portable")
        assert report.cycles == portable.cycles
        assert report.residuals[1:3] == pytest.approx(portable.residuals[1:3], rel=rounding(name))
        assert apart(phi, expected) < 1e-8


@pytest.mark.parametrize("cells", [(8, 8, 8), (10, 14, 22), (8, 8, 128), (50, 4, 6)])
def test_bases_without_many_factors_of_two_are_solved(cells):
    """The coarsest level is solved exactly, whatever its numbers of cells."""
    for boundary in ("dirichlet", "periodic", "neumann", "open"):
        domain = amrpic.Domain((0, 0, 0), tuple(n / 8 for n in cells), cells, boundary)
        hierarchy = amrpic.Hierarchy(MPI.COMM_SELF, domain, max_grid_size=32, blocking_factor=2)
        phi, report = solved(hierarchy)
        assert report.cycles <= 9, (boundary, report.cycles)
        assert apart(phi, solved(hierarchy, backend="crs")[0]) < 1e-8


def test_density_contrast_and_units_leave_single_precision_no_gap():
    """Corrections are of the order of one in any units; far from the charge they may vanish."""
    for size, charge in ((1e-9, 1e-30), (1e6, 1e3)):
        domain = amrpic.Domain((0, 0, 0), (size,) * 3, (32,) * 3, "dirichlet")
        hierarchy = amrpic.Hierarchy(MPI.COMM_SELF, domain, [[((0, 0, 0), (15, 15, 15))]], max_grid_size=16)
        rho = amrpic.Field(hierarchy).fill(lambda x, y, z: np.where(x + y + z < size, 1.0, 1e-12))  # noqa: B023
        for level in range(hierarchy.levels):
            rho.array(level)[:] *= charge / size**3
        phi, report = PoissonSolver(hierarchy).solve(rho)
        assert report.converged and report.cycles <= 8
        expected, _ = PoissonSolver(hierarchy, backend="crs").solve(rho)
        assert apart(phi, expected) < 1e-8


@pytest.mark.parametrize(
    ("option", "value"),
    [
        ("smoother", "chebyshev"),
        ("prolongation", "constant"),
        ("coarse_levels", 1),
        ("bottom", "direct"),
        ("bottom_preconditioner", "ilu"),
        ("krylov", "fgmres"),
    ],
)
def test_choices_of_compressed_rows_are_refused_with_the_remedy(option, value):
    remedy = 'choice of the backend of compressed rows alone; leave it out, or set backend to "crs"'
    hierarchy = amrpic.Hierarchy(MPI.COMM_SELF, amrpic.Domain((0, 0, 0), (1, 1, 1), (8, 8, 8)))
    with pytest.raises(SolverError, match=f"{option} is {value!r}, which is a {remedy}"):
        PoissonSolver(hierarchy, **{option: value})
    with pytest.raises(SceneError, match=rf"solver.{option} \({value!r}\) is a {remedy}"):
        Scene.from_dict({"domain": {"lower": 0, "upper": 1, "cells": 8}, "solver": {option: value}})

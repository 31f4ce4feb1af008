"""The matrix-free backend finds what compressed rows find, in as many cycles, on any decomposition."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from mpi4py import MPI

import amrpic
from amrpic import PoissonSolver, Scene
from amrpic.errors import SceneError, SolverError
from exact.meshes import MESHES

BOUNDARIES: dict[str, Any] = {
    "open": "open",
    "dirichlet": "dirichlet",
    "periodic": "periodic",
    "neumann": "neumann",
    "periodic along x alone": {"x": "periodic", "y": ("dirichlet", "neumann"), "z": "dirichlet"},
    "periodic along z alone": {"x": "neumann", "y": ("open", "dirichlet"), "z": "periodic"},
    "open beside walls": {"x": "dirichlet", "y": ("open", "open"), "z": "neumann"},
}


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
@pytest.mark.parametrize("boundary", sorted(BOUNDARIES))
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


def compare_with_kokkos(hierarchy: amrpic.Hierarchy, name: str, **options) -> None:
    """Kernels over whole levels take the same steps as the tuned loops. Collective."""
    expected, tuned = solved(hierarchy, backend="matrix-free", **options)
    phi, report = solved(hierarchy, backend="kokkos", **options)
    assert report.cycles == tuned.cycles, name
    assert report.residuals[0] == pytest.approx(tuned.residuals[0], rel=1e-12), name
    assert report.residuals[1:3] == pytest.approx(tuned.residuals[1:3], rel=rounding(name), abs=6e-8), name
    assert apart(phi, expected) < 1e-8, name


@pytest.mark.mpi(ranks=(1, 2, 3, 4), timeout=300)
@pytest.mark.parametrize("boundary", sorted(BOUNDARIES))
def test_kokkos_kernels_take_the_same_steps(comm, boundary):
    for name, mesh in MESHES.items():
        if mesh.size != (1.0, 1.0, 1.0) and boundary == "open":
            continue  # as above
        compare_with_kokkos(mesh.hierarchy(comm, 16, BOUNDARIES[boundary], max_grid_size=8), name)


@pytest.mark.mpi(ranks=(1, 2))
@pytest.mark.parametrize(
    "options", [{"norm": "l1"}, {"norm": "l2"}, {"tolerance": "discretization"}, {"screening": 3.0}, {"sweeps": (1, 0)}]
)
def test_kokkos_kernels_take_the_same_steps_with_options(comm, options):
    compare_with_kokkos(MESHES["L-shape"].hierarchy(comm, 16, "dirichlet", max_grid_size=16), "L-shape", **options)


@pytest.mark.mpi(ranks=(1, 2))
def test_kokkos_kernels_take_the_same_steps_around_narrow_gaps(comm):
    places = [place for place in np.ndindex(8, 8, 8) if sum(place) % 2 == 0]
    boxes = [(tuple(4 * i for i in place), tuple(4 * i + 3 for i in place)) for place in places]
    for boundary in ("dirichlet", "periodic"):
        domain = amrpic.Domain((0, 0, 0), (1, 1, 1), (16, 16, 16), boundary)
        compare_with_kokkos(amrpic.Hierarchy(comm, domain, [boxes], max_grid_size=16, blocking_factor=4), boundary)


def test_kokkos_kernels_combine_corrections_where_cycles_are_slow():
    domain = amrpic.Domain((0, 0, 0), (1, 1, 40), (16, 16, 16), "dirichlet")
    hierarchy = amrpic.Hierarchy(MPI.COMM_SELF, domain, [[((8, 8, 8), (15, 15, 15))]], max_grid_size=16)
    compare_with_kokkos(hierarchy, "cells 1:1:40")


def test_kokkos_kernels_refuse_order_4():
    domain = amrpic.Domain((0, 0, 0), (1, 1, 1), (16, 16, 16), "dirichlet")
    with pytest.raises(SolverError, match="order"):
        PoissonSolver(amrpic.Hierarchy(MPI.COMM_SELF, domain), backend="kokkos", order=4)


@pytest.mark.mpi(ranks=(1, 2))
@pytest.mark.parametrize("cells", [(10, 14, 22), (50, 4, 6), (36, 12, 20)])
def test_kokkos_kernels_coarsen_odd_numbers_of_cells(comm, cells):
    for boundary in ("dirichlet", "periodic", "neumann"):
        domain = amrpic.Domain((0, 0, 0), tuple(n / 8 for n in cells), cells, boundary)
        compare_with_kokkos(amrpic.Hierarchy(comm, domain, max_grid_size=16, blocking_factor=2), boundary)


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

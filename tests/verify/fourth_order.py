"""Order 4 between all kinds of walls: orders on all meshes, and what it is worth beside order 2."""

from __future__ import annotations

import time
from collections.abc import Iterator

import numpy as np
from mpi4py import MPI

from amrpic.mesh.domain import BoundarySpec, Domain
from amrpic.mesh.field import Field
from amrpic.mesh.hierarchy import Hierarchy
from amrpic.stages.poisson import PoissonSolver
from amrpic.verify.pareto import ASKED_FROM, orders_against_seconds
from amrpic.verify.table import Cell, Goal, Table
from exact import amrex
from exact.errors import errors, observed_order
from exact.meshes import MESHES, Mesh
from exact.sources import Gaussian, Product, Source, Wave, fill

from .convergence import outward_slope, smooth
from .curves import Curves

COLUMNS = (
    *("mesh", "φ, L2", "φ, max", "E, L2", "E, max", "order: φ, L2", "order: φ, max", "order: E, L2", "order: E, max"),
    "cycles",
)
WALLS: tuple[BoundarySpec, ...] = ("open", "neumann", "dirichlet", "periodic")
TURN = 2 * np.pi
WIDTHS = (2, 3, 4, 6, 8)  # σ/h
CELLS = (32, 48, 64, 80, 96)  # of the base, for errors against seconds
LARGEST_ON_STATIC = {64: 2e-5, 128: 2e-6}  # error of E, L2, by base cells


def tables(comm: MPI.Comm) -> Iterator[Table]:
    """The tables of this topic. Collective."""
    for walls in WALLS:
        yield _on_all_meshes(comm, walls)
    yield _on_static(comm)
    yield _over_width(comm)
    yield _over_seconds(comm)


def _on_all_meshes(comm: MPI.Comm, walls: BoundarySpec) -> Table:
    largest = 2.8 if walls == "dirichlet" else 3.5
    rows: list[list[Cell]] = []
    for name, mesh in MESHES.items():
        cells = (32, 48) if len(mesh.levels) > 2 or mesh.size[2] > 1 else (64, 96)
        found = [solve(mesh.hierarchy(comm, n, walls), source_on(name, mesh, walls)) for n in cells]
        error = np.array([row for row, _, _ in found])
        order = [observed_order(cells, error[:, c].tolist()) for c in range(4)]
        goals = [Goal(o, bound, least=True) for o, bound in zip(order[1:], (3.7, 3.7, largest), strict=True)]
        cycles = Goal(max(taken for _, taken, _ in found), 17 if walls == "dirichlet" else 13)
        rows.append([name, *map(float, error[-1]), order[0], *goals, cycles])
    charge = "a Gaussian, on coarse-fine faces of most meshes" if walls == "open" else "waves"
    return Table(
        f"Order 4, {walls} walls",
        f"The source is {charge}. Means are given for the density; errors, relative, are those of values at the centres, on "
        "the finer of two meshes 1.5 times apart."
        + (" In the cells at the edges between these walls E is of third order." if walls == "dirichlet" else ""),
        COLUMNS,
        rows,
    )


def source_on(name: str, mesh: Mesh, walls: BoundarySpec) -> Source:
    """What is solved on a mesh of that name, smooth on it."""
    if walls == "periodic":
        x, y, z = mesh.size
        return Product((Wave(TURN / x, 0.3), Wave(TURN / y, 1.0), Wave(2 * TURN / z, 0.2)))
    if walls != "open":
        return smooth(mesh.size)
    beside = {"face": (0.48, 0.5, 0.5), "edge": (0.42, 0.42, 0.5), "corner": (0.42, 0.42, 0.42)}
    centre = beside.get(name.rsplit(" ", 1)[-1], (0.5, 0.5, 0.5))
    return Gaussian(tuple(0.068 * np.array(mesh.size)), tuple(np.array(centre) * mesh.size))


def _on_static(comm: MPI.Comm) -> Table:
    """The case `static` of the comparison with AMReX."""
    rows: list[list[Cell]] = []
    for cells, largest in LARGEST_ON_STATIC.items():
        for walls in ("dirichlet", "open"):
            mesh = amrex.static(comm, cells, walls=walls)
            (second, _, _), (fourth, cycles, _) = (solve(mesh, amrex.static_source(), order, 1) for order in (2, 4))
            most = Goal(cycles, 17 if walls == "dirichlet" else 13)
            rows.append([f"static {cells}", walls, second[2], *fourth[:2], Goal(fourth[2], largest), fourth[3], most])
    return Table(
        "Order 4 on static 64 and 128",
        "One Gaussian in two nested cubes, as beside AMReX, given as means in order 4, as points in order 2; relative errors "
        "of values at the centres.",
        ("case", "walls", "E, L2, order 2", "φ, L2", "φ, max", "E, L2", "E, max", "cycles"),
        rows,
    )


def solve(hierarchy: Hierarchy, source: Source, order: int = 4, times: int = 3) -> tuple[list[float], int, float]:
    """Errors of φ (L2, max) and E (L2, max) at centres, cycles, and seconds of the best of some solves. Collective."""
    comm, singular = hierarchy.comm, hierarchy.domain.singular
    solver = PoissonSolver(hierarchy, order=order, background="neutralizing" if singular else None)
    rho, seconds = fill(Field(hierarchy), source), np.inf
    rho.holds = "means"
    if order == 2:
        rho = rho.as_points()  # its error is smaller by a third than of means
    slope = outward_slope(hierarchy, source)
    for _ in range(times):
        comm.Barrier()
        start = time.perf_counter()
        phi, report = solver.solve(rho, boundary_values=source.potential, boundary_flux=slope)
        seconds = min(seconds, comm.allreduce(time.perf_counter() - start, op=MPI.MAX))
    efield = solver.electric_field(phi)
    found = errors([phi.as_points() if order == 4 else phi], source.potential, shift=singular)
    return [*found, *errors(efield.components, source.field)], report.cycles if report.converged else -1, seconds


def _over_width(comm: MPI.Comm) -> Table:
    """A round Gaussian in free space, on uniform cubes, eight σ from the walls."""
    curves, rows = {}, []
    found: dict[int, list[float]] = {2: [], 4: []}
    for order, of_order in found.items():
        for width in WIDTHS:
            cells = 16 * width
            domain = Domain(lower=0.0, upper=1.0, cells=cells, boundary="open")
            source = Gaussian((width / cells,) * 3, (0.5, 0.5, 0.5))
            of_order.append(solve(Hierarchy(comm, domain, max_grid_size=32), source, order)[0][2])
        curves[f"order {order}"] = list(WIDTHS), of_order
    for width, second, fourth in zip(WIDTHS, found[2], found[4], strict=True):
        rows.append([width, second, fourth, second / fourth])
    return Curves(
        "Order 4 and order 2 against σ/h",
        "Relative error of E (L2) of a round Gaussian in free space, on uniform cubes; given as means in order 4, as points in "
        "order 2.",
        ("σ/h", "order 2", "order 4", "ratio"),
        rows,
        curves=curves,
        across="σ/h",
        upwards="relative error of E, L2",
    )


def _over_seconds(comm: MPI.Comm) -> Table:
    """Both orders on nested cubes, solved to 1e-10."""
    source = Gaussian((0.07,) * 3, (0.5, 0.5, 0.5))
    curves: dict[int, dict[str, tuple[float, float]]] = {2: {}, 4: {}}
    for order, of_order in curves.items():
        for cells in CELLS:
            error, _, seconds = solve(MESHES["nested cubes"].hierarchy(comm, cells, "open"), source, order)
            of_order[str(cells)] = seconds, error[2]
    return orders_against_seconds(
        "Order 4 and order 2 against seconds",
        "A round Gaussian on nested cubes in free space, given as means in order 4, as points in order 2, solved to 1e-10 from "
        "zero, best of three; relative error of E (L2).",
        curves,
        CELLS.index(ASKED_FROM),
    )

"""Orders of φ and E: on meshes of every kind, for faces of every kind, for charge of every kind."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np
from mpi4py import MPI

from amrpic.mesh.domain import BoundarySpec
from amrpic.mesh.field import Field, Function
from amrpic.mesh.hierarchy import Hierarchy
from amrpic.stages.poisson import PoissonSolver
from amrpic.verify.table import Cell, Goal, Table
from exact.errors import errors, observed_order
from exact.meshes import MESHES, Mesh
from exact.sources import EPS0, Gaussian, Layer, Plummer, Product, Source, Sphere, Together, Wave, fill

from .curves import Curves

CELLS = (16, 24, 32, 48)
CYCLES = 12  # to 1e-10, whatever the mesh
COLUMNS = ("", "φ L2", "φ max", "E L2", "E max", "order φ L2", "order φ max", "order E L2", "order E max", "cycles")


@dataclass(frozen=True)
class Case:
    """A source on a mesh between walls, and the orders that theory gives φ max, E L2 and E max; None: it gives none."""

    mesh: Mesh
    source: Source
    boundary: BoundarySpec = "dirichlet"
    cells: tuple[int, ...] = CELLS
    orders: tuple[float | None, float | None, float | None] = (1.9, 1.9, 0.95)


def tables(comm: MPI.Comm, resolutions: int | None = None) -> Iterator[Table]:
    """The tables of this topic, one after the other; or of the given number of coarsest resolutions. Collective."""
    yield _table(
        comm,
        "Meshes",
        "A smooth manufactured potential between Dirichlet walls. φ is second order in the max norm, E in L2; at coarse-fine "
        "faces E is first order at least.",
        {name: Case(mesh, smooth(mesh.size)) for name, mesh in MESHES.items()},
        resolutions,
    )
    yield _table(
        comm,
        "Faces",
        "Manufactured potentials on two nested cubes: smooth, of high frequency, with a boundary layer.",
        dict(_faces()),
        resolutions,
    )
    yield _table(
        comm,
        "Charge",
        "Sources in free space, with the exact potential on the faces, so that the order is that of the mesh alone: what open "
        "faces add, which falls with their own accuracy, has tables of its own. Two nested cubes, or one with its face or "
        "corner in the middle of the charge. No order is known for the max norm of a sphere, whose density jumps.",
        dict(_charge()),
        resolutions,
    )


def smooth(size: tuple[float, float, float]) -> Product:
    """A manufactured potential of about one wave across a domain of this size."""
    kx, ky, kz = (k / length for k, length in zip((4.0, 5.0, 4.0), size, strict=True))
    return Product((Wave(kx, 0.3), Wave(ky, -0.4), Wave(kz, 0.2)))


def _faces() -> Iterator[tuple[str, Case]]:
    nested, turn = MESHES["nested cubes"], 2 * np.pi
    one_wave = smooth((1, 1, 1))
    periodic = Product((Wave(turn, 0.3), Wave(turn, 1.0), Wave(2 * turn, 0.2)))
    quick = Product((Wave(3.5 * turn, 0.3), Wave(3 * turn, 0.1), Wave(2.5 * turn, 0.7)))
    layer = Product((Layer(0.1), Wave(3.0, 0.2), Layer(0.15)))
    one_axis = {"x": "periodic", "y": ("dirichlet", "neumann"), "z": "dirichlet"}
    mixed = {"x": ("dirichlet", "neumann"), "y": "neumann", "z": ("neumann", "dirichlet")}
    fine = (32, 48, 64, 80)  # where the waves are resolved
    yield "smooth, Neumann", Case(nested, one_wave, "neumann")
    yield "smooth, Dirichlet and Neumann", Case(nested, one_wave, mixed)
    yield "smooth, periodic", Case(nested, periodic, "periodic")
    yield "smooth, periodic along x", Case(nested, Product((Wave(turn, 0.3), Wave(4.0, 0.1), Wave(5.0))), one_axis)
    yield "high frequency, Dirichlet", Case(nested, quick, "dirichlet", fine)
    yield "boundary layer, Dirichlet", Case(nested, layer, "dirichlet", fine)
    yield "boundary layer, Dirichlet and Neumann", Case(nested, layer, mixed, fine)


def _charge() -> Iterator[tuple[str, Case]]:
    nested, middle = MESHES["nested cubes"], (0.5, 0.5, 0.5)
    on_face = Mesh(MESHES["nested cubes"].levels[:1])
    pair = Together((Gaussian((0.07,) * 3, (0.42, 0.5, 0.5)), Gaussian((0.07,) * 3, (0.58, 0.5, 0.5), -EPS0)))
    train = Together(tuple(Gaussian((0.05,) * 3, (at, at, 0.5)) for at in (0.2, 0.4, 0.6, 0.8)))
    # The max norm is late to show its order: from 32 to 48 base cells the pair's is 1.83, from 96 to 128 it is 1.95.
    fine = (48, 64, 80, 96)
    for name, mesh, source in (
        ("sphere", nested, Sphere(0.2, middle)),
        ("Gaussian", nested, Gaussian((0.06,) * 3, middle)),
        ("ellipsoidal Gaussian", nested, Gaussian((0.05, 0.07, 0.11), middle)),
        ("Plummer sphere", nested, Plummer(0.08, middle)),
        ("neutral pair", nested, pair),
        ("train of four", Mesh(((((1, 1, 3), (7, 7, 5)),),)), train),
        ("Gaussian on a coarse-fine face", on_face, Gaussian((0.08,) * 3, (0.25, 0.5, 0.5))),
        ("Gaussian on a coarse-fine corner", on_face, Gaussian((0.08,) * 3, (0.25, 0.25, 0.25))),
    ):
        orders = (None, 1.4, None) if name == "sphere" else (1.9, 1.9, 0.95)
        yield name, Case(mesh, source, "dirichlet", fine, orders)


def _table(comm: MPI.Comm, title: str, about: str, cases: dict[str, Case], resolutions: int | None = None) -> Table:
    rows, curves = [], {}
    for name, whole in cases.items():
        case = replace(whole, cells=whole.cells[:resolutions])
        error, cycles = _measured(comm, case)
        rows.append([name, *_row(case, error), Goal(cycles, CYCLES)])
        curves[name] = list(case.cells), error[:, 2].tolist()
    return Curves(
        title,
        f"{about} Errors are those of the finest mesh, relative.",
        COLUMNS,
        rows,
        curves=curves,
        upwards="relative error of E, L2",
    )


def _measured(comm: MPI.Comm, case: Case) -> tuple[np.ndarray, float]:
    """Errors of φ (L2, max) and E (L2, max) per resolution, and the most cycles. Collective."""
    errors, cycles = [], []
    for cells in case.cells:
        of_phi, of_field, taken = solve(case.mesh.hierarchy(comm, cells, case.boundary), case.source)
        errors.append([*of_phi, *of_field])
        cycles.append(taken)
    return np.array(errors), max(cycles)


def _row(case: Case, error: np.ndarray) -> list[Cell]:
    order = [observed_order(case.cells, error[:, c].tolist()) for c in range(4)]
    asked = zip(order[1:], case.orders, strict=True)
    goals = [found if least is None else Goal(found, least, least=True) for found, least in asked]
    return [*map(float, error[-1]), order[0], *goals]


def solve(hierarchy: Hierarchy, source: Source) -> tuple[tuple[float, float], tuple[float, float], float]:
    """Errors of φ and of E (L2, max), and the cycles that the solve took. Collective."""
    solver = PoissonSolver(hierarchy, tolerance=1e-10, background="neutralizing" if hierarchy.domain.singular else None)
    rho = fill(Field(hierarchy), source)
    phi, report = solver.solve(rho, boundary_values=source.potential, boundary_flux=outward_slope(hierarchy, source))
    cycles = report.cycles if report.converged else np.nan
    efield = solver.electric_field(phi)
    of_phi = errors([phi], source.potential, shift=hierarchy.domain.singular)
    return of_phi, errors(efield.components, source.field), cycles


def outward_slope(hierarchy: Hierarchy, source: Source) -> Function:
    lower, upper = hierarchy.domain.lower, hierarchy.domain.upper

    def slope(*place: np.ndarray) -> np.ndarray:
        out = np.zeros(len(place[0]))
        for axis, component in enumerate(source.field(*place)):
            at_lower, at_upper = place[axis] == lower[axis], place[axis] == upper[axis]
            out += np.where(at_lower, component, 0.0) - np.where(at_upper, component, 0.0)
        return out

    return slope

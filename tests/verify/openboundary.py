"""The open boundary: how far it is from free space, beside the error of the mesh itself."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
import scipy.fft
from mpi4py import MPI
from scipy.sparse.linalg import LinearOperator, gmres

from amrpic.mesh.domain import Domain
from amrpic.mesh.field import Field, VectorField
from amrpic.mesh.hierarchy import Hierarchy
from amrpic.stages.poisson import PoissonSolver
from amrpic.verify.table import Cell, Goal, Table
from exact.errors import errors
from exact.lattice import FreeLattice
from exact.meshes import MESHES
from exact.sources import EPS0, Gaussian, Source, Sphere, Together, fill

from .lengths import in_brief

CELLS = 48
SPACING = 1 / CELLS
MIDDLE = (0.5, 0.5, 0.5)
ROBIN = 0.85  # the reference's d = 1.7, for a domain of half the width


def tables(comm: MPI.Comm) -> Iterator[Table]:
    """The tables of this topic. Collective."""
    if not in_brief():
        yield _beside_lattice(comm)
    yield Table(
        "One charged cell at the wall",
        "No mesh resolves it, so the distance to the infinite lattice counts alone: φ and E relative to their largest values.",
        ("cell", "φ, boundary", "E, boundary"),
        [[str(cell), *_one_cell(comm, cell)] for cell in ((0, 24, 24), (0, 5, 16), (0, 0, 0), (47, 46, 3))],
    )
    if in_brief():
        return
    yield Table(
        "Refinement between open walls",
        "Meshes that touch the walls, and others: largest error of φ and of E, over that with the exact potential given on the "
        "same faces.",
        ("source", "mesh", "φ", "E"),
        [
            [name, mesh, *_beside_exact_walls(comm, SOURCES[name], mesh)]
            for name, mesh in (
                ("bunch near a face", "patch at a face"),
                ("bunch near an edge", "patch at an edge"),
                ("bunch near a corner", "patch at a corner"),
                ("bunch near a face", "nested cubes"),
                ("ellipsoidal Gaussian", "nested cubes"),
                ("neutral pair", "nested cubes"),
                ("train on the diagonal", "disjoint patches"),
            )
        ],
    )


def _beside_lattice(comm: MPI.Comm) -> Table:
    return Table(
        "Open boundary against free space",
        f"On {CELLS}³ cells: how far φ and E are from the exact solution of the same equations on an infinite lattice (lattice "
        "Green's function, by FFT), as a part of how far that one is from the exact field of the source. Last column: the same "
        "for the reference's Robin condition ∂φ/∂n = −φ/d. Relative to the largest φ and E.",
        ("source", "φ, mesh", "E, mesh", "φ, boundary", "E, boundary", "φ, over mesh", "E, over mesh", "φ, Robin"),
        [[name, *_row(comm, source)] for name, source in SOURCES.items()],
    )


SOURCES: dict[str, Source] = {
    "sphere": Sphere(0.25, MIDDLE),
    "sphere up to the walls": Sphere(0.48, MIDDLE),
    "Gaussian": Gaussian((0.08,) * 3, MIDDLE),
    "ellipsoidal Gaussian": Gaussian((0.04, 0.06, 0.09), MIDDLE),
    "bunch near a face": Gaussian((0.04,) * 3, (0.22, 0.5, 0.5)),
    "bunch near an edge": Gaussian((0.04,) * 3, (0.22, 0.22, 0.5)),
    "bunch near a corner": Gaussian((0.04,) * 3, (0.22, 0.22, 0.22)),
    "train on the diagonal": Together(tuple(Gaussian((0.04,) * 3, (s, s, 0.5)) for s in np.linspace(0.2, 0.8, 6))),
    "neutral pair": Together((Gaussian((0.05,) * 3, (0.4, 0.5, 0.5)), Gaussian((0.05,) * 3, (0.62, 0.55, 0.5), -EPS0))),
}


def _row(comm: MPI.Comm, source: Source) -> list[Cell]:
    phi, efield, rho = _solved(comm, source)
    exact_phi, exact_field = _free_space(rho)
    centres = [(np.arange(CELLS) + 0.5) * SPACING] * 3
    places = np.meshgrid(*centres, indexing="ij", sparse=True)
    true_phi, true_field = source.potential(*places), np.array(np.broadcast_arrays(*source.field(*places)))
    mesh = _largest(exact_phi, true_phi), _largest(exact_field, true_field)
    boundary = _largest(phi, exact_phi), _largest(efield, exact_field)
    parts = [Goal(b / m, 0.1) for b, m in zip(boundary, mesh, strict=True)]
    return [*mesh, *boundary, *parts, _largest(_robin(rho), exact_phi)]


def _one_cell(comm: MPI.Comm, cell: tuple[int, int, int]) -> list[Cell]:
    hierarchy = _uniform(comm)
    rho = Field(hierarchy)
    for patch in rho.patches:
        inside = np.array(cell) - np.array(patch.lower)
        if np.all((inside >= 0) & (np.array(cell) <= np.array(patch.upper))):
            patch.data[tuple(inside)] = EPS0 / SPACING**3
    phi, efield = _solve(rho)
    exact_phi, exact_field = _free_space(_whole(rho))
    return [Goal(_largest(phi, exact_phi), 1e-4), Goal(_largest(efield, exact_field), 1e-4)]


def _beside_exact_walls(comm: MPI.Comm, source: Source, mesh: str) -> list[Cell]:
    found = []
    for boundary in ("open", "dirichlet"):
        hierarchy = MESHES[mesh].hierarchy(comm, CELLS, boundary)
        solver = PoissonSolver(hierarchy)
        phi, _ = solver.solve(fill(Field(hierarchy), source), boundary_values=source.potential)
        found.append(
            (errors([phi], source.potential)[1], errors(solver.electric_field(phi).components, source.field)[1])
        )
    opened, given = found
    return [Goal(a / b, 1.1) for a, b in zip(opened, given, strict=True)]


# ---- the solver's answer, the exact one, the reference's ----


def _uniform(comm: MPI.Comm) -> Hierarchy:
    return Hierarchy(comm, Domain((0, 0, 0), (1, 1, 1), (CELLS,) * 3, boundary="open"), max_grid_size=24)


def _solved(comm: MPI.Comm, source: Source) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    rho = fill(Field(_uniform(comm)), source)
    return *_solve(rho), _whole(rho)


def _solve(rho: Field) -> tuple[np.ndarray, np.ndarray]:
    solver = PoissonSolver(rho.hierarchy, tolerance=1e-11)
    phi, _ = solver.solve(rho)
    efield: VectorField = solver.electric_field(phi)
    return _whole(phi), np.array([_whole(component) for component in efield.components])


def _whole(field: Field) -> np.ndarray:
    """All cells of level 0 on every rank. Collective."""
    out = np.zeros((CELLS,) * 3)
    for patch in field.patches:
        out[tuple(slice(a, b + 1) for a, b in zip(patch.lower, patch.upper, strict=True))] = patch.data
    return field.comm.allreduce(out, op=MPI.SUM)


def _free_space(rho: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """φ and E of charge on the infinite lattice."""
    padded = FreeLattice(rho.shape, (SPACING,) * 3)(rho * SPACING**3 / EPS0)
    inner = (slice(1, -1),) * 3
    field = [(np.roll(padded, 1, d) - np.roll(padded, -1, d))[inner] / (2 * SPACING) for d in range(3)]
    return padded[inner], np.array(field)


def _robin(rho: np.ndarray) -> np.ndarray:
    """φ with the reference's ghosts φ₂ − (2h/d) φ₁, φ₁ and φ₂ the two cells behind the wall."""

    def minus_laplacian(flat: np.ndarray) -> np.ndarray:
        phi = flat.reshape(rho.shape)
        total = np.zeros_like(phi)
        for d in range(3):
            p = np.moveaxis(phi, d, 0)
            low, high = p[1] - 2 * SPACING / ROBIN * p[0], p[-2] - 2 * SPACING / ROBIN * p[-1]
            wide = np.concatenate([low[None], p, high[None]])
            total += np.moveaxis(2 * p - wide[2:] - wide[:-2], 0, d)
        return total.ravel()

    modes = 2 - 2 * np.cos(np.pi * np.arange(1, CELLS + 1) / CELLS)
    symbol = modes[:, None, None] + modes[:, None] + modes

    def dirichlet_inverse(flat: np.ndarray) -> np.ndarray:
        values = scipy.fft.dstn(flat.reshape(rho.shape), type=2) / symbol
        return scipy.fft.idstn(values, type=2).ravel()

    shape = (rho.size, rho.size)
    f = rho.ravel() * SPACING**2 / EPS0
    phi, status = gmres(
        LinearOperator(shape, minus_laplacian, dtype=float),
        f,
        M=LinearOperator(shape, dirichlet_inverse, dtype=float),
        rtol=1e-6,
        maxiter=20,
        restart=60,
    )
    return phi.reshape(rho.shape) if status == 0 else np.full(rho.shape, np.nan)


def _largest(found: np.ndarray, exact: np.ndarray) -> float:
    """Largest difference over the largest value; the lengths of vectors, if the first axis is that of components."""
    if exact.ndim == 3:
        return float(np.abs(found - exact).max() / np.abs(exact).max())
    return float(np.linalg.norm(found - exact, axis=0).max() / np.linalg.norm(exact, axis=0).max())

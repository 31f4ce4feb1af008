# mypy: disable-error-code="arg-type"
"""Random bodies, electrodes and domains with them, drawn by a seed."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

import amrpic
from amrpic import shapes
from amrpic.errors import AmrpicError as Error

REFUSED = ("touch at", "meets a periodic face", "nothing fixes", "meets no line")
CELLS = (4, 5, 7, 8, 11, 13, 16, 17, 23)
KINDS = ("dirichlet", "neumann", "periodic")


def body(rng: np.random.Generator, size: np.ndarray) -> shapes.Shape:
    """Return a simple body within the unit cube, of about `size` (3,)."""
    centre = rng.uniform(0.05, 0.95, 3)
    least = float(size.min())
    way = rng.normal(size=3)
    end = centre + size * way / np.linalg.norm(way)
    kinds = {
        "sphere": lambda: shapes.Sphere(tuple(centre), least / 2),
        "ellipsoid": lambda: shapes.Sphere(tuple(centre), 0.5).scaled(size, about=centre),
        "box": lambda: shapes.Box(tuple(centre - size / 2), tuple(centre + size / 2)),
        "turned box": lambda: shapes.Box(tuple(centre - size / 2), tuple(centre + size / 2)).turned(
            way, rng.uniform(0, 6), about=centre
        ),
        "cylinder": lambda: shapes.Cylinder(tuple(centre), tuple(end), least / 3),
        "cone": lambda: shapes.Cone(tuple(centre), tuple(end), least / 2, least / 9),
        "torus": lambda: shapes.Torus(tuple(centre), tuple(way), least, least / 3),
        "foil": lambda: shapes.Disk(tuple(centre), tuple(way), float(size.max())),
        "upright foil": lambda: shapes.Disk(tuple(centre), "xyz"[rng.integers(3)], float(size.max())),
        "half space": lambda: shapes.Plane(tuple(rng.uniform(-0.1, 0.15, 3)), tuple(abs(way))),
    }
    return kinds[rng.choice(list(kinds))]()


def tree(rng: np.random.Generator, size: np.ndarray, depth: int = 2) -> shapes.Shape:
    """Return bodies combined at random."""
    if depth == 0 or rng.random() < 0.4:
        return body(rng, size)
    one, other = tree(rng, size, depth - 1), tree(rng, size, depth - 1)
    return [one | other, one - other, one & other][rng.choice(3, p=[0.6, 0.3, 0.1])]


@dataclass(frozen=True)
class Case:
    """A domain of one level with electrodes."""

    domain: amrpic.Domain
    electrodes: tuple[amrpic.Electrode, ...]
    stretch: tuple[float, float, float]

    def hierarchy(self, comm, max_grid_size=1024) -> amrpic.Hierarchy:
        return amrpic.Hierarchy(comm, self.domain, (), max_grid_size, 2)


def domain(rng: np.random.Generator) -> amrpic.Domain:
    """Return one of at most 2e4 cells; corner and edges are such that few numbers are round."""
    cells = np.array(rng.choice(CELLS, 3))
    if rng.random() < 0.2:
        cells[rng.integers(3)] = rng.choice([31, 47, 64])
    while cells.prod() > 20000:
        cells = np.maximum(cells // 2, 4)
    widths = np.ones(3)
    if rng.random() < 0.4:
        widths[rng.integers(3)] = rng.choice([2.0, 4.0])
    boundary = []
    for _ in range(3):
        kind = rng.choice(KINDS, p=[0.5, 0.2, 0.3])
        boundary.append((kind, kind if kind == "periodic" or rng.random() < 0.5 else rng.choice(KINDS[:2])))
    lower = rng.uniform(-1, 1, 3)
    return amrpic.Domain(tuple(lower), tuple(lower + 0.1 * cells * widths), tuple(map(int, cells)), boundary)


def draw(seed: int) -> Case:
    """Return a case that is not refused for metal that touches."""
    rng = np.random.default_rng(seed)
    while True:
        of = domain(rng)
        edges = np.subtract(of.upper, of.lower)
        electrodes = []
        for number in range(rng.integers(1, 4)):
            shape = tree(rng, rng.uniform(0.05, 0.5, 3)).scaled(edges).moved(of.lower)
            floats = rng.random() < 0.3
            given = {"charge": rng.uniform(-1e-11, 1e-11)} if floats else {"voltage": rng.uniform(-2, 2)}
            electrodes.append(amrpic.Electrode(f"e{number}", shape, **given))
        stretch = (1.0, 1.0, float(rng.choice([1, 1, 1, 3])))
        case = Case(of, tuple(electrodes), stretch)
        if usable(case):
            return case


def usable(case: Case) -> bool:
    """Whether a solver takes it, and something holds the potential."""
    from mpi4py import MPI

    try:
        amrpic.PoissonSolver(case.hierarchy(MPI.COMM_SELF), electrodes=case.electrodes, stretch=case.stretch)
    except Error as refused:
        if any(part in str(refused) for part in REFUSED):
            return False
        raise
    return True

"""The cases on which AMReX was measured, and the errors that its MLMG reached there."""

from __future__ import annotations

import json
from importlib.resources import files

from mpi4py import MPI

from amrpic.mesh.domain import BoundarySpec, Domain
from amrpic.mesh.hierarchy import Hierarchy

from .sources import EPS0, Gaussian, Together

# Per level: φ L2 relative to the level's own norm, φ max relative to that of all levels, E L2, E max; by AMReX 24.10.
PEER: dict[str, list[tuple[float, float, float, float]]] = {
    "static 64": [
        (6.8e-5, 2.7e-5, 1.12e-3, 2.0e-4),
        (1.0e-4, 4.4e-5, 1.07e-3, 7.5e-4),
        (2.2e-4, 8.2e-4, 1.11e-3, 2.2e-3),
    ],
    "static 128": [
        (1.7e-5, 6.5e-6, 2.8e-4, 5.2e-5),
        (2.5e-5, 1.1e-5, 2.6e-4, 1.9e-4),
        (5.6e-5, 2.1e-4, 2.8e-4, 5.4e-4),
    ],
    "bunch 64": [
        (9.4e-5, 2.8e-4, 3.5e-3, 2.9e-3),
        (1.4e-4, 2.7e-4, 4.0e-3, 5.0e-3),
        (3.9e-4, 3.4e-3, 4.6e-3, 1.26e-2),
    ],
    "bunch 128": [
        (4.3e-5, 1.4e-4, 1.5e-3, 2.4e-3),
        (8.6e-5, 8.8e-5, 1.6e-3, 2.0e-3),
        (1.3e-4, 8.2e-4, 1.3e-3, 4.6e-3),
    ],
}


def static(comm: MPI.Comm, n: int, max_grid_size: int = 32, walls: BoundarySpec = "dirichlet") -> Hierarchy:
    """The unit cube of n³ cells, and two nested cubes of as many in its middle. Collective."""
    domain = Domain((0, 0, 0), (1, 1, 1), (n,) * 3, boundary=walls)
    first = [((n // 2,) * 3, (3 * n // 2 - 1,) * 3)]
    second = [((3 * n // 2,) * 3, (5 * n // 2 - 1,) * 3)]
    return Hierarchy(comm, domain, [first, second], max_grid_size=max_grid_size)


def static_source(x: float = 0.5) -> Gaussian:
    """The Gaussian of the case, of unit charge over ε₀."""
    return Gaussian((0.03,) * 3, (x, 0.5, 0.5), EPS0)


def bunch(comm: MPI.Comm, n: int, max_grid_size: int = 32) -> Hierarchy:
    """The unit cube of n³ cells (64 or 128) with boxes around ten Gaussians. Collective."""
    domain = Domain((0, 0, 0), (1, 1, 1), (n,) * 3, boundary="dirichlet")
    return Hierarchy(comm, domain, _bunch_data()[f"levels_{n}"], max_grid_size=max_grid_size)


def bunch_source() -> Together:
    """The ten Gaussians."""
    rows = _bunch_data()["bunches"]
    return Together(tuple(Gaussian((s,) * 3, (x, y, z), q * EPS0) for x, y, z, s, q in rows))


def _bunch_data() -> dict:
    return json.loads((files(__package__) / "bunch.json").read_text())

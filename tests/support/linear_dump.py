"""A refined hierarchy with fields that are linear in space, and its dump: wrong axes, origins or orders show at once."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from mpi4py import MPI

from amrpic import Domain, Field, Hierarchy, VectorField
from amrpic.io import vtkhdf_writer
from amrpic.io.provenance import Moment, Provenance
from amrpic.io.writer_ranks import Writers

DOMAIN = Domain(lower=(-0.15, -0.3, 0.1), upper=(0.09, 0.18, 0.74), cells=(24, 16, 32), boundary="dirichlet")
LEVELS = [[((8, 8, 8), (39, 23, 31)), ((8, 8, 40), (15, 15, 55))], [((24, 24, 24), (39, 31, 47))]]
ABOUT = Provenance({"name": "test", "unit": "µm"}, "0.1.0", 42)
STEP, TIME = 7, 1.25e-9  # s


def phi_at(x: Any, y: Any, z: Any) -> Any:
    """The potential in V."""
    return 3 * x - 2 * y + 0.5 * z + 1


def dumped(comm: MPI.Comm) -> tuple[Hierarchy, dict[str, Any]]:
    """A hierarchy of three levels with φ linear in space and E = 10⁶ (x, y, z). Collective."""
    hierarchy = Hierarchy(comm, DOMAIN, LEVELS, max_grid_size=16, blocking_factor=8)
    phi = Field(hierarchy, unit="V").fill(phi_at)
    x = Field(hierarchy, unit="V/m").fill(lambda x, y, z: 1e6 * x)
    y = Field(hierarchy, unit="V/m").fill(lambda x, y, z: 1e6 * y)
    z = Field(hierarchy, unit="V/m").fill(lambda x, y, z: 1e6 * z)
    return hierarchy, {"phi": phi, "E": VectorField(x, y, z)}


def write(comm: MPI.Comm, path: Path, writers: int = 1) -> Hierarchy:
    """Write the dump, and return its hierarchy. Collective."""
    hierarchy, values = dumped(comm)
    vtkhdf_writer.write(path, hierarchy, values, Moment(STEP, TIME), ABOUT, Writers(writers))
    return hierarchy

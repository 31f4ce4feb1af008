"""From one mesh to the next: points move with the displacement and take along what they carry."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from ..fem import Mesh
from ..fem.full import WALLS
from .material_points import MaterialPoints, migrate, placed, require_inside
from .solid import Solid


def moved(solid: Solid, u: np.ndarray, body: np.ndarray | slice, initial_volume: np.ndarray) -> MaterialPoints:
    """Return the points `body` of a solid after a displacement (nodes, 3) in m: x + u, (1 + ∇u) F. Collective.

    Damage and driving energy are those that the solid has; initial volumes (n,) in m³ are given.
    """
    points = solid.points
    position = points.position
    position += points.values(u)
    return MaterialPoints(
        position[body],
        points.number[body].astype(np.int64, copy=False),
        solid.material[body],
        solid.displaced(u)[body],
        initial_volume,
        solid.damage[body],
        solid.driving[body],
    )


def carried(solid: Solid, u: np.ndarray, mesh: Mesh, free: ArrayLike = WALLS) -> Solid:
    """Return the solid after a displacement, (nodes, 3) in m, on a mesh that has none. Collective.

    Points move by u to the ranks of their elements, and have F and volumes from there on; damage and driving energy stay.
    `free` (3, 2): which faces of the mesh, lower and upper along each axis, are no walls; elements at these keep volumes.
    Raises on all ranks ParticleError for points that are outside the mesh, InputError for elements with too few.
    """
    columns = moved(solid, u, slice(None), solid.points.volume / solid.j).columns()
    require_inside(columns, mesh, 1.0)
    return placed(migrate(columns, mesh)[0], mesh, list(solid.materials), "moments", free=free).solid

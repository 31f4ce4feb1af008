"""The points of a scene at its start."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from .. import fem
from ..errors import SceneError
from ..fem import Mesh, Points
from ..mpi import MPI
from ..parallel import global_sum, raise_together, together
from .material_points import MaterialPoints
from .scene import Scene

LAYOUTS: dict[str, Callable[[Mesh, Scene], Points]] = {
    "jittered": lambda mesh, scene: fem.jittered(mesh, scene.points.per_axis, scene.seed, "volume"),
    "random": lambda mesh, scene: fem.random(mesh, scene.points.per_axis, scene.seed, "volume"),
    "uniform": lambda mesh, scene: fem.uniform(mesh, scene.points.per_axis, "volume"),
    "gauss": lambda mesh, scene: fem.gauss(mesh, scene.points.per_axis),
}


def mesh_of(comm: MPI.Comm, scene: Scene, load: float = 0.0) -> Mesh:
    """Return the mesh at a part of the load. Collective."""
    lower, upper = scene.extent(load)
    return Mesh(comm, lower, upper, scene.domain.cells, scene.domain.degree)


def sample(scene: Scene, mesh: Mesh) -> MaterialPoints:
    """Return this rank's points at the start, whole and at rest: the same ones on any number of ranks. Collective.

    Points where the structure is empty are left out. SceneError on all ranks if there are no others, or a file is none.
    """
    points = LAYOUTS[scene.points.layout](mesh, scene)
    place = points.position
    with together(mesh.comm, SceneError):
        material = scene.structure.labels(place, scene.extent(0.0), list(scene.materials))
    solid = material >= 0
    count = int(solid.sum())
    everywhere = global_sum(mesh.comm, count)
    raise_together(
        mesh.comm, f"{scene.name}: the structure is empty; give it a material" if everywhere == 0 else None, SceneError
    )
    return MaterialPoints(
        place[solid],
        points.number[solid].astype(np.int64),
        material[solid].astype(np.int32),
        np.tile(np.eye(3), (count, 1, 1)),
        points.volume[solid],
        np.zeros(count),
        np.zeros(count),
    )

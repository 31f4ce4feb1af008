"""What a step asks of nodes: where faces hold them, and the forces of gravity."""

from __future__ import annotations

import numpy as np

from ..fem import Mesh
from .loads import Loads
from .material_points import PlacedPoints
from .scene import Scene
from .state import Plan


def nodes_of(mesh: Mesh, axis: int, side: int) -> np.ndarray:
    """Return which of this rank's nodes lie on a face, (nodes,). Local."""
    at = mesh.node_indices[:, axis]
    return at == (mesh.node_counts[axis] - 1 if side else 0)


def held_by(scene: Scene, mesh: Mesh, loads: Loads) -> tuple[np.ndarray, np.ndarray]:
    """Return what faces fix of nodes in a step of the load: a mask, and displacements in m. Local.

    Both (nodes, 3); the mesh is that of the step's begin.
    """
    before, after = scene.extent(loads.begin), scene.extent(loads.end)
    fixed = np.zeros((len(mesh.node_indices), 3), dtype=bool)
    values = np.zeros(fixed.shape)
    for axis, pair in enumerate(scene.faces.values()):
        for side, face in enumerate(pair):
            on = nodes_of(mesh, axis, side)
            if face.kind == "clamped":
                fixed[on] = True
            elif face.kind == "slip":
                fixed[on, axis] = True
                values[on, axis] = after[side][axis] - before[side][axis]
    return fixed, values


def body_force(placed: PlacedPoints, plan: Plan, load: float) -> np.ndarray:
    """Return the forces of gravity on nodes at a part of the load, (nodes, 3) in N: of points' masses. Collective."""
    points, whole = placed.points, placed.solid.points
    if not any(plan.scene.gravity):
        return np.zeros((len(placed.mesh.node_indices), 3))
    density = np.array(plan.densities)[points.material]
    force = np.zeros((len(whole), 3))
    mass_per_weight = density * points.initial_volume / whole.weight[placed.body]
    force[placed.body] = mass_per_weight[:, None] * np.array(plan.scene.gravity) * load
    return whole.integrate(force)


def even_motion(scene: Scene, mesh: Mesh, loads: Loads) -> np.ndarray:
    """Return the displacement in m, (nodes, 3), of a mesh that follows its faces evenly; where held, it is theirs. Local."""
    (lower, upper), (to_lower, to_upper) = scene.extent(loads.begin), scene.extent(loads.end)
    part = (mesh.nodes - lower) / (upper - lower)
    fixed, values = held_by(scene, mesh, loads)
    return np.where(fixed, values, (1 - part) * (to_lower - lower) + part * (to_upper - upper))

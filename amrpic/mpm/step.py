"""One load step of material points as a composition of its stages, and the state before the first one."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from .. import fem
from ..errors import ParticleError, SceneError, SolverError
from ..fem import Mesh, Points
from ..mpi import MPI
from ..parallel import global_sum, raise_together, together
from .carry import moved
from .conditions import body_force, even_motion, held_by
from .damage import DamageReport, Settled, settle
from .loads import Loads
from .material_points import Columns, MaterialPoints, PlacedPoints, migrate, placed, require_inside
from .rows import at_rest, measure
from .scene import Scene
from .state import LoadState, Plan

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


def begin(plan: Plan) -> LoadState:
    """Return the state before the first step. Collective."""
    mesh, scene = mesh_of(plan.comm, plan.scene), plan.scene
    with plan.clock("sample"):
        columns = sample(scene, mesh).columns()
    points, _ = put(columns, plan, 0.0)
    return LoadState(0, scene.schedule.loads(), points, at_rest(points, plan))


def advance(state: LoadState, plan: Plan) -> LoadState:
    """Return the state one load step later; a step without equilibrium, or after which points leave the mesh, is halved.

    Collective; SolverError on all ranks if even the smallest step fails, with the reason.
    """
    loads, cuts, points = state.loads, 0, state.placed.points
    while True:
        try:
            settled, report = _equilibrium(state, loads, plan)
            measured = measure(state, loads, settled, report, plan)
            solid, u, body = settled.solid, settled.displacement, state.placed.body
            points_then, arrived = put(moved(solid, u, body, points.initial_volume).columns(), plan, loads.end)
            break
        except (SolverError, ParticleError) as why:  # a large step may fold the mesh between points: some are outside
            loads, cuts = loads.cut(str(why)), cuts + 1
    measured |= {"cuts": cuts, "changed_rank": plan.comm.allreduce(arrived)} | at_rest(points_then, plan)
    return LoadState(state.step + 1, loads.taken(report.most_iterations, report.growth), points_then, measured)


def put(columns: Columns, plan: Plan, load: float) -> tuple[PlacedPoints, int]:
    """Return points in the mesh at a part of the load, and how many of this rank came from others. Collective.

    Nothing is left in `columns`.
    """
    scene = plan.scene
    with plan.clock("migrate"):
        mesh = mesh_of(plan.comm, scene, load)
        require_inside(columns, mesh, load)
        points, arrived = migrate(columns, mesh)
    with plan.clock("weigh"):
        free = [[face.kind == "free" for face in pair] for pair in scene.faces.values()]
        return placed(points, mesh, plan.materials, scene.points.weights, scene.floor_stiffness, free), arrived


def _equilibrium(state: LoadState, loads: Loads, plan: Plan) -> tuple[Settled, DamageReport]:
    """Return where forces balance at the end of a step. Collective; SolverError on all ranks if that is not found."""
    scene, placed = plan.scene, state.placed
    fixed, values = held_by(scene, placed.mesh, loads)
    with plan.clock("equilibrium"):
        settled, report = settle(
            placed.solid,
            fixed=fixed,
            values=values,
            even=even_motion(scene, placed.mesh, loads),
            load=body_force(placed, plan, loads.end),
            tolerance=scene.solver.tolerance,
            damage_tolerance=scene.solver.damage_tolerance,
            most_turns=scene.solver.turns,
            most_growth=loads.most_growth,
            most_iterations=scene.solver.iterations,
            coarse=scene.solver.coarse,
        )
    if not report.converged:
        raise SolverError(report.reason)
    return settled, report

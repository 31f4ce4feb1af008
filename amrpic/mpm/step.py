"""One load step of material points as a composition of its stages, and the state before the first one."""

from __future__ import annotations

from dataclasses import replace

from ..errors import ParticleError
from .carry import moved
from .conditions import body_force, even_motion, held_by
from .damage import DamageReport, Settled, settle
from .loads import Loads
from .material_points import Columns, Placed, migrate, placed, require_inside
from .measure import at_rest, measure
from .sample import mesh_of, sample
from .state import Plan, State


def begin(plan: Plan) -> State:
    """Return the state before the first step. Collective."""
    mesh, scene = mesh_of(plan.comm, plan.scene), plan.scene
    with plan.clock("sample"):
        columns = sample(scene, mesh).columns()
    there, _ = put(columns, plan, 0.0)
    return replace(State(0, scene.schedule.loads(), there), measured=at_rest(there, plan))


def advance(state: State, plan: Plan) -> State:
    """Return the state one load step later; a step without equilibrium, or after which points leave the mesh, is halved.

    Collective; SolverError on all ranks if even the smallest step fails.
    """
    loads, cuts = state.loads, 0
    while (found := _taken(state, loads, plan)) is None:
        loads, cuts = loads.cut(), cuts + 1
    settled, report, there, came = found
    measured, totals = measure(state, loads, settled, report, plan)
    measured |= {"cuts": cuts, "changed_rank": plan.comm.allreduce(came)} | at_rest(there, plan)
    after = loads.taken(max(one.iterations for one in report.equilibria), report.growth)
    return State(state.step + 1, after, there, totals, measured)


def put(columns: Columns, plan: Plan, load: float) -> tuple[Placed, int]:
    """Return points in the mesh at a part of the load, and how many of this rank came from others. Collective.

    Nothing is left in `columns`.
    """
    scene = plan.scene
    with plan.clock("migrate"):
        mesh = mesh_of(plan.comm, scene, load)
        require_inside(columns, mesh, load)
        there, came = migrate(columns, mesh)
    with plan.clock("weigh"):
        return placed(there, mesh, plan.materials, scene.points.weights, scene.floor_stiffness), came


def _taken(state: State, loads: Loads, plan: Plan) -> tuple[Settled, DamageReport, Placed, int] | None:
    """Return the equilibrium at the end of a step, and where points are then, as `put` has it; None if it fails. Collective.

    A step may be so large that the mesh folds between points, and puts some of them outside.
    """
    found = _equilibrium(state, loads, plan)
    if found is None:
        return None
    settled, report = found
    points = state.placed.points
    columns = moved(settled.solid, settled.displacement, state.placed.body, points.initial_volume).columns()
    try:
        return settled, report, *put(columns, plan, loads.end)
    except ParticleError:
        return None


def _equilibrium(state: State, loads: Loads, plan: Plan) -> tuple[Settled, DamageReport] | None:
    """Return where forces balance at the end of a step, None if that was not found. Collective."""
    scene, there = plan.scene, state.placed
    fixed, values = held_by(scene, there.mesh, loads.begin, loads.end)
    with plan.clock("equilibrium"):
        settled, report = settle(
            there.solid,
            fixed=fixed,
            values=values,
            even=even_motion(scene, there.mesh, loads.begin, loads.end),
            load=body_force(there, plan.densities, scene.gravity, loads.end),
            tolerance=scene.solver.tolerance,
            damage_tolerance=scene.solver.damage_tolerance,
            most_turns=scene.solver.turns,
            most_growth=loads.most_growth,
            most_iterations=scene.solver.iterations,
            coarse=scene.solver.coarse,
        )
    return (settled, report) if report.converged else None

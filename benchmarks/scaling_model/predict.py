"""The model beside what was measured: how far off it is for each stage."""

from __future__ import annotations

from collections.abc import Callable, Sequence

from amrpic.scaling.measured import NEW_MESH, NEW_SOLVER, Measured
from amrpic.scene.scene import Scene

from .calibrate import amounts_of, middle
from .machine import Machine
from .model import OF_NEW, Time, stage_time, step_time
from .plan import Plan, Planner

LEAST = 0.05  # of a step: shorter stages do not count

Rows = list[list[str]]


def predicted(
    scene: Scene, found: Sequence[Measured], machine: Machine, say: Callable[[str], None] = lambda text: None
) -> tuple[Rows, float]:
    """Return a row for each stage above `LEAST` of a step of measured runs, and the largest error, relative.

    The model is given the mesh and the cycles of the run, since it does not predict these.
    """
    rows: Rows = [["ranks", "stage", "of the step", "measured, ms", "modelled, ms", "off by"]]
    worst = 0.0
    for one in found:
        plan = Planner(scene, say, middle(one)).plan(one.ranks)
        times = _modelled(plan, machine, one)
        stages = {name: one.stages[name].most for name in times if name in one.stages}
        often = {NEW_MESH: one.meshes, NEW_SOLVER: one.remade}
        step = sum(often.get(name, 1.0) * seconds for name, seconds in stages.items())
        for name, seconds in stages.items():
            part = often.get(name, 1.0) * seconds / step
            if part < LEAST:
                continue
            modelled = times[name].total
            worst = max(worst, abs(modelled / seconds - 1))
            cells = f"{part:.0%}", f"{1e3 * seconds:.4g}", f"{1e3 * modelled:.4g}", f"{modelled / seconds - 1:+.0%}"
            rows.append([f"{one.ranks}", name, *cells])
    return rows, worst


def _modelled(plan: Plan, machine: Machine, one: Measured) -> dict[str, Time]:
    amounts = amounts_of(one, plan, machine)
    changed = amounts_of(one, plan, machine, on_new=True)
    return {
        **step_time(plan, machine, one.cycles, amounts),
        **{stage: stage_time(stage, plan, machine, changed) for stage in OF_NEW},
    }

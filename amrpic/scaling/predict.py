"""The model beside what was measured: how far off it is for each stage."""

from __future__ import annotations

from collections.abc import Sequence

from .calibrate import amounts_of
from .machine import Machine
from .measured import Measured
from .model import STAGES, step_time
from .plan import Planner

LEAST = 0.05  # of a step: shorter stages do not count

Rows = list[list[str]]


def predicted(planner: Planner, found: Sequence[Measured], machine: Machine) -> tuple[Rows, float]:
    """Return a row for each stage above `LEAST` of a step of measured runs, and the largest error, relative.

    The model is given the mesh and the cycles of the run, since it does not predict these.
    """
    rows: Rows = [["ranks", "stage", "of the step", "measured, ms", "modelled, ms", "off by"]]
    worst = 0.0
    for one in found:
        plan = planner.plan(one.ranks)
        times = step_time(plan, machine, one.cycles, amounts_of(one, plan))
        stages = {name: one.stages[name].most for name in STAGES if name in one.stages}
        for name, seconds in stages.items():
            part = seconds / sum(stages.values())
            if part < LEAST:
                continue
            modelled = times[name].total
            worst = max(worst, abs(modelled / seconds - 1))
            cells = f"{part:.0%}", f"{1e3 * seconds:.4g}", f"{1e3 * modelled:.4g}", f"{modelled / seconds - 1:+.0%}"
            rows.append([f"{one.ranks}", name, *cells])
    return rows, worst

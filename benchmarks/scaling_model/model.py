"""The time of a step on ranks that do not exist: work of the slowest rank, messages of the busiest one, collectives.

A stage takes, with n cells of level l on a rank, p particles in q bricks of which d come into another one, w patches at open
walls with i interactions, and c cycles that relax the cells s (halos and multigrid levels included, less those that one rank
with all cells relaxes besides); one cycle more for each solve that estimates the error of the mesh

    t = call + Σ_l max n_l cell + c s cycle + max p particle + max d moved + max q brick + max w patch + max i interaction
        + max b byte + m latency + b ranks per node / bandwidth + k log₂(ranks) collective

with its m messages of b bytes, of which those count for the bandwidth that leave its node, or on one node the rank, and k
collectives. Maxima are over ranks; all ranks of a node send at the same time; levels are visited in turn. Stages begin
together: what ranks wait for each other between them stands apart. Between nodes the bytes of particles that migrate pass
while each rank deposits those that stay on it, so that both together take max over ranks of p particle + max(b ranks per node /
bandwidth − stayed particle, 0) in steps that do not look at the mesh; no other message overlaps with work.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Self

import numpy as np

from amrpic.mesh.boxes import Array
from amrpic.scaling.measured import NEW_MESH, NEW_SOLVER

from .machine import Machine, Network, Work
from .plan import Plan

# Calls of a stage that are counted on virtual ranks, and whether they are made once per cycle.
STAGES: Mapping[str, Sequence[tuple[str, bool]]] = {
    "push": (),
    "migrate": (("announce", False), ("migrate", False)),
    "deposit": (("deposit", False),),
    "solve": (("solve", False), ("cycle", True)),
    "open walls": (("open walls", False),),
    "gather": (("gather", False),),
    "output": (("output", False),),
}
# What a step takes more for each new mesh, and with new meshes: no part of `step_time`.
OF_NEW: Mapping[str, Sequence[tuple[str, bool]]] = {
    NEW_MESH: tuple((call, False) for call in ("regrid", "announce", "migrate", "deposit")),
    NEW_SOLVER: (("set-up", False),),
}
NETWORK = ("latency", "bandwidth", "collective")
OF_CELLS = "cells", "swept", "spilled", "swept_spilled", "swept_faces"  # what grows with a rank's cells
OF_WALLS = "patches", "interactions", "near"
CELL_BYTES = (
    40  # of a cell that a cycle reads and writes: potential, right-hand side, correction, residual, what is copied
)
FITS = 20  # rounds, in which errors are measured by what the one before found
WALK = "random walk"  # the push of particles without momenta, whose constants are others


@dataclass(frozen=True)
class Time:
    """Seconds of a stage."""

    work: float
    messages: float
    collectives: float

    @property
    def total(self) -> float:
        return self.work + self.messages + self.collectives


@dataclass(frozen=True)
class Amounts:
    """By what the constants of `Work` are multiplied, those of all stages but for the bytes that a rank sends in one."""

    cycles: float  # of a solve, those included that find the error of the mesh
    cells: float
    swept: float  # cells, times cycles
    spilled: float  # cells for which the cache has no room
    swept_spilled: float
    swept_faces: float
    particles: float
    stayed: Array  # (ranks,) particles that do not come from other ranks
    moved: float
    bricks: float
    patches: float
    interactions: float
    near: float

    @classmethod
    def of(cls, plan: Plan, machine: Machine, cycles: float) -> Self:
        """Return those of a plan with so many cycles that improve the potential."""
        return cls.with_all(plan, machine, plan.all_cycles(cycles))

    @classmethod
    def with_all(cls, plan: Plan, machine: Machine, cycles: float, grown: float = 1.0) -> Self:
        """Return those of a plan with so many cycles, and so many times its cells and bricks."""
        particles, faces = float(plan.particles.max()), float(plan.faces.max(axis=1).sum())
        cells, swept = grown * float(plan.cells.max(axis=1).sum()), grown * plan.swept_cells
        cached = machine.cache / min(machine.network.ranks_per_node, plan.ranks) / CELL_BYTES
        spilled = max(1 - cached / cells, 0.0)
        return cls(
            cycles,
            cells,
            swept * cycles,
            spilled * cells,
            spilled * swept * cycles,
            grown * faces * cycles,
            particles,
            np.maximum(plan.particles - plan.between.sent, 0),
            particles * plan.moved,
            grown * float(plan.bricks.max()),
            *plan.wall_work,
        )


# What has a part in the time of each stage, besides its call; open walls stand apart from the solve.
PARTS: Mapping[str, Sequence[str]] = {
    "push": ("particles",),
    WALK: ("particles",),
    "migrate": ("cells", "particles", "moved", "bricks", "bytes"),
    "deposit": ("cells", "spilled", "particles", "bricks", "bytes"),
    "solve": ("cells", "swept", "swept_spilled", "swept_faces", "bytes"),
    "open walls": ("cells", "spilled", "patches", "interactions", "near", "bytes"),
    "gather": ("cells", "particles", "bricks", "bytes"),
    "output": ("cells", "particles"),
    NEW_MESH: ("cells", "spilled", "particles"),
    NEW_SOLVER: ("cells", "spilled"),
}
OF_WORK = {
    "cells": "cell",
    "spilled": "spilled",
    "swept": "cycle",
    "swept_spilled": "cycle_spilled",
    "swept_faces": "cycle_face",
    "particles": "particle",
    "moved": "moved",
    "bricks": "brick",
    "patches": "patch",
    "interactions": "interaction",
    "near": "near",
    "bytes": "byte",
}


def constants_of(stage: str, plan: Plan) -> str:
    """Return the name of a stage's constants, which for the push hang on how particles move."""
    return WALK if stage == "push" and plan.walks else stage


def row_of(stage: str, plan: Plan, amounts: Amounts) -> dict[str, float]:
    """Return the amounts that a stage's work grows with."""
    calls = _calls(stage)
    given = {what: getattr(amounts, what) for what in OF_WORK if what != "bytes"}
    given["bytes"] = sum(times * plan.most(call, "bytes") for call, times in _times(calls, amounts))
    return {what: given[what] for what in PARTS[constants_of(stage, plan)]}


def step_time(plan: Plan, machine: Machine, cycles: float, amounts: Amounts | None = None) -> dict[str, Time]:
    """Return the time of each stage of a step with so many cycles per solve; `amounts` may stand for those of the plan."""
    found = amounts or Amounts.of(plan, machine, cycles)
    return {stage: stage_time(stage, plan, machine, found) for stage in STAGES}


def stage_time(stage: str, plan: Plan, machine: Machine, amounts: Amounts) -> Time:
    """Return the time of a stage of `STAGES` or `OF_NEW`."""
    work = machine.work(plan.ranks).get(constants_of(stage, plan), Work())
    seconds = work.call + sum(
        value * getattr(work, OF_WORK[what]) for what, value in row_of(stage, plan, amounts).items()
    )
    messages, collectives = network_time(stage, plan, machine.network, amounts)
    if stage == "migrate":
        messages -= overlapped_time(plan, machine, amounts)
    return Time(seconds, messages, collectives)


def overlapped_time(plan: Plan, machine: Machine, amounts: Amounts) -> float:
    """Return the seconds of a step, on average, in which particles pass between nodes while those that stay are deposited."""
    here = machine.network.ranks_per_node
    if plan.ranks <= here:
        return 0.0  # within a node the processors themselves copy
    particle = machine.work(plan.ranks).get("deposit", Work()).particle
    passing = plan.leaving("migrate", here) / machine.network.bandwidth
    together = plan.particles * particle + np.maximum(passing - amounts.stayed * particle, 0)
    return plan.overlapping * float(passing + plan.particles.max() * particle - together.max())


def network_time(stage: str, plan: Plan, network: Network, amounts: Amounts) -> tuple[float, float]:
    """Return the seconds of a stage's messages and collectives, if none overlaps with work."""
    if plan.ranks == 1:
        return 0.0, 0.0
    here = min(network.ranks_per_node, plan.ranks)
    messages = collectives = 0.0
    for call, times in _times(_calls(stage), amounts):
        leaving = plan.leaving(call, here) if plan.ranks > here else here * plan.most(call, "bytes")
        messages += times * (plan.most(call, "messages") * network.latency + leaving / network.bandwidth)
        collectives += times * plan.most(call, "collectives") * math.log2(plan.ranks) * network.collective
    return messages, collectives


def _calls(stage: str) -> Sequence[tuple[str, bool]]:
    return OF_NEW[stage] if stage in OF_NEW else STAGES[stage]


def _times(calls: Sequence[tuple[str, bool]], amounts: Amounts) -> list[tuple[str, float]]:
    """Return how often each call is made."""
    return [(call, amounts.cycles if is_of_cycle else 1.0) for call, is_of_cycle in calls]


def total(times: Mapping[str, Time]) -> float:
    """Return the seconds of a step."""
    return sum(time.total for time in times.values())


def efficiency(first: tuple[int, float], other: tuple[int, float]) -> float:
    """Return the efficiency from one number of ranks and its seconds to another, of the same work."""
    return first[0] * first[1] / (other[0] * other[1])


def sensitivity(plan: Plan, machine: Machine, cycles: float, factor: float = 2.0) -> dict[str, tuple[float, float]]:
    """Return the seconds of a step with each constant divided by the factor, and with it multiplied by it."""
    return {
        what: tuple(total(step_time(plan, machine.scaled(what, by), cycles)) for by in (1 / factor, factor))  # type: ignore[misc]
        for what in ("work", *NETWORK)
    }


def fitted(rows: np.ndarray, seconds: np.ndarray, least: np.ndarray | float = 0.0) -> np.ndarray:
    """Return the constants, none below the `least`, whose sums over `rows` (n, constants) come nearest to seconds (n,).

    Errors are in proportion, and of times for the same work the harmonic mean is found: what disturbs a run makes it longer.
    """
    from scipy.optimize import nnls

    scale = np.maximum(rows.max(axis=0), 1e-300)
    found, of, at_least = np.zeros(len(scale)), seconds, np.broadcast_to(least, len(scale))
    for _ in range(FITS):
        found = at_least + nnls(rows / scale / of[:, None], (seconds - rows @ at_least) / of)[0] / scale
        of = np.sqrt(seconds * np.maximum(rows @ found, seconds / 10))
    return found

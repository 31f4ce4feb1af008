"""The time of a step on ranks that do not exist: work of the slowest rank, messages of the busiest one, collectives.

A stage takes, with n cells of level l on a rank, p particles, w patches at open walls with i interactions, and c cycles that
relax the cells s (halos and multigrid levels included, less those that one rank with all cells relaxes besides); one cycle
more where a solve estimates the error of the mesh

    t = call + Σ_l max n_l cell + c s cycle + max p particle + max w patch + max i interaction
        + m latency + b ranks per node / bandwidth + k log₂(ranks) collective

with its m messages, k collectives, and b bytes that leave its node, or on one node the rank. Maxima are over ranks; all ranks
of a node send at the same time; levels are visited in turn. No message overlaps with work.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Self

import numpy as np

from .machine import Machine, Network, Work
from .plan import Plan

# Calls of a stage that are counted on virtual ranks, and whether they are made once per cycle.
STAGES: Mapping[str, Sequence[tuple[str, bool]]] = {
    "push": (),
    "migrate": (("migrate", False),),
    "deposit": (("deposit", False),),
    "solve": (("solve", False), ("cycle", True)),
    "open walls": (("open walls", False),),
    "gather": (("gather", False),),
    "output": (("output", False),),
}
NETWORK = ("latency", "bandwidth", "collective")


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
    """By what the constants of `Work` are multiplied."""

    cells: float
    swept: float  # cells, times cycles
    particles: float
    patches: float
    interactions: float

    @classmethod
    def of(cls, plan: Plan, cycles: float) -> Self:
        return cls(
            float(plan.cells.max(axis=1).sum()),
            plan.swept_cells * plan.all_cycles(cycles),
            float(plan.particles.max()),
            *plan.wall_work,
        )


# What has a part in the time of each stage, besides its call; open walls stand apart from the solve.
PARTS: Mapping[str, Sequence[str]] = {
    "solve": ("cells", "swept"),
    "open walls": ("cells", "patches", "interactions"),
}
OF_WORK = {
    "cells": "cell",
    "swept": "cycle",
    "particles": "particle",
    "patches": "patch",
    "interactions": "interaction",
}


def parts_of(stage: str) -> Sequence[str]:
    """Return the amounts that a stage's work grows with."""
    return PARTS.get(stage, ("cells", "particles"))


def step_time(plan: Plan, machine: Machine, cycles: float, amounts: Amounts | None = None) -> dict[str, Time]:
    """Return the time of each stage of a step with so many cycles per solve; `amounts` may stand for those of the plan."""
    found, stages = amounts or Amounts.of(plan, cycles), machine.work(plan.ranks)
    return {
        name: Time(_work(stages.get(name, Work()), found), *_messages(plan, machine.network, calls, cycles))
        for name, calls in STAGES.items()
    }


def _work(work: Work, amounts: Amounts) -> float:
    return work.call + sum(getattr(amounts, what) * getattr(work, constant) for what, constant in OF_WORK.items())


def _messages(plan: Plan, network: Network, calls: Sequence[tuple[str, bool]], cycles: float) -> tuple[float, float]:
    if plan.ranks == 1:
        return 0.0, 0.0
    here = min(network.ranks_per_node, plan.ranks)
    messages = collectives = 0.0
    for call, is_of_cycle in calls:
        times = plan.all_cycles(cycles) if is_of_cycle else 1.0
        leaving = plan.leaving(call, here) if plan.ranks > here else here * plan.most(call, "bytes")
        messages += times * (plan.most(call, "messages") * network.latency + leaving / network.bandwidth)
        collectives += times * plan.most(call, "collectives") * math.log2(plan.ranks) * network.collective
    return messages, collectives


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


def fitted(rows: np.ndarray, seconds: np.ndarray) -> np.ndarray:
    """Return the constants, not negative, whose sums over `rows` (n, constants) come nearest to seconds (n,) in proportion."""
    from scipy.optimize import nnls

    scale = np.maximum(rows.max(axis=0), 1e-300)
    return nnls(rows / scale / seconds[:, None], np.ones(len(seconds)))[0] / scale

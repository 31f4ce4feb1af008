"""The time of a step on ranks that do not exist: work of the slowest rank, messages of the busiest one, collectives.

A stage takes, with n cells of level l on a rank, p particles, w base cells at open walls and c cycles

    t = call + Σ_l max n_l (cell + c cycle) + max p particle + w wall + m latency
        + b ranks per node / bandwidth + k log₂(ranks) collective

with its m messages, b bytes and k collectives. Maxima are over ranks; levels are visited in turn.
No message overlaps with work.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from .machine import Machine, Network, Work
from .plan import Plan

# Calls of a stage that are counted on virtual ranks, and whether they are made once per cycle.
STAGES: Mapping[str, Sequence[tuple[str, bool]]] = {
    "push": (),
    "migrate": (("migrate", False),),
    "deposit": (("deposit", False),),
    "solve": (("solve", False), ("cycle", True)),
    "open walls": (),
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


def step_time(
    plan: Plan, machine: Machine, cycles: float, *, balanced_particles: bool = False, shared_walls: bool = False
) -> dict[str, Time]:
    """Return the time of each stage of a step with so many cycles per solve.

    `balanced_particles`: as if each rank had its share of the particles; `shared_walls`: as if ranks shared the work of finding
    the potential at open walls.
    """
    cells = float(plan.cells.max(axis=1).sum())
    particles = float(plan.particles.mean() if balanced_particles else plan.particles.max())
    walls = plan.wall_cells / (plan.ranks if shared_walls else 1)
    stages = machine.work(plan.ranks)
    return {
        name: Time(
            _work(stages.get(name, Work()), cells, particles, walls, cycles),
            *_messages(plan, machine.network, calls, cycles),
        )
        for name, calls in STAGES.items()
    }


def _work(work: Work, cells: float, particles: float, walls: float, cycles: float) -> float:
    each_cell = work.cell + cycles * work.cycle
    return work.call + cells * each_cell + particles * work.particle + walls * work.wall


def _messages(plan: Plan, network: Network, calls: Sequence[tuple[str, bool]], cycles: float) -> tuple[float, float]:
    if plan.ranks == 1:
        return 0.0, 0.0
    per_byte = min(network.ranks_per_node, plan.ranks) / network.bandwidth
    messages = collectives = 0.0
    for call, is_of_cycle in calls:
        times = cycles if is_of_cycle else 1.0
        sent = [of[call].traffic for of in plan.sent]
        messages += times * max(t.messages * network.latency + t.bytes * per_byte for t in sent)
        collectives += times * max(t.collectives for t in sent) * math.log2(plan.ranks) * network.collective
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

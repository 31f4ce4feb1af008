"""What plans of a scene are to reach, kept in TOML, beside what was found."""

from __future__ import annotations

import tomllib
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, fields
from pathlib import Path
from typing import Any, Self

from amrpic.errors import InputError

from .machine import Machine
from .model import efficiency, step_time, total
from .plan import Plan

GIB = 2**30
Row = tuple[str, str, bool]  # what is to be reached, what was found, whether it is


@dataclass(frozen=True)
class Targets:
    """What is to be reached on a machine, by ranks where it depends on them; what is not given is not asked for."""

    machine: str
    cell_imbalance: float | None = None  # Σ_l max ÷ Σ_l mean, at most
    particle_imbalance: float | None = None  # max ÷ mean, at most
    memory_gib: float | None = None  # of a rank, start included, at most
    open_walls_ms: float | None = None  # at most
    collectives_per_cycle: float | None = None  # at most
    plan_minutes: float | None = None  # to make a plan, at most
    plan_gib: float | None = None  # that it takes, at most
    efficiency: dict[str, float] = field(default_factory=dict)  # of a step from the fewest ranks, at least
    step_ms: dict[str, float] = field(default_factory=dict)  # at most

    @classmethod
    def read(cls, path: Path) -> Self:
        """Return the targets of a TOML file. Raises InputError."""
        try:
            values: dict[str, Any] = tomllib.loads(path.read_text(encoding="utf-8"))
            return cls(**values)
        except OSError as reason:
            raise InputError(f"targets {path} cannot be read ({reason.strerror}); give a TOML file") from None
        except (ValueError, TypeError) as reason:
            known = ", ".join(of.name for of in fields(cls))
            raise InputError(f"{path} holds no targets ({reason}); give machine, and some of {known}") from None

    def beside(
        self, plans: Sequence[Plan], machines: Sequence[Machine], cycles: float, peak: float, setup: float
    ) -> Iterator[Row]:
        """Yield what is to be reached beside what plans found, which took `peak` bytes, and `setup` s before the first of them.

        Raises InputError if the machine is not among those of the model.
        """
        machine = next((one for one in machines if one.name == self.machine), None)
        if machine is None:
            raise InputError(f"targets are for machine {self.machine}; add --machine {self.machine}")
        times = [step_time(plan, machine, cycles) for plan in plans]
        walls = [1e3 * of["open walls"].total for of in times]
        memory = [max(plan.memory.max(), plan.start_memory.max()) / GIB for plan in plans]
        minutes = [(setup + plan.seconds) / 60 for plan in plans]
        at_most = (
            ("cells, Σ max ÷ Σ mean", self.cell_imbalance, [plan.cell_imbalance for plan in plans], ""),
            ("particles, most ÷ mean", self.particle_imbalance, [plan.particle_imbalance for plan in plans], ""),
            ("worst rank, start included", self.memory_gib, memory, " GiB"),
            ("open boundary", self.open_walls_ms, walls, " ms"),
            ("collectives per cycle", self.collectives_per_cycle, [p.most("cycle", "collectives") for p in plans], ""),
            ("a plan in", self.plan_minutes, minutes, " min"),
            ("with", self.plan_gib, [peak / GIB], " GiB"),
        )
        for what, limit, found, unit in at_most:
            if limit is not None:
                yield f"{what} ≤ {limit:g}{unit}", _span(found, unit), max(found) <= limit
        first = plans[0].ranks, total(times[0])
        for plan, of in zip(plans, times, strict=True):
            seconds, ranks = total(of), f"{plan.ranks}"
            if (least := self.efficiency.get(ranks)) is not None:
                found_here = efficiency(first, (plan.ranks, seconds))
                text = f"step ≥ {least:.0%} efficient at {plan.ranks:,}, from {first[0]:,}"
                yield text, f"{found_here:.0%}", found_here >= least
            if (most := self.step_ms.get(ranks)) is not None:
                yield f"step ≤ {most:g} ms at {plan.ranks:,}", f"{1e3 * seconds:.3g} ms", 1e3 * seconds <= most


def _span(values: Sequence[float], unit: str) -> str:
    low, high = f"{min(values):.3g}", f"{max(values):.3g}"
    return (low if low == high else f"{low} to {high}") + unit

"""What the stages of a step take: time, and what passes between ranks."""

from __future__ import annotations

import contextlib
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field

from ..parallel import Traffic, traffic
from ..progress import progress

WORKS = {  # what progress reports of stages
    "beam": "making particles",
    "migrate": "moving particles to their ranks",
    "regrid": "making the mesh",
    "deposit": "depositing charge",
    "solve": "solving for the potential",
    "push": "reading the field at particles and pushing them",
    "output": "writing files",
    "sample": "making points",
    "weigh": "weighing points",
    "equilibrium": "looking for equilibrium",
}


@dataclass(frozen=True)
class Spent:
    """What a rank spent on a stage."""

    seconds: float = 0.0
    traffic: Traffic = field(default_factory=Traffic)

    def __add__(self, other: Spent) -> Spent:
        return Spent(self.seconds + other.seconds, self.traffic + other.traffic)

    def __sub__(self, other: Spent) -> Spent:
        return Spent(self.seconds - other.seconds, self.traffic - other.traffic)


class Clock:
    """Adds up what stages take; that of a stage within another counts for the inner one alone.

    `now` gives the time in s since some time in the past. `before` is called with the name of each stage
    ahead of it, and counts for none.
    """

    def __init__(
        self, now: Callable[[], float] = time.perf_counter, before: Callable[[str], object] | None = None
    ) -> None:
        self.now, self.before = now, before
        self._stages: dict[str, Spent] = {}
        self._within: list[Spent] = []  # for each stage that runs, what stages within it have spent

    @contextlib.contextmanager
    def __call__(self, stage: str) -> Iterator[None]:
        entered = start = Spent(self.now(), traffic())
        if self.before is not None:
            self.before(stage)
            start = Spent(self.now(), traffic())
        self._within.append(Spent())
        try:
            with progress(WORKS.get(stage, stage)):
                yield
        finally:
            left = Spent(self.now(), traffic())
            self._stages[stage] = self._stages.get(stage, Spent()) + (left - start - self._within.pop())
            if self._within:
                self._within[-1] += left - entered

    def take(self) -> dict[str, Spent]:
        """Return what each stage took since the last call."""
        spent, self._stages = self._stages, {}
        return spent

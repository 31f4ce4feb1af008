"""A clock that adds up the seconds of the stages of a step."""

from __future__ import annotations

import contextlib
import time
from collections.abc import Iterator


class Clock:
    """Adds up the seconds of stages; those of a stage within another count for the inner one alone."""

    def __init__(self) -> None:
        self._seconds: dict[str, float] = {}
        self._within: list[float] = []  # for each stage that runs, the seconds of stages within it

    @contextlib.contextmanager
    def __call__(self, stage: str) -> Iterator[None]:
        start = time.perf_counter()
        self._within.append(0.0)
        try:
            yield
        finally:
            spent = time.perf_counter() - start
            self._seconds[stage] = self._seconds.get(stage, 0.0) + spent - self._within.pop()
            if self._within:
                self._within[-1] += spent

    def take(self) -> dict[str, float]:
        """Return the seconds per stage since the last call."""
        taken, self._seconds = self._seconds, {}
        return taken

"""What the program is doing, reported on standard error where nothing else was said for a while."""

from __future__ import annotations

import contextlib
import sys
import threading
import time
from collections.abc import Callable, Iterator
from typing import TextIO

from mpi4py import MPI

PATIENCE = 3.0  # s of silence before the first report; each next one waits twice as long
LONGEST = 60.0  # s of silence at most
PERIOD = 0.5  # s between looks at the clock


class Progress:
    """Knows what is being done and when something was said last. `now` gives the time in s since some time in the past."""

    def __init__(self, now: Callable[[], float] = time.monotonic) -> None:
        self._now = now
        self._works: list[tuple[str, float]] = []  # with their starts; the innermost is the last
        self.spoke()

    @contextlib.contextmanager
    def __call__(self, what: str) -> Iterator[None]:
        """Do what `what` names, as in "still making particles"."""
        self._works.append((what, self._now()))
        try:
            yield
        finally:
            self._works.pop()

    def spoke(self) -> None:
        """Take note that something was printed."""
        self._last, self._patience = self._now(), PATIENCE

    def line(self) -> str | None:
        """Return the line that is due now, if one is."""
        now, works = self._now(), self._works[-1:]  # a copy: the work may end at any moment
        if not works or now - self._last < self._patience:
            return None
        self._last, self._patience = now, min(2 * self._patience, LONGEST)
        what, since = works[0]
        return f"still {what}, {now - since:.0f} s so far"


progress = Progress()  # of this process


@contextlib.contextmanager
def reported(comm: MPI.Comm, out: TextIO | None = None) -> Iterator[None]:
    """Report progress on standard error, or on `out`, from rank 0, by a thread that calls nothing of MPI."""
    if comm.rank > 0:
        yield
        return
    over = threading.Event()

    def report() -> None:
        while not over.wait(PERIOD):
            if (line := progress.line()) is not None:
                try:
                    print(line, file=out or sys.stderr, flush=True)
                except (OSError, ValueError):  # full or closed
                    return

    thread = threading.Thread(target=report, name="progress", daemon=True)
    progress.spoke()
    thread.start()
    try:
        yield
    finally:
        over.set()
        thread.join()

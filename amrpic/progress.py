"""What the program is doing, reported on standard error where nothing else was said for a while.

The environment variable AMRPIC_PROGRESS takes another number of seconds than three, 0 for no reports.
"""

from __future__ import annotations

import contextlib
import math
import os
import sys
import threading
import time
from collections.abc import Callable, Iterator
from typing import TextIO

from .errors import InputError
from .mpi import MPI

VARIABLE = "AMRPIC_PROGRESS"
PATIENCE = 3.0  # s of silence before the first report; each next one waits twice as long
LONGEST = 60.0  # s of silence at most
PERIOD = 0.5  # s between looks at the clock


class Progress:
    """Knows what is being done and when something was said last. `now` gives the time in s since some time in the past."""

    def __init__(self, now: Callable[[], float] = time.monotonic) -> None:
        self._now = now
        self._first = PATIENCE
        self._works: list[tuple[str, float]] = []  # with their starts; the innermost is the last
        self.spoke()

    @contextlib.contextmanager
    def __call__(self, work: str) -> Iterator[None]:
        """Do what `work` names, as in "still making particles"."""
        self._works.append((work, self._now()))
        try:
            yield
        finally:
            self._works.pop()

    def wait(self, seconds: float) -> None:
        """Let the first report come after so many seconds of silence, from now on."""
        self._first = seconds
        self.spoke()

    def spoke(self) -> None:
        """Take note that something was printed."""
        self._last, self._patience = self._now(), self._first

    def line(self) -> str | None:
        """Return the line that is due now, if one is."""
        now, works = self._now(), self._works[-1:]  # a copy: the work may end at any moment
        if not works or now - self._last < self._patience:
            return None
        self._last, self._patience = now, min(2 * self._patience, max(LONGEST, self._first))
        work, since = works[0]
        return f"still {work}, {now - since:.0f} s so far"


progress = Progress()  # of this process


@contextlib.contextmanager
def reported(comm: MPI.Comm, out: TextIO | None = None) -> Iterator[None]:
    """Report progress on standard error, or on `out`, from rank 0, by a thread that calls nothing of MPI.

    Raises InputError on all ranks for a variable that is no number of seconds.
    """
    silence = _silence(os.environ.get(VARIABLE, str(PATIENCE)))
    if comm.rank > 0 or silence == 0:
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
    progress.wait(silence)
    thread.start()
    try:
        yield
    finally:
        over.set()
        thread.join()


def _silence(text: str) -> float:
    """Return the seconds that a text gives."""
    with contextlib.suppress(ValueError):
        if 0 <= (seconds := float(text)) < math.inf:
            return seconds
    raise InputError(f'{VARIABLE} is "{text}"; give seconds of silence before a report, or 0 for none')

"""When a run should stop before its end: signals, and the time that a batch job has."""

from __future__ import annotations

import contextlib
import os
import signal
import time
from pathlib import Path
from types import FrameType
from typing import Any

from ..failure import discard_unread
from ..mpi import MPI

SIGNALS = (
    signal.SIGUSR1,  # a batch system's warning ahead of time
    signal.SIGTERM,  # seconds before it kills; also what mpiexec makes of Ctrl-C
    signal.SIGHUP,  # the terminal was closed
    signal.SIGINT,  # Ctrl-C without mpiexec; the second one interrupts at once
)
BY_CLOCK, BY_FILE = 100, 101  # why to stop, above the numbers of all signals
MARGIN = 1.5  # a step may take so much longer than the longest one so far


class Stop:
    """Remembers signals, looks for a file that asks to stop, and knows how long the run may still last.

    To be entered before the first step. A TERM at Open MPI's mpiexec leaves the ranks one second only, unless its parameter
    odls_base_sigkill_timeout is longer; USR1 at mpiexec leaves all the time there is.
    """

    def __init__(self, comm: MPI.Comm, walltime: float | None = None, file: Path | None = None) -> None:
        """`walltime` is in s from the start of this process; SLURM_JOB_END_TIME counts as well, if it is a time.

        A run that a `file` stops takes it away.
        """
        self._comm, self._file = comm, file
        self._signal = 0
        self._old: dict[int, Any] = {}
        ends = [_process_start() + walltime] if walltime is not None else []
        with contextlib.suppress(ValueError):  # "Unknown", or none
            ends.append(float(os.environ.get("SLURM_JOB_END_TIME", "")))
        self._end = min(ends, default=float("inf"))
        self._last = time.time()
        self._longest = 0.0

    def __enter__(self) -> Stop:
        for number in SIGNALS:
            with contextlib.suppress(ValueError):  # not the main thread, which alone may handle signals
                self._old[number] = signal.signal(number, self._note)
        return self

    def __exit__(self, *_: object) -> None:
        for number, handler in self._old.items():
            signal.signal(number, handler or signal.SIG_DFL)  # None: it was set outside Python

    def reason(self) -> str | None:
        """Return why to stop now, None to go on; the same on all ranks. Collective, once per step."""
        now = time.time()
        self._longest, self._last = max(self._longest, now - self._last), now
        out_of_time = now + MARGIN * self._longest > self._end
        reasons = self._signal, BY_CLOCK * out_of_time, BY_FILE * self._asked_by_file()
        number = self._comm.allreduce(max(reasons), op=MPI.MAX)
        if number == BY_FILE:
            return f"the file {self._file} asks for it"
        if number == BY_CLOCK:
            return "the time given is nearly over"
        return f"signal {signal.Signals(number).name}" if number else None

    def _asked_by_file(self) -> bool:
        if self._file is None or self._comm.rank != 0:
            return False
        try:
            self._file.unlink()
        except OSError:
            return False
        return True

    def _note(self, number: int, frame: FrameType | None) -> None:
        self._signal = number
        discard_unread()
        if number == signal.SIGINT:
            signal.signal(number, signal.default_int_handler)


def _process_start() -> float:
    """Return when this process started, s since the epoch."""
    try:
        with open("/proc/self/stat") as file:
            ticks = int(file.read().rpartition(")")[2].split()[19])
        with open("/proc/uptime") as file:
            uptime = float(file.read().split()[0])
        return time.time() - uptime + ticks / os.sysconf("SC_CLK_TCK")
    except (OSError, ValueError, IndexError):
        return time.time()

"""The run log: one plain line per step, each warning once. The only place that prints while a run goes on."""

from __future__ import annotations

import contextlib
import logging
import sys
import warnings
from collections import Counter
from collections.abc import Callable, Mapping
from datetime import timedelta
from typing import Any, Literal, TextIO

from ..failure import discard, printable
from ..mpi import MPI
from ..progress import progress

Log = Literal["print", "logging", "silent"]
StepLine = Callable[[Mapping[str, float], int, float], str]  # of a row, the last step, seconds left
LOGGER = logging.getLogger("amrpic.run")
MEMORY_OF_PACE = 0.2  # weight of the newest step in the smoothed seconds per step


class RunLog:
    """Speaks on rank 0 and is silent on all others. A context manager, in which Python's warnings come here as well.

    Plain lines in any case: under MPI every rank believes that it writes to a terminal. If they are printed, steps go to `out`
    and warnings to `err`, which are standard output and standard error by default. `line` makes the line of a step.
    """

    def __init__(
        self,
        comm: MPI.Comm,
        last_step: int,
        out: TextIO | None = None,
        err: TextIO | None = None,
        how: Log = "print",
        line: StepLine | None = None,
    ) -> None:
        self._line = line or step_line
        self._speaks = comm.rank == 0 and how != "silent"
        self._logs = how == "logging"
        self._last_step = last_step
        self._out, self._err = out, err
        self.pace = 0.0  # s per step, smoothed
        self._lines = 0
        self.warned: Counter[str] = Counter()
        self._catching = warnings.catch_warnings()

    def __enter__(self) -> RunLog:
        self._catching.__enter__()
        warnings.simplefilter("always", UserWarning)
        warnings.showwarning = lambda message, *_args, **_options: self.warn(str(message))
        return self

    def __exit__(self, *failure: Any) -> None:
        self._catching.__exit__(*failure)
        for text, times in self.warned.items():
            if times > 1:
                self._say(f"warning, {times} times in all: {text}", logging.WARNING)

    def step(self, row: Mapping[str, float]) -> None:
        """Print the line of a step, from its row of the time series."""
        seconds = row["seconds"]
        # the first line's seconds hold the set-up, so the second one starts the pace anew
        weight = MEMORY_OF_PACE if self._lines >= 2 else 1.0
        self.pace += weight * (seconds - self.pace)
        self._lines += 1
        last = int(row.get("last_step", self._last_step))  # runs that choose their steps find it as they go
        left = max(last - int(row["step"]), 0) * self.pace
        self._say(self._line(row, last, left))

    def note(self, text: str) -> None:
        """Print a line that belongs to no step."""
        self._say(text)

    def warn(self, text: str) -> None:
        """Print a warning when it comes up first; the end reports how often it did."""
        self.warned[text] += 1
        if self.warned[text] == 1:
            self._say(f"warning: {text}", logging.WARNING)

    def _say(self, line: str, level: int = logging.INFO) -> None:
        if self._speaks and self._logs:
            LOGGER.log(level, line.removeprefix("warning: "))
        elif self._speaks and level == logging.WARNING:
            self._print(line, self._err or sys.stderr)
        elif self._speaks:
            self._print(line, self._out or sys.stdout)

    def _print(self, line: str, stream: TextIO) -> None:
        """Print a line; a stream that takes no more, as on a full disk, does not end a run."""
        try:
            print(printable(line, stream), file=stream, flush=True)
            progress.spoke()
        except OSError as error:
            self._speaks = False
            discard(stream)
            if stream is not sys.stderr:
                reason = f"warning: the log cannot be written ({error.strerror}); the run goes on without it"
                with contextlib.suppress(OSError):
                    print(reason, file=sys.stderr, flush=True)


def step_line(row: Mapping[str, float], last_step: int, seconds_left: float) -> str:
    """Return the line of a step of particles: its time, the mesh, the particles, the solve."""
    cells = [value for name, value in row.items() if name.startswith("cells_")]
    return line_of(
        row,
        last_step,
        seconds_left,
        f"t {row['time']:.4e} s",
        f"{len(cells)} levels {row['boxes']:.0f} boxes {sum(cells):.0f} cells",
        f"{row['particles']:.0f} particles {row['lost_particles']:.0f} lost",
        f"{row['cycles']:.0f} cycles {row['residual']:.1e}",
    )


def line_of(row: Mapping[str, float], last_step: int, seconds_left: float, *columns: str) -> str:
    """Return the line of a step: its number, what was `columns`, the pace and the memory."""
    width = len(str(last_step))
    return "  ".join(
        [
            f"step {row['step']:{width}.0f}/{last_step}",
            *columns,
            f"{row['seconds']:.3g} s/step",
            f"ETA {timedelta(seconds=round(seconds_left))}",
            f"{row['memory'] / 2**20:.0f} MiB",
        ]
    )

"""The end of a run that failed: one sentence, printed once, and no rank that waits for another."""

from __future__ import annotations

import contextlib
import errno
import io
import os
import select
import sys
import time
import traceback
from types import TracebackType
from typing import NoReturn, TextIO

from .errors import AmrpicError, HierarchyError, InputError, SceneError
from .mpi import MPI

BAD_INPUT = 2  # exit status of what the user can correct in the input; any other failure is 1
NOT_PRINTED = (errno.ENOSPC, errno.EPIPE, errno.EIO, errno.EBADF)  # what printing may meet; files have names besides
GRACE = 3.0  # s; ranks that raise together get here within milliseconds of each other
LOOK = 0.01  # s that a look at the others counts for at most


class Meeting:
    """Where failing ranks meet. Collective to make, before anything can fail."""

    def __init__(self, comm: MPI.Comm) -> None:
        # A communicator of its own: the others may be amid a collective on the common one.
        self._comm = comm.Dup() if comm.size > 1 else MPI.COMM_SELF

    def report(self, failure: BaseException, text: str) -> int:
        """Print what failed and return the exit status. Called by each rank that fails.

        If all ranks come, rank 0 speaks for them. A rank that failed alone speaks for itself and ends all of them.
        """
        status = BAD_INPUT if isinstance(failure, SceneError | InputError | HierarchyError) else 1
        if not is_over(self._comm.Ibarrier(), GRACE):
            end_alone(self._comm, text, status)
        if self._comm.rank == 0:
            say(text)
        self._comm.Barrier()  # mpiexec ends the others when the first one exits, so rank 0 must have spoken
        if self._comm.size < MPI.COMM_WORLD.size:
            self._comm.Abort(status)  # ranks that were not invited must not wait either
        return status


def is_over(collective: MPI.Request, patience: float) -> bool:
    """Return whether all ranks have come to a collective call within `patience` s.

    Time in which this process did not run counts little: where its job was suspended, the others have had as much less.
    """
    waited, latest = 0.0, time.monotonic()
    while not (over := collective.Test()) and waited < patience:
        time.sleep(1e-4)
        now = time.monotonic()
        waited, latest = waited + min(now - latest, LOOK), now
    return over


def printable(text: str, stream: TextIO) -> str:
    """Return a text with question marks for what the encoding of a stream does not have, as Greek letters in Latin-1."""
    encoding = getattr(stream, "encoding", None) or "utf-8"
    return text.encode(encoding, "replace").decode(encoding)


def replace_unprintable() -> None:
    """Let standard output and error take any text in any encoding, with question marks where they have no letter."""
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, io.TextIOWrapper):
            stream.reconfigure(errors="replace")


def say(text: str) -> None:
    """Print on stderr, after all that was printed before."""
    for stream, words in ((sys.stdout, ""), (sys.stderr, f"{text}\n")):
        try:
            stream.write(printable(words, stream))
            stream.flush()
        except OSError:
            discard(stream)


def discard(stream: TextIO) -> None:
    """Let what a stream still has to write, and all that comes, go nowhere: else Python's end would fail on it."""
    with contextlib.suppress(OSError):
        os.dup2(os.open(os.devnull, os.O_WRONLY), stream.fileno())


def discard_unread() -> None:
    """Let standard output and error go nowhere where nobody reads them: what waits for its reader waits no longer.

    After Ctrl-C Open MPI's mpiexec reads no more, and a run that printed on would hang before its last checkpoint.
    """
    for stream in (sys.stdout, sys.stderr):
        with contextlib.suppress(OSError, ValueError, AttributeError):  # closed, none, or not a file
            if not select.select([], [stream], [], 0.0)[1]:
                discard(stream)


def end_alone(comm: MPI.Comm, text: str, status: int) -> NoReturn:
    """Print what failed on this rank alone, and end all ranks with it."""
    say(f"{text} (on rank {comm.rank} of {comm.size} alone)")
    comm.Abort(status)
    raise SystemExit(status)  # Abort does not return


def sentence(failure: BaseException) -> str:
    """Return what failed as one sentence on one line."""
    text = " ".join(str(failure).split())
    if isinstance(failure, AmrpicError):
        return f"amrpic: {text}"
    if isinstance(failure, KeyboardInterrupt):
        return "amrpic: interrupted"
    if isinstance(failure, OSError) and failure.filename is None and failure.errno in NOT_PRINTED:
        return f"amrpic: standard output cannot be written: {failure.strerror}; give it to a file or pipe that takes it"
    if isinstance(failure, MemoryError):
        return f"amrpic: out of memory ({text}); use fewer cells or particles, or more machines"
    return f"amrpic: unexpected {type(failure).__name__}: {text}; run again with --traceback and report it"


def end_scripts_together(meeting: Meeting) -> None:
    """Let a script end on all ranks when one of them meets an exception that the script does not catch.

    An error of amrpic's own is one sentence that names the script's line; of any other the traceback comes before. Without
    this, the other ranks would wait for the failed one for ever.
    """

    def hook(kind: type[BaseException], failure: BaseException, trace: TracebackType | None) -> None:
        if isinstance(failure, AmrpicError):
            where = traceback.extract_tb(trace)
            text = sentence(failure) + (f" [{where[0].filename}, line {where[0].lineno}]" if where else "")
        else:
            lines = traceback.format_exception(kind, failure, trace)
            text = f"{''.join(lines)}amrpic: the script ended with {kind.__name__}"
        meeting.report(failure, text)

    sys.excepthook = hook

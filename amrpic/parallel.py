"""What ranks do together: shares of rows, sums over ranks, and errors that all ranks raise together."""

from __future__ import annotations

import contextlib
import sys
import traceback
from collections.abc import Iterator
from types import TracebackType

import numpy as np
from mpi4py import MPI

from .errors import AmrpicError


def raise_together(comm: MPI.Comm, message: str | None, error: type[Exception] = AmrpicError) -> None:
    """Raise `error` with the lowest failing rank's message on every rank; return if no rank has one. Collective."""
    failing = comm.allreduce(comm.rank if message is not None else comm.size, op=MPI.MIN)
    if failing == comm.size:
        return
    raise error(comm.bcast(message, root=failing))


@contextlib.contextmanager
def together(comm: MPI.Comm, error: type[Exception] = AmrpicError) -> Iterator[None]:
    """Run a block that does not communicate; an exception in it on some ranks becomes `error` on all. Collective.

    An `AmrpicError` keeps its own type; any other exception's type is named in the message.
    """
    failure: Exception | None = None
    try:
        yield
    except Exception as caught:
        failure = caught
    failing = comm.allreduce(comm.rank if failure is not None else comm.size, op=MPI.MIN)
    if failing == comm.size:
        return
    kind: type[Exception] = type(failure) if isinstance(failure, AmrpicError) else error
    message = str(failure) if isinstance(failure, AmrpicError) else f"{type(failure).__name__}: {failure}"
    kind, message = comm.bcast((kind, message), root=failing)
    raise kind(message) from failure


def share(comm: MPI.Comm, count: int) -> tuple[int, int]:
    """Return where this rank's equal share of so many rows starts and stops."""
    return count * comm.rank // comm.size, count * (comm.rank + 1) // comm.size


def global_sum(comm: MPI.Comm, value: float) -> float:
    """Return the sum of `value` over all ranks. Collective."""
    return comm.allreduce(value, op=MPI.SUM)


def global_max(comm: MPI.Comm, value: float) -> float:
    """Return the largest `value` of all ranks; nan if any rank holds nan. Collective."""
    values = comm.allgather(float(value))
    return float(np.max(values))


def install_abort_hook(comm: MPI.Comm) -> None:
    """End all ranks when one of them dies of an exception that nobody caught.

    Without it the other ranks would wait for the dead one for ever.
    """
    if comm.size == 1:
        return

    def hook(kind: type[BaseException], value: BaseException, trace: TracebackType | None) -> None:
        sys.stderr.write(f"rank {comm.rank} of {comm.size} failed:\n")
        traceback.print_exception(kind, value, trace)
        sys.stdout.flush()
        sys.stderr.flush()
        comm.Abort(1)

    sys.excepthook = hook

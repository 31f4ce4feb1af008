"""What ranks do together: shares of rows, sums over ranks, and errors that all ranks raise together."""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Any, TypeVar, cast

import numpy as np
from mpi4py import MPI

from . import _native
from .errors import AmrpicError
from .failure import BAD_INPUT, GRACE, Meeting, end_alone, end_scripts_together, is_over


class Communicator(MPI.Intracomm):
    """A communicator of the library's own: no message of the user's can be taken for one of ours, and calls are counted."""


def _counted(name: str) -> Callable[..., Any]:
    call = getattr(MPI.Intracomm, name)

    def counting(self: Communicator, *given: Any, **named: Any) -> Any:
        if self.size > 1:
            _native.count_collective()
        return call(self, *given, **named)

    counting.__name__, counting.__doc__ = name, call.__doc__
    return counting


T = TypeVar("T")


@dataclass(frozen=True)
class VirtualRank:
    """One of any number of ranks that need not exist, in place of a communicator.

    What follows from metadata alone is the same as on a real rank. What it sends is counted and goes nowhere, and what all
    ranks hold together is its own part alone: what a real rank does can be gone through for its traffic, with wrong numbers.
    """

    rank: int
    size: int

    def _count(self) -> None:
        if self.size > 1:
            _native.count_collective()

    def allreduce(self, value: T, op: MPI.Op = MPI.SUM) -> T:
        self._count()
        return value

    def Allreduce(self, given: Any, all_: np.ndarray, op: MPI.Op = MPI.SUM) -> None:
        self._count()
        if given is not MPI.IN_PLACE:
            all_[...] = given

    def allgather(self, value: T) -> list[T]:
        self._count()
        return [value]

    def bcast(self, value: T, root: int = 0) -> T:
        self._count()
        return value

    def Barrier(self) -> None:
        self._count()


COLLECTIVES = ("allreduce", "Allreduce", "allgather", "Allgather", "gather", "bcast", "Barrier")  # those that we use
for _name in COLLECTIVES:
    setattr(Communicator, _name, _counted(_name))

_OWN = MPI.Comm.Create_keyval(delete_fn=lambda comm, key, mine: mine.Free())


def own(comm: MPI.Comm) -> Communicator:
    """Return the library's duplicate of a communicator, made at the first call and freed with it. Collective.

    From then on a failure of MPI on it ends the job with one sentence, as does an exception that a script does not catch on
    some of several ranks.
    """
    if isinstance(comm, Communicator):
        return comm
    mine = cast(Communicator | None, comm.Get_attr(_OWN))
    if mine is None:
        mine = Communicator(comm.Dup())
        comm.Set_attr(_OWN, mine)
        _native.end_job_on_failure(mine.py2f())
        if mine.size > 1:
            end_scripts_together(Meeting(mine))
    return mine


@dataclass(frozen=True)
class Traffic:
    """What this process has sent to other ranks, and the collective calls that it took part in."""

    messages: int = 0
    bytes: int = 0
    collectives: int = 0

    def __sub__(self, other: Traffic) -> Traffic:
        return Traffic(self.messages - other.messages, self.bytes - other.bytes, self.collectives - other.collectives)

    def __add__(self, other: Traffic) -> Traffic:
        return Traffic(self.messages + other.messages, self.bytes + other.bytes, self.collectives + other.collectives)


def traffic() -> Traffic:
    """Return the traffic of this process so far; what Trilinos and HDF5 send by themselves is not counted."""
    return Traffic(*_native.traffic())


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


def call_together(comm: MPI.Comm, call: Callable[[], T], error: type[Exception], what: str) -> T:
    """Return what `call` gives, which may communicate; an exception in it on some ranks becomes `error` on all. Collective.

    Ranks that still wait for a failed one within the call are ended with it, with one sentence.
    """
    failure, message = None, None
    try:
        value = call()
    except Exception as caught:
        failure, message = caught, f"{what} ({type(caught).__name__}: {caught})"
    mine, first = np.array(comm.rank if failure is not None else comm.size), np.empty((), dtype=int)
    meeting = comm.Iallreduce(mine, first, op=MPI.MIN)
    if not is_over(meeting, np.inf if failure is None else GRACE):
        end_alone(comm, f"amrpic: {message}", BAD_INPUT)
    if first == comm.size:
        return value
    raise error(comm.bcast(message, root=int(first))) from failure


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

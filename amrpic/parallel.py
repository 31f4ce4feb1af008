"""What ranks do together: shares of rows, sums over ranks, and errors that all ranks raise together."""

from __future__ import annotations

import contextlib
import functools
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from typing import Any, TypeVar, cast

import numpy as np

from . import _native
from .errors import AmrpicError
from .failure import BAD_INPUT, GRACE, Meeting, end_alone, end_scripts_together, is_over
from .mpi import MPI


class Communicator(MPI.Intracomm):
    """A communicator of the library's own: no message of the user's can be taken for one of ours, and calls are counted."""

    def allreduce(self, sendobj: Any, op: Any = MPI.SUM) -> Any:
        """Return a number or an array of numbers reduced over all ranks. Collective.

        They pass as double precision, in one reduction; mpi4py's own method would pickle them, and reduce and broadcast them by
        messages. Whole numbers stay so, to 2^53. Ranks may mix them with others, as an empty sum is one.
        """
        own_values = np.asarray(sendobj)
        logical = op in (MPI.LAND, MPI.LOR)
        kind = np.intc if logical else np.complex128 if own_values.dtype.kind == "c" else np.float64
        values = np.array(own_values, dtype=kind, order="C")
        self.Allreduce(MPI.IN_PLACE, values, op)
        if logical:
            values = values.astype(bool)
        elif own_values.dtype.kind in "biu" and np.array_equal(values, np.rint(values)):
            values = values.astype(np.int64)
        return values if isinstance(sendobj, np.ndarray) else values.item()


def _counted(name: str) -> Callable[..., Any]:
    call = getattr(MPI.Intracomm, name)

    def counting(self: Communicator, *arguments: Any, **named: Any) -> Any:
        if self.size > 1:
            _native.count_collective()
        return call(self, *arguments, **named)

    counting.__name__, counting.__doc__ = name, call.__doc__
    return counting


T = TypeVar("T")


COLLECTIVES = ("Allreduce", "allgather", "Allgather", "gather", "bcast", "Barrier")  # those that we use
for _name in COLLECTIVES:
    setattr(Communicator, _name, _counted(_name))

_OWN = MPI.Comm.Create_keyval(delete_fn=lambda comm, key, duplicate: duplicate.Free())


def own(comm: MPI.Comm) -> Communicator:
    """Return the library's duplicate of a communicator, made at the first call and freed with it. Collective.

    From then on a failure of MPI on it ends the job with one sentence, as does an exception that a script does not catch on
    some of several ranks. What stands in for a communicator is taken as it is.
    """
    if isinstance(comm, Communicator) or not isinstance(comm, MPI.Comm):
        return comm
    duplicate = cast(Communicator | None, comm.Get_attr(_OWN))
    if duplicate is None:
        duplicate = Communicator(comm.Dup())
        comm.Set_attr(_OWN, duplicate)
        _native.end_job_on_failure(duplicate.py2f())
        if duplicate.size > 1:
            end_scripts_together(Meeting(duplicate))
    return duplicate


def world_by_default(method: Callable[..., T]) -> Callable[..., T]:
    """Let a method's communicator, its first argument, be left out for that of all ranks."""

    @functools.wraps(method)
    def call(self: Any, *arguments: Any, **named: Any) -> T:
        if "comm" not in named and not (arguments and hasattr(arguments[0], "py2f")):
            arguments = (MPI.COMM_WORLD, *arguments)
        return method(self, *arguments, **named)

    return call


_NODE = MPI.Comm.Create_keyval(delete_fn=lambda comm, key, node: node.Free())


def node_of(comm: MPI.Comm) -> MPI.Intracomm:
    """Return the ranks that share this one's memory, made at the first call and freed with the communicator. Collective."""
    node = cast(MPI.Intracomm | None, comm.Get_attr(_NODE))
    if node is None:
        node = cast(MPI.Intracomm, comm.Split_type(MPI.COMM_TYPE_SHARED))
        comm.Set_attr(_NODE, node)
    return node


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
    if isinstance(failure, AmrpicError) and failing == comm.rank:
        raise failure
    raise kind(message) from failure


def call_together(comm: MPI.Comm, call: Callable[[], T], error: type[Exception], failed: str) -> T:
    """Return what `call` gives, which may communicate; an exception in it on some ranks becomes `error` on all. Collective.

    Ranks that still wait for a failed one within the call are ended with it, with one sentence.
    """
    failure, message = None, None
    try:
        value = call()
    except Exception as caught:
        failure, message = caught, f"{failed} ({type(caught).__name__}: {caught})"
    own_failure, first = np.array(comm.rank if failure is not None else comm.size), np.empty((), dtype=int)
    meeting = comm.Iallreduce(own_failure, first, op=MPI.MIN)
    if not is_over(meeting, np.inf if failure is None else GRACE):
        end_alone(comm, f"amrpic: {message}", BAD_INPUT)
    if first == comm.size:
        return value
    raise error(comm.bcast(message, root=int(first))) from failure


def from_rank_0(comm: MPI.Comm, call: Callable[[], T], error: type[Exception] = AmrpicError) -> T:
    """Return on all ranks what `call` gives on rank 0, which alone calls it, as to read a file. Collective.

    An exception becomes `error` on all ranks, as in `together`.
    """
    value = None
    with together(comm, error):
        if comm.rank == 0:
            value = call()
    return cast(T, comm.bcast(value))


def share(comm: MPI.Comm, count: int) -> tuple[int, int]:
    """Return where this rank's equal share of so many rows starts and stops."""
    return count * comm.rank // comm.size, count * (comm.rank + 1) // comm.size


def global_sum(comm: MPI.Comm, value: float) -> float:
    """Return the sum of `value` over all ranks. Collective."""
    return comm.allreduce(value, op=MPI.SUM)


def global_norm(comm: MPI.Comm, values: np.ndarray) -> float:
    """Return the root of the sum of squares of all ranks' numbers. Collective."""
    return float(np.sqrt(global_sum(comm, float((values**2).sum()))))


def global_max(comm: MPI.Comm, value: float) -> float:
    """Return the largest `value` of all ranks; nan if any rank holds nan. Collective."""
    missing = bool(np.isnan(value))
    values = np.array([-np.inf if missing else value, missing])
    comm.Allreduce(MPI.IN_PLACE, values, MPI.MAX)
    return float("nan") if values[1] else float(values[0])


def global_sums_and_largest(
    comm: MPI.Comm, summed: Mapping[str, float], compared: Mapping[str, float]
) -> dict[str, float]:
    """Return the sum over all ranks of each of some numbers, and the largest of others, in one reduction. Collective."""
    reduced = _native.sums_and_largest(comm.py2f(), list(summed.values()), list(compared.values()))
    return dict(zip([*summed, *compared], reduced, strict=True))

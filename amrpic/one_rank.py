"""What of mpi4py's MPI is used here, for a process that is alone: nothing is sent, and all ranks hold what this one does."""

from __future__ import annotations

import os
import sys
from collections.abc import Callable
from typing import Any, NoReturn

import numpy as np

HANDLE = 0x44000000  # MPI_COMM_WORLD, as MPICH and what was compiled for it have it
IN_PLACE: Any = object()
COMM_TYPE_SHARED = 0


class Op:
    """A reduction, of which one rank has nothing to do."""

    @classmethod
    def Create(cls, function: Callable[..., None], commute: bool = False) -> Op:
        return cls()


SUM, MIN, MAX, LAND, LOR = (Op() for _ in range(5))


class Datatype:
    """A type of numbers."""

    def Create_contiguous(self, count: int) -> Datatype:
        return self

    def Commit(self) -> Datatype:
        return self


BYTE, INT, INT64_T, DOUBLE = (Datatype() for _ in range(4))


class FinishedRequest:
    """A communication that is over."""

    def Test(self) -> bool:
        return True

    def Wait(self) -> bool:
        return True


REQUEST_NULL = FinishedRequest()


class Comm:
    """The one process."""

    rank, size = 0, 1

    def __init__(self, comm: Comm | None = None) -> None:
        self._attributes: dict[int, Any] = {}

    def Dup(self) -> Comm:
        return type(self)()

    def Free(self) -> None:
        self._attributes.clear()

    def Split_type(self, kind: int) -> Comm:
        return Intracomm()

    def py2f(self) -> int:
        return HANDLE

    def Abort(self, status: int = 1) -> NoReturn:
        sys.stdout.flush()
        sys.stderr.flush()
        os._exit(status)

    @staticmethod
    def Create_keyval(**_: Any) -> int:
        Comm._keys += 1
        return Comm._keys

    _keys = 0

    def Get_attr(self, key: int) -> Any:
        return self._attributes.get(key)

    def Set_attr(self, key: int, value: Any) -> None:
        self._attributes[key] = value

    # ---- objects ----
    def allreduce(self, value: Any, op: Op = SUM) -> Any:
        return value

    def bcast(self, value: Any, root: int = 0) -> Any:
        return value

    def gather(self, value: Any, root: int = 0) -> list[Any]:
        return [value]

    def allgather(self, value: Any) -> list[Any]:
        return [value]

    def alltoall(self, values: list[Any]) -> list[Any]:
        return list(values)

    def Barrier(self) -> None:
        pass

    barrier = Barrier

    def Ibarrier(self) -> FinishedRequest:
        return REQUEST_NULL

    # ---- arrays, alone or at the head of a list with their counts and types ----
    def Allreduce(self, sent: Any, received: Any, op: Op = SUM) -> None:
        if sent is not IN_PLACE:
            _array(received)[...] = _array(sent).reshape(_array(received).shape)

    def Iallreduce(self, sent: Any, received: Any, op: Op = SUM) -> FinishedRequest:
        self.Allreduce(sent, received)
        return REQUEST_NULL

    Allgather = Alltoall = Alltoallv = Allreduce


class Intracomm(Comm):
    """The one process."""


def _array(values: Any) -> np.ndarray:
    return np.asarray(values[0] if isinstance(values, list | tuple) else values)


COMM_WORLD, COMM_SELF = Intracomm(), Intracomm()


def Get_library_version() -> str:
    return "none: one rank alone"

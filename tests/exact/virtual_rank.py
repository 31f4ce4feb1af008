"""One of any number of ranks that need not exist: what it would do and send, gone through on one that does."""

from __future__ import annotations

import copy
from dataclasses import dataclass
from typing import Any, TypeVar, cast

import numpy as np

from amrpic import _native
from amrpic.errors import AmrpicError, HierarchyError
from amrpic.mesh.hierarchy import Hierarchy
from amrpic.mpi import MPI
from amrpic.parallel import Communicator

T = TypeVar("T")


@dataclass(frozen=True)
class VirtualRank:
    """A rank in place of a communicator.

    What follows from metadata alone is the same as on a real rank. What it sends is counted and goes nowhere, and what all
    ranks hold together is its own part alone: what a real rank does can be gone through for its traffic, with wrong numbers.
    AmrpicError for what is not counted.
    """

    rank: int
    size: int

    def py2f(self) -> tuple[int, int]:
        """Return what native functions take in place of a communicator's handle."""
        return self.rank, self.size

    def _count(self) -> None:
        if self.size > 1:
            _native.count_collective()

    def allreduce(self, value: T, op: MPI.Op = MPI.SUM) -> T:
        self._count()
        return value

    def Allreduce(self, own_values: Any, all_: np.ndarray, op: MPI.Op = MPI.SUM) -> None:
        self._count()
        if own_values is not MPI.IN_PLACE:
            all_[...] = own_values

    def allgather(self, value: T) -> list[T]:
        self._count()
        return [value]

    def bcast(self, value: T, root: int = 0) -> T:
        self._count()
        return value

    def Barrier(self) -> None:
        self._count()

    def __getattr__(self, name: str) -> Any:
        if name.startswith("__"):
            raise AttributeError(name)
        raise AmrpicError(f"rank {self.rank} of {self.size} is virtual and has no {name}; run this under mpiexec")


def seen_by(mesh: Hierarchy, rank: int) -> Hierarchy:
    """Return the hierarchy of a virtual rank as another virtual rank of as many has it. Local.

    Much faster than to make it anew. HierarchyError if the ranks are real.
    """
    out = copy.copy(mesh)
    for follows in ("particle_mesh", "own_cells"):
        out.__dict__.pop(follows, None)
    try:
        out.native = mesh.native.seen_by(rank)
    except _native.HierarchyError as refused:
        raise HierarchyError(str(refused)) from None
    out.comm = cast(Communicator, VirtualRank(rank, mesh.comm.size))
    return out

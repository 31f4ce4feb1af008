"""Rows of distributed arrays, handed to a few writers in pieces of bounded size."""

from __future__ import annotations

import itertools
from collections.abc import Callable, Sequence
from typing import Any, Protocol, TypeVar

import numpy as np
from mpi4py import MPI
from numpy.typing import NDArray

from ..errors import AmrpicError, OutputError
from ..parallel import raise_together

PIECE_BYTES = 16 * 2**20  # memory of a writer beyond its own data
TAG = 731

Result = TypeVar("Result")


class Rows(Protocol):
    """What is collected: an array, or anything that has its type and shape and can be sliced along the rows."""

    @property
    def dtype(self) -> np.dtype[Any]: ...
    @property
    def shape(self) -> tuple[int, ...]: ...
    def __getitem__(self, rows: slice, /) -> NDArray[Any]: ...


class Interleaved:
    """Columns of equal length as the rows of one (n, columns) array, of which only slices are ever made."""

    def __init__(self, columns: Sequence[NDArray[Any]]) -> None:
        self._columns = columns
        self.dtype = columns[0].dtype
        self.shape = (len(columns[0]), len(columns))

    def __getitem__(self, rows: slice, /) -> NDArray[Any]:
        return np.stack([column[rows] for column in self._columns], axis=1)


class Attempts:
    """Acts that may fail on one rank while others wait for it: the first failure is kept, later acts are skipped.

    A writer goes on receiving after a failure, so that nobody hangs; `settle` then raises on all ranks.
    """

    def __init__(self, purpose: str, remedy: str) -> None:
        self._purpose, self._remedy = purpose, remedy
        self.message: str | None = None

    def attempt(self, act: Callable[..., Result], *arguments: Any) -> Result | None:
        """Return what `act` returns; nothing if it fails or an act before it failed."""
        if self.message is not None:
            return None
        try:
            return act(*arguments)
        except (OSError, RuntimeError, ValueError, KeyError, AmrpicError) as error:
            self.message = f"{self._purpose}: {one_line(error)}; {self._remedy}"
            return None

    def always(self, act: Callable[[], object]) -> None:
        """Do what must also be done after a failure, such as closing a file."""
        before, self.message = self.message, None
        self.attempt(act)
        self.message = before or self.message

    def settle(self, comm: MPI.Comm, error: type[Exception] = OutputError) -> None:
        """Raise `error` on all ranks if an act failed on any of them. Collective."""
        raise_together(comm, self.message, error)


def one_line(error: BaseException) -> str:
    """Return the reason of an exception as part of one sentence."""
    text = str(error.strerror if isinstance(error, OSError) and error.strerror else error)
    return " ".join(text.split()).rstrip(".") or type(error).__name__


def writer_groups(ranks: int, writers: int) -> list[range]:
    """Return contiguous groups of ranks, `writers` of them (0: one per rank); the first rank of each writes for it."""
    groups = min(writers, ranks) or ranks
    edges = [ranks * g // groups for g in range(groups + 1)]
    return [range(first, last) for first, last in itertools.pairwise(edges)]


def group_of(groups: Sequence[range], rank: int) -> int:
    """Return the index of the group that holds `rank`."""
    return next(index for index, group in enumerate(groups) if rank in group)


def collect(
    comm: MPI.Comm, group: range, counts: Sequence[int], rows: Rows, write: Callable[[int, NDArray[Any]], object]
) -> None:
    """Hand the rows of every rank of `group` to `write(offset, piece)` on its first rank, in the order of ranks.

    Collective over the group. `counts[rank]` is the number of rows of each rank of the communicator. `write` must
    not raise, because the others wait: see `Attempts`.
    """
    row_bytes = rows.dtype.itemsize * int(np.prod(rows.shape[1:], dtype=np.int64))
    piece_rows = max(1, PIECE_BYTES // max(1, row_bytes))
    if comm.rank != group.start:
        for start in range(0, counts[comm.rank], piece_rows):
            # Synchronous: a rank's rows wait where they are, not in the writer's message buffers.
            comm.Ssend([np.ascontiguousarray(rows[start : start + piece_rows]), MPI.BYTE], group.start, TAG)
        return
    longest = min(piece_rows, max((counts[rank] for rank in group if rank != comm.rank), default=0))
    buffer = np.empty((longest, *rows.shape[1:]), rows.dtype)
    offset = 0
    for rank in group:
        for start in range(0, counts[rank], piece_rows):
            length = min(piece_rows, counts[rank] - start)
            if rank == comm.rank:
                piece = rows[start : start + length]
            else:
                piece = buffer[:length]
                comm.Recv([piece, MPI.BYTE], rank, TAG)
            write(offset, piece)
            offset += length

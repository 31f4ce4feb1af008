"""Which ranks write a file, and how rows of distributed arrays come to them: in pieces of bounded size, some of them ahead."""

from __future__ import annotations

import itertools
import math
from collections import deque
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from typing import Any, Protocol, TypeVar

import numpy as np
from numpy.typing import NDArray

from ..errors import AmrpicError, OutputError
from ..mpi import MPI
from ..parallel import raise_together
from ..scene.any_scene import AnyScene
from ..scene.run_sections import PART_BYTES

PIECE_BYTES = 2**20  # what is sent, written and checked at once
AHEAD = 8  # pieces that are under way to a writer while it writes
MERGED_BYTES = 2**23  # of the rows that a writer puts in order at once
RANKS_PER_WRITER = 128  # at most: a writer takes a few messages from each
TAG = 731

Array = NDArray[Any]
Result = TypeVar("Result")


class Rows(Protocol):
    """What is collected: an array, or anything that has its type and shape and can be sliced along the rows."""

    @property
    def dtype(self) -> np.dtype[Any]: ...
    @property
    def shape(self) -> tuple[int, ...]: ...
    def __getitem__(self, rows: slice, /) -> Array: ...


class Interleaved:
    """Columns of equal length as the rows of one (n, columns) array, of which only slices are ever made."""

    def __init__(self, columns: Sequence[Array]) -> None:
        self._columns = columns
        self.dtype = columns[0].dtype
        self.shape = (len(columns[0]), len(columns))

    def __getitem__(self, rows: slice, /) -> Array:
        return np.stack([column[rows] for column in self._columns], axis=1)


# ---- the choice of writers ----


@dataclass(frozen=True)
class Writers:
    """How many ranks write a file: so many (0: all of them); if None, one for each `part_bytes` of it, and for each
    `RANKS_PER_WRITER` ranks at least.
    """

    number: int | None = None
    part_bytes: int = PART_BYTES

    def groups(self, ranks: int, total: int) -> list[range]:
        """Return contiguous groups of about equally many ranks for a file of `total` bytes; the first of each writes."""
        number = self.number
        if number is None:
            number = max(math.ceil(total / self.part_bytes), math.ceil(ranks / RANKS_PER_WRITER), 1)
        groups = min(number, ranks) or ranks
        edges = [ranks * g // groups for g in range(groups + 1)]
        return [range(first, last) for first, last in itertools.pairwise(edges)]


BY_SIZE = Writers()


def writers_of(scene: AnyScene) -> Writers:
    """Return how many ranks write a file of a run."""
    return Writers(scene.output.writers, scene.output.part_bytes)


def group_of(groups: Sequence[range], rank: int) -> range:
    """Return the group that holds `rank`."""
    return next(group for group in groups if rank in group)


def row_bytes(rows: Rows) -> int:
    """Return the bytes of a row."""
    return rows.dtype.itemsize * math.prod(rows.shape[1:])


def rows_per_piece(bytes_of_row: int) -> int:
    """Return how many rows make a piece."""
    return max(1, PIECE_BYTES // max(1, bytes_of_row))


def buffer_bytes(ranks: int, merges: bool) -> int:
    """Return the bytes that a group of so many ranks holds at once for `collect`, or for `merge` as well, beyond its rows."""
    under_way = (AHEAD + 1) * PIECE_BYTES if ranks > 1 else 0
    # Of each rank a piece and the one that arrives meanwhile; those that are ready, and the same in order.
    merged = 4 * MERGED_BYTES if merges else 0
    return max(under_way, merged) + 2 * PIECE_BYTES * ranks


# ---- the way of the rows ----


def said_to_first(comm: MPI.Comm, value: Result, groups: Sequence[range]) -> list[Result]:
    """Return the small values of all writers on rank 0, which is one, and an empty list elsewhere. Collective over them."""
    if comm.rank == 0:
        return [value, *(comm.recv(source=group.start, tag=TAG) for group in groups[1:])]
    if any(comm.rank == group.start for group in groups):
        comm.send(value, 0, tag=TAG)
    return []


def collect_rows(comm: MPI.Comm, group: range, arrays: Sequence[Rows]) -> Array:
    """Return the numbers of rows of arrays on each rank of a group, (ranks, arrays), on its first; elsewhere (1, arrays) its
    own. Collective over the group.
    """
    own_counts = np.array([[rows.shape[0] for rows in arrays]], dtype=np.int64)
    if comm.rank != group.start:
        comm.Send(own_counts, group.start, TAG)
        return own_counts
    table = np.repeat(own_counts, len(group), axis=0)
    for row, rank in zip(table[1:], group[1:], strict=True):
        comm.Recv(row, rank, TAG)
    return table


def collect(
    comm: MPI.Comm,
    group: range,
    counts: Sequence[int],
    rows: Rows,
    write: Callable[[int, Array], object],
) -> None:
    """Hand the rows of every rank of `group` to `write(offset, piece)` on its first rank, where they lie in the order of ranks.

    Collective over the group. `counts` are the rows of each of its ranks, which the first one knows. `write` must not
    raise, because the others wait: see `Attempts`.
    """
    size = rows_per_piece(row_bytes(rows))
    if comm.rank != group.start:
        return _send(comm, group.start, _pieces(rows, size))
    lengths = [(rank, n) for rank, count in zip(group[1:], counts[1:], strict=True) for n in _lengths(count, size)]
    arriving = _arriving(comm, lengths, rows, AHEAD)
    offset = 0
    for piece in _pieces(rows, size):  # while the first of the others' are under way
        write(offset, piece)
        offset += len(piece)
    for piece in arriving:
        write(offset, piece)
        offset += len(piece)


def merge(
    comm: MPI.Comm,
    group: range,
    counts: Sequence[int],
    rows: Rows,
    order: Sequence[str],
    write: Callable[[int, Array], object],
) -> None:
    """Hand the rows of every rank of `group` to `write(offset, piece)` on its first rank, in the order of some columns.

    Collective over the group. Rows are of a structured type and are in `order` on each rank: by the first of these columns,
    those that are equal there by the next. `counts` and `write` are as for `collect`.
    """
    size = max(1, MERGED_BYTES // (len(group) * row_bytes(rows)))
    if comm.rank != group.start:
        return _send(comm, group.start, _pieces(rows, size))
    of_others = zip(group[1:], counts[1:], strict=True)
    streams = [_pieces(rows, size)]
    streams += [_arriving(comm, [(rank, n) for n in _lengths(count, size)], rows, 1) for rank, count in of_others]
    heads = [next(stream, None) for stream in streams]
    offset = 0
    while any(head is not None for head in heads):
        # What is still to come of a stream lies behind the last row of its head.
        last = min(tuple(head[-1][list(order)]) for head in heads if head is not None)
        ends = [0 if head is None else _end_of(head, order, last) for head in heads]
        runs = [head[:end] for head, end in zip(heads, ends, strict=True) if head is not None and end > 0]
        ready = runs[0] if len(runs) == 1 else _in_order(np.concatenate(runs), order)
        write(offset, ready)
        offset += len(ready)
        for i, (head, end) in enumerate(zip(heads, ends, strict=True)):
            if head is not None:
                heads[i] = head[end:] if end < len(head) else next(streams[i], None)


def _in_order(rows: Array, order: Sequence[str]) -> Array:
    return rows[np.lexsort([rows[column] for column in reversed(order)])]


def _end_of(ordered: Array, order: Sequence[str], last: Sequence[Any]) -> int:
    """Return the number of ordered rows that do not lie behind `last`."""
    start, stop = 0, len(ordered)
    for column, value in zip(order, last, strict=True):
        values = ordered[column][start:stop]
        start, stop = (start + int(np.searchsorted(values, value, side)) for side in ("left", "right"))
    return stop


def _pieces(rows: Rows, size: int) -> Iterator[Array]:
    return (np.ascontiguousarray(rows[start : start + size]) for start in range(0, rows.shape[0], size))


def _lengths(count: int, size: int) -> Iterator[int]:
    return (min(size, count - start) for start in range(0, count, size))


def _send(comm: MPI.Comm, to: int, pieces: Iterable[Array]) -> None:
    """Send pieces to a rank, where `_arriving` takes them; the next one is made meanwhile."""
    before = MPI.REQUEST_NULL
    for piece in pieces:
        # Synchronous: what the other rank does not take yet waits here, not in its message buffers.
        request = comm.Issend([piece, MPI.BYTE], to, TAG)
        before.Wait()
        before = request
    before.Wait()


def _arriving(comm: MPI.Comm, lengths: Sequence[tuple[int, int]], like: Rows, ahead: int) -> Iterator[Array]:
    """Return the pieces that ranks send, given as (rank, rows), in order. The first `ahead` are asked for now; whoever takes
    one is done with the one before, whose memory serves for another.
    """
    slots = min(ahead + 1, len(lengths))
    buffers = np.empty((slots, max((n for _, n in lengths), default=0), *like.shape[1:]), like.dtype)

    def ask(number: int) -> tuple[MPI.Request, Array]:
        rank, length = lengths[number]
        piece = buffers[number % slots, :length]
        return comm.Irecv([piece, MPI.BYTE], rank, TAG), piece

    requests = deque(ask(number) for number in range(min(ahead, len(lengths))))

    def take() -> Iterator[Array]:
        for number in range(ahead, len(lengths) + ahead):
            request, piece = requests.popleft()
            if number < len(lengths):
                requests.append(ask(number))
            request.Wait()
            yield piece

    return take()


# ---- failures ----


FREE_SOME_SPACE = "free some space or choose another output folder"


class Attempts:
    """Acts that may fail on one rank while others wait for it: the first failure is kept, later acts are skipped.

    A writer goes on receiving after a failure, so that nobody hangs; `settle` then raises on all ranks.
    """

    def __init__(self, purpose: str, remedy: str = FREE_SOME_SPACE) -> None:
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

    def always(self, close: Callable[[], object]) -> None:
        """Close a file, also after a failure; if that fails too, it says the cause: the disk was full all along."""
        before, self.message = self.message, None
        self.attempt(close)
        self.message = self.message or before

    def on_rank_0(self, comm: MPI.Comm, act: Callable[..., object], *arguments: Any) -> None:
        """Let rank 0 alone act, and `settle`. Collective."""
        if comm.rank == 0:
            self.attempt(act, *arguments)
        self.settle(comm)

    def settle(self, comm: MPI.Comm, error: type[Exception] = OutputError) -> None:
        """Raise `error` on all ranks if an act failed on any of them. Collective."""
        raise_together(comm, self.message, error)


def one_line(error: BaseException) -> str:
    """Return the reason of an exception as part of one sentence."""
    text = str(error.strerror if isinstance(error, OSError) and error.strerror else error)
    return " ".join(text.split()).rstrip(".") or type(error).__name__

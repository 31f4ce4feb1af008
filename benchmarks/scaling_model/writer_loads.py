"""What the ranks that write a checkpoint receive and write."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from amrpic.io.writer_ranks import BY_SIZE, Array, Writers, rows_per_piece


@dataclass(frozen=True)
class Load:
    """What the writer of a group does for a file."""

    ranks: range  # of the group
    bytes: int  # that it writes
    received: int  # bytes that come from other ranks
    messages: int  # in which they come


def checkpoint_loads(rows: Array, row_bytes: Sequence[int], writers: Writers = BY_SIZE) -> list[Load]:
    """Return what each writer of a checkpoint does, given the `rows` (ranks, arrays) of each array, of `row_bytes` each."""
    sizes, width = rows * np.asarray(row_bytes), np.array([rows_per_piece(n) for n in row_bytes], dtype=np.int64)
    pieces = -(-rows // width)
    out = []
    for group in writers.groups(len(rows), int(sizes.sum())):
        others = slice(group.start + 1, group.stop)
        received = int(sizes[others].sum()) + (len(group) - 1) * 8 * rows.shape[1]
        messages = int(pieces[others].sum()) + len(group) - 1
        out.append(Load(group, int(sizes[group.start : group.stop].sum()), received, messages))
    return out

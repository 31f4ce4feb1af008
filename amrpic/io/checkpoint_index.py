"""The index of a part of a checkpoint: the rows of each rank, and a checksum of each piece of them.

Ranks make the checksums of what they send, so damage on the way to the disk is found as well as damage on it.
"""

from __future__ import annotations

import hashlib
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

Array = NDArray[Any]

DIGEST_BYTES = 32
ROWS, DIGESTS = "index/rows", "index/digests"  # datasets


def digest(piece: Array) -> bytes:
    """Return the SHA-256 of a contiguous array."""
    return hashlib.sha256(piece.data if piece.size else b"").digest()


@dataclass(frozen=True)
class Index:
    """What is known of the rows of a group of ranks."""

    rows: Array  # (ranks, arrays) int64
    sizes: Sequence[int]  # rows of a whole piece of each array
    digests: Array  # (pieces, 32) uint8, by rank, then by array

    @property
    def checksum(self) -> str:
        """The SHA-256 of rows and checksums in hexadecimal."""
        return hashlib.sha256(self.rows.tobytes() + self.digests.tobytes()).hexdigest()

    def pieces(self, array: int, start: int, stop: int) -> Iterator[tuple[int, int, bytes]]:
        """Yield first row, end and checksum of the pieces of an array that hold any of its rows from `start` to `stop`."""
        counts, size = self.rows[:, array], self.sizes[array]
        ends, numbers = np.cumsum(counts), pieces_of(self.rows, self.sizes)
        first_number = (np.cumsum(numbers) - numbers.ravel()).reshape(numbers.shape)[:, array]
        for rank in range(int(np.searchsorted(ends, start, "right")), len(counts)):
            first = int(ends[rank] - counts[rank])
            if first >= stop:
                return
            for piece in range(max(start - first, 0) // size, -(-(min(stop, int(ends[rank])) - first) // size)):
                low, high = first + piece * size, min(first + (piece + 1) * size, int(ends[rank]))
                yield low, high, self.digests[first_number[rank] + piece].tobytes()


def pieces_of(rows: Array, sizes: Sequence[int]) -> Array:
    """Return the number of pieces of each array of each rank, (ranks, arrays)."""
    return -(-rows // np.asarray(sizes, dtype=np.int64))

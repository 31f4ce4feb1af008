"""Reading checkpoints, on any number of ranks: each reads its share, and compares the checksums of what it reads."""

from __future__ import annotations

import contextlib
import os
from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import cached_property
from pathlib import Path

import numpy as np
from mpi4py import MPI

from ..errors import InputError
from ..mesh.boxes import cells_of, equal_shares
from ..parallel import share, together
from .checkpoint_index import DIGEST_BYTES, Index, digest, pieces_of
from .checkpoint_manifest import REMEDY, Array, Header, Manifest, Part, UnreadableCheckpoint, decode
from .checkpoint_writer import Snapshot, newest_first
from .writer_ranks import Attempts

Run = tuple[int, int, int]  # part, first row in it, number of rows


def candidates(comm: MPI.Comm, directory: Path) -> list[Path]:
    """Return the finished checkpoints of a directory, the one written last first. Collective."""
    found: list[Path] = []
    with together(comm, InputError):
        if comm.rank == 0:
            found = newest_first(Path(directory))
    return comm.bcast(found)


def read_manifest(comm: MPI.Comm, path: Path) -> Manifest:
    """Return the manifest of a checkpoint whose parts are there in full size. Collective; UnreadableCheckpoint on all ranks."""
    found: Manifest | UnreadableCheckpoint | None = None
    if comm.rank == 0:
        try:
            found = decode(Path(path))
            for part in found.parts:
                _check_size(Path(path), part)
        except UnreadableCheckpoint as error:
            found = error
    found = comm.bcast(found)
    if isinstance(found, Manifest):
        return found
    raise UnreadableCheckpoint(str(found))


def _check_size(path: Path, part: Part) -> None:
    try:
        size = (path / part.file).stat().st_size
    except OSError:
        raise UnreadableCheckpoint(f"checkpoint {path} lacks its part {part.file}; {REMEDY}") from None
    if size != part.bytes:
        raise UnreadableCheckpoint(
            f"part {part.file} of checkpoint {path} has {size} bytes instead of {part.bytes}; {REMEDY}"
        )


def read(
    comm: MPI.Comm,
    path: Path,
    owners: Callable[[Header], Sequence[Array]] | None = None,
    manifest: Manifest | None = None,
) -> Snapshot:
    """Return the state in a checkpoint, distributed over the ranks of `comm`, however many wrote it. Collective.

    `owners(header)` says which rank gets the cells of each box of each level; by default the ranks that wrote them,
    or, on another number of ranks, consecutive boxes with about equally many cells. Table rows go to the ranks that
    wrote them, or in equal shares and in their order; particles then still have to migrate to their cells.
    Each rank reads its share alone, and what else the pieces hold whose checksums cover it. `manifest` is that of
    `read_manifest`, if it was read before. Raises UnreadableCheckpoint on all ranks for what is damaged.
    """
    path = Path(path)
    manifest = manifest or read_manifest(comm, path)
    header = manifest.header
    if owners is not None:
        new_owners = [np.asarray(o, dtype=np.int64) for o in owners(header)]
    elif manifest.ranks == comm.size:
        new_owners = list(header.owners)
    else:
        new_owners = [equal_shares(boxes, comm.size) for boxes in header.boxes]
    attempts = Attempts(f"checkpoint {path} cannot be read", REMEDY)
    state = attempts.attempt(_read_share, comm, path, manifest, new_owners)
    attempts.settle(comm, UnreadableCheckpoint)
    assert state is not None
    return state


class _PartFile:
    """A part of a checkpoint, open for reading at the places that the manifest knows.

    Not through HDF5, which might not survive what damage makes of its own data.
    """

    def __init__(self, path: Path, part: Part, manifest: Manifest) -> None:
        self._part, self._kinds = part, manifest.arrays
        self._sizes = [max(1, manifest.piece_bytes // max(1, kind.bytes)) for kind in manifest.arrays]
        self._file = (path / part.file).open("rb", buffering=0)

    def close(self) -> None:
        self._file.close()

    @cached_property
    def index(self) -> Index:
        part = self._part
        rows = np.empty((part.end_rank - part.first_rank, len(self._kinds)), dtype=np.int64)
        self._read(part.rows_offset, rows)
        if (rows < 0).any() or (rows.sum(axis=0) * [kind.bytes for kind in self._kinds] > part.bytes).any():
            raise self._damage
        digests = np.empty((int(pieces_of(rows, self._sizes).sum()), DIGEST_BYTES), dtype=np.uint8)
        self._read(part.digests_offset, digests)
        index = Index(rows, self._sizes, digests)
        if index.checksum != part.sha256:
            raise self._damage
        return index

    def fill(self, array: int, runs: Sequence[tuple[int, Array]]) -> None:
        """Fill each `out` of disjoint (first row, out) with rows of an array; each piece is read and checked once."""
        kind, offset = self._kinds[array], self._part.offsets[array]
        low, high, held = -1, -1, np.empty(0)  # the piece read last
        for start, out in sorted(runs, key=lambda run: run[0]):
            stop = start + len(out)
            for first, end, expected in self.index.pieces(array, start, stop):
                whole = start <= first and end <= stop
                if (first, end) != (low, high):
                    low, high = first, end
                    held = (
                        out[first - start : end - start] if whole else np.empty((end - first, *kind.shape), kind.dtype)
                    )
                    self._read(offset + first * kind.bytes, held)
                    if digest(held) != expected:
                        raise self._damage
                if not whole:
                    a, b = max(start, first), min(stop, end)
                    out[a - start : b - start] = held[a - first : b - first]

    def _read(self, offset: int, out: Array) -> None:
        """Fill a contiguous array with the bytes at an offset."""
        left = out.reshape(-1).view(np.uint8).data
        while len(left):
            done = os.preadv(self._file.fileno(), [left], offset)
            if done == 0:
                raise self._damage
            left, offset = left[done:], offset + done

    @property
    def _damage(self) -> ValueError:
        return ValueError(f"the checksum of {self._part.file} is wrong")


class _Parts(contextlib.ExitStack):
    """The parts of a checkpoint, opened where rows of them are wanted."""

    def __init__(self, path: Path, manifest: Manifest) -> None:
        super().__init__()
        self._path, self._manifest = path, manifest
        self._numbers = {kind.name: number for number, kind in enumerate(manifest.arrays)}
        self._files: dict[int, _PartFile] = {}

    def rows(self, name: str, runs: Sequence[Run]) -> Array:
        """Return the rows of all runs of an array as one."""
        array = self._numbers[name]
        kind = self._manifest.arrays[array]
        lengths = [length for _, _, length in runs]
        out = np.empty((sum(lengths), *kind.shape), kind.dtype)
        of_part: dict[int, list[tuple[int, Array]]] = {}
        for (part, start, _), piece in zip(runs, np.split(out, np.cumsum(lengths[:-1])) if runs else (), strict=True):
            of_part.setdefault(part, []).append((start, piece))
        for part, wanted in of_part.items():
            self._file(part).fill(array, wanted)
        return out

    def rows_of_rank(self, name: str, rank: int) -> Array:
        """Return the rows of an array that a rank wrote."""
        number = next(n for n, part in enumerate(self._manifest.parts) if part.first_rank <= rank < part.end_rank)
        before = self._file(number).index.rows[
            : rank - self._manifest.parts[number].first_rank + 1, self._numbers[name]
        ]
        return self.rows(name, [(number, int(before[:-1].sum()), int(before[-1]))])

    def _file(self, part: int) -> _PartFile:
        if part not in self._files:
            self._files[part] = _PartFile(self._path, self._manifest.parts[part], self._manifest)
            self.callback(self._files[part].close)
        return self._files[part]


def _read_share(comm: MPI.Comm, path: Path, manifest: Manifest, owners: Sequence[Array]) -> Snapshot:
    header = manifest.header
    fields: dict[str, list[Array]] = {name: [] for name in manifest.fields}
    tables: dict[str, dict[str, Array]] = {table: {} for table in manifest.tables}
    with _Parts(path, manifest) as parts:
        for level in range(len(header.boxes)):
            runs = _box_runs(manifest, level, np.flatnonzero(owners[level] == comm.rank))
            for name in manifest.fields:
                fields[name].append(parts.rows(f"level{level}/{name}", runs))
        for table, columns in manifest.tables.items():
            runs = _equal_share(manifest.rows(table), comm)
            for column in columns:
                name = f"{table}/{column}"
                same = manifest.ranks == comm.size
                tables[table][column] = parts.rows_of_rank(name, comm.rank) if same else parts.rows(name, runs)
    return Snapshot(replace(header, owners=list(owners)), fields, tables)


def _box_runs(manifest: Manifest, level: int, wanted: Array) -> list[Run]:
    """Return where the cells of the `wanted` boxes of a level lie."""
    cells, (part, start) = cells_of(manifest.header.boxes[level]), manifest.places(level)
    return _merged([(int(part[b]), int(start[b]), int(cells[b])) for b in wanted])


def _equal_share(rows: Sequence[int], comm: MPI.Comm) -> list[Run]:
    """Return where this rank's equal share of a table lies, given the rows of each part."""
    first, end = share(comm, sum(rows))
    runs, start = [], 0
    for part, count in enumerate(rows):
        low, high = max(first - start, 0), min(end - start, count)
        if low < high:
            runs.append((part, low, high - low))
        start += count
    return runs


def _merged(runs: Sequence[Run]) -> list[Run]:
    """Return the runs with neighbours that follow on each other made one."""
    out: list[Run] = []
    for part, start, length in runs:
        if out and out[-1][0] == part and out[-1][1] + out[-1][2] == start:
            out[-1] = (part, out[-1][1], out[-1][2] + length)
        else:
            out.append((part, start, length))
    return out

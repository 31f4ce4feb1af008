"""Checkpoints: the whole state of a run in a directory that is there whole or not at all. `checkpoint_manifest` has its layout,
`checkpoint_reader` reads it.
"""

from __future__ import annotations

import contextlib
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path

import numpy as np
from mpi4py import MPI

from ..errors import OutputError
from ..parallel import together
from . import writer_ranks
from .atomic_files import REPLACED, TEMPORARY, Hdf5Writer, publish, remove, sync, temporary
from .checkpoint_index import DIGEST_BYTES, DIGESTS, ROWS, Index, digest, pieces_of
from .checkpoint_manifest import MANIFEST, Array, Header, Kind, Manifest, Part, encode
from .shared_file import write_rows
from .writer_ranks import (
    BY_SIZE,
    Attempts,
    Interleaved,
    Load,
    Rows,
    Writers,
    collect,
    group_of,
    row_bytes,
    rows_per_piece,
    said_to_first,
)

NAME = re.compile(rf"checkpoint_\d+({re.escape(REPLACED)})?$")


@dataclass(frozen=True)
class Snapshot:
    """A state to write, or read: the header and this rank's share of the large arrays.

    `fields[name][level]` holds the cells of this rank's boxes in box order; `tables[name][column]` has a row per
    particle of this rank (any trailing shape). All ranks have the same names, levels and types.
    """

    header: Header
    fields: Mapping[str, Sequence[Array]] = field(default_factory=dict)
    tables: Mapping[str, Mapping[str, Array]] = field(default_factory=dict)


def path_of(directory: Path, step: int) -> Path:
    """Return where the checkpoint of a step lies in a run's directory."""
    return Path(directory) / f"checkpoint_{step:08d}"


def write(comm: MPI.Comm, path: Path, state: Snapshot, writers: Writers = BY_SIZE) -> None:
    """Write a state into the new directory `path`: there whole and synced on return, or not at all. Collective.

    Ranks form groups; the first of each writes what it receives from the others in small pieces. Every rank makes the
    checksums of its own rows. Raises OutputError on all ranks.
    """
    path = Path(path)
    attempts = Attempts(f"cannot write checkpoint {path}", "free some space or choose another output folder")
    if comm.rank == 0:
        attempts.attempt(_start, path)
    attempts.settle(comm)
    arrays = _arrays(state)
    groups = writers.groups(comm.size, comm.allreduce(sum(rows.shape[0] * row_bytes(rows) for rows in arrays.values())))
    part = _write_part(comm, path, arrays, list(state.tables), group_of(groups, comm.rank), attempts)
    parts = said_to_first(comm, part, groups)
    if comm.rank == 0 and None not in parts:
        attempts.attempt(_finish, path, _manifest(state, arrays, [part for part in parts if part is not None]))
    try:
        attempts.settle(comm)
    finally:
        if comm.rank == 0:
            with contextlib.suppress(OSError):
                remove(temporary(path))  # it is gone already unless an attempt failed


def loads(rows: Array, bytes_of_rows: Sequence[int], writers: Writers = BY_SIZE) -> list[Load]:
    """Return what each writer of a checkpoint does, given the rows (ranks, arrays) of each array on each rank."""
    sizes = [rows_per_piece(n) for n in bytes_of_rows]
    digests = pieces_of(rows, sizes).sum(axis=1, keepdims=True)
    groups = writers.groups(len(rows), int((rows * np.asarray(bytes_of_rows)).sum()))
    with_digests = np.hstack([rows, digests])
    return writer_ranks.writer_loads(groups, with_digests, [*bytes_of_rows, DIGEST_BYTES], announced=rows.shape[1])


def prune(comm: MPI.Comm, directory: Path, keep: int) -> None:
    """Delete all but the newest `keep` checkpoints of a directory. Collective."""
    with together(comm, OutputError):
        for old in newest_first(Path(directory))[max(keep, 1) :] if comm.rank == 0 else ():
            remove(old)


def newest_first(directory: Path) -> list[Path]:
    """Return the finished checkpoints of a directory, the one written last first.

    Not by step: what an earlier, longer run left in the same directory is older.
    """
    if not directory.is_dir():
        return []
    found = [path for path in directory.iterdir() if NAME.match(path.name) and not _succeeded(path)]
    return sorted(found, key=lambda path: (_written(path), path.name), reverse=True)


def _succeeded(path: Path) -> bool:
    """Whether this is a checkpoint that stepped aside for another one, which is in its place."""
    return path.name.endswith(REPLACED) and path.with_name(path.name.removesuffix(REPLACED)).exists()


def _written(path: Path) -> int:
    """Return when a checkpoint was finished, in ns; 0 if it never was."""
    try:
        return (path / MANIFEST).stat().st_mtime_ns
    except OSError:
        return 0


def _start(path: Path) -> None:
    """Make the empty directory that is written to; leftovers of runs that died are removed."""
    path.parent.mkdir(parents=True, exist_ok=True)
    for leftover in path.parent.glob(f"checkpoint_*{TEMPORARY}"):
        remove(leftover)
    remove(temporary(path))
    temporary(path).mkdir()


def _require_equal_lengths(table: Mapping[str, Array]) -> None:
    lengths = {len(column) for column in table.values()}
    if len(lengths) > 1:
        raise ValueError(f"columns of one table have {sorted(lengths)} rows; give one length")


def _write_part(
    comm: MPI.Comm, path: Path, arrays: Mapping[str, Rows], tables: Sequence[str], group: range, attempts: Attempts
) -> Part | None:
    """Write the rows of a group of ranks on its first rank and return what became of them there."""
    file = temporary(path) / f"part_{group.start:04d}.h5"
    writes = comm.rank == group.start
    writer = attempts.attempt(Hdf5Writer, file) if writes else None
    made: list[bytes] = []
    table = write_rows(comm, group, arrays, writer, attempts, seen=lambda piece: made.append(digest(piece)))
    sizes = [rows_per_piece(row_bytes(rows)) for rows in arrays.values()]
    own = np.frombuffer(b"".join(made), dtype=np.uint8).reshape(-1, DIGEST_BYTES)
    numbers = pieces_of(table, sizes).sum(axis=1).tolist()
    digests = np.empty((sum(numbers) if writes else 0, DIGEST_BYTES), dtype=np.uint8)
    collect(comm, group, numbers, own, partial(_store, digests))
    if writer is None:
        return None
    part = attempts.attempt(_index, writer, file, group, list(arrays), tables, Index(table, sizes, digests))
    attempts.always(writer.close)
    return None if part is None else attempts.attempt(lambda: replace(part, bytes=file.stat().st_size))


def _arrays(state: Snapshot) -> dict[str, Rows]:
    """Return this rank's share of all arrays that parts hold, by the names of their datasets."""
    levels = range(len(state.header.boxes))
    out: dict[str, Rows] = {f"level{l}/{name}": arrays[l] for l in levels for name, arrays in state.fields.items()}
    for table, columns in state.tables.items():
        _require_equal_lengths(columns)
        out |= {f"{table}/{column}": _row_major(array) for column, array in columns.items()}
    return out


def _row_major(array: Array) -> Rows:
    """Return rows that can be cut off cheaply, also of the transpose of a structure of arrays."""
    return Interleaved(list(array.T)) if array.ndim == 2 and not array.flags.c_contiguous else array


def _store(all_of_them: Array, offset: int, piece: Array) -> None:
    all_of_them[offset : offset + len(piece)] = piece


def _index(
    writer: Hdf5Writer, file: Path, group: range, names: Sequence[str], tables: Sequence[str], index: Index
) -> Part:
    """Add the index to a part whose arrays are written; return what the manifest says of it."""
    writer.h5[ROWS], writer.h5[DIGESTS] = index.rows, index.digests
    offsets = {name: writer.h5[name].id.get_offset() or 0 for name in (*names, ROWS, DIGESTS)}
    total = dict(zip(names, index.rows.sum(axis=0).tolist(), strict=True))
    rows = {table: next((n for name, n in total.items() if name.startswith(f"{table}/")), 0) for table in tables}
    of_arrays = [offsets[name] for name in names]
    return Part(file.name, group.start, group.stop, 0, rows, of_arrays, offsets[ROWS], offsets[DIGESTS], index.checksum)


def _manifest(state: Snapshot, arrays: Mapping[str, Rows], parts: Sequence[Part]) -> Manifest:
    tables = {name: list(columns) for name, columns in state.tables.items()}
    kinds = [Kind(name, rows.dtype.str, list(rows.shape[1:])) for name, rows in arrays.items()]
    return Manifest(state.header, list(state.fields), tables, kinds, writer_ranks.PIECE_BYTES, parts)


def _finish(path: Path, manifest: Manifest) -> None:
    file = temporary(path) / MANIFEST
    file.write_text(encode(manifest))
    sync(file)
    publish(path)

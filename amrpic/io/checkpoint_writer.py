"""Checkpoints: the whole state of a run in a directory that is there whole or not at all. `checkpoint_manifest` has its layout,
`checkpoint_reader` reads it.
"""

from __future__ import annotations

import contextlib
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path

import h5py
import numpy as np
from mpi4py import MPI

from ..errors import OutputError
from ..mesh.boxes import cells_of
from ..parallel import together
from .atomic_files import REPLACED, TEMPORARY, Hdf5Writer, publish, remove, sha256, sync, temporary
from .checkpoint_manifest import MANIFEST, Array, Header, Manifest, Part, encode
from .writer_ranks import Attempts, Interleaved, Rows, collect, group_of, writer_groups

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


def write(comm: MPI.Comm, path: Path, state: Snapshot, writers: int = 1) -> None:
    """Write a state into the new directory `path`: there whole and synced on return, or not at all. Collective.

    Ranks form `writers` groups (0: each its own); the first of a group writes what it receives from one rank at a time,
    in small pieces. Raises OutputError on all ranks.
    """
    path = Path(path)
    attempts = Attempts(f"cannot write checkpoint {path}", "free some space or choose another output folder")
    if comm.rank == 0:
        attempts.attempt(_start, path)
    attempts.settle(comm)
    groups = writer_groups(comm.size, writers)
    rows = {name: comm.allgather(_row_count(table)) for name, table in state.tables.items()}
    part = _write_part(comm, path, state, rows, groups[group_of(groups, comm.rank)], attempts)
    parts = [p for p in comm.gather(part) or [] if p is not None]
    if attempts.message is None and comm.rank == 0 and len(parts) == len(groups):
        attempts.attempt(_finish, path, _manifest(state, rows, parts))
    try:
        attempts.settle(comm)
    finally:
        if comm.rank == 0:
            with contextlib.suppress(OSError):
                remove(temporary(path))  # it is gone already unless an attempt failed


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


def _row_count(table: Mapping[str, Array]) -> int:
    lengths = {len(column) for column in table.values()}
    if len(lengths) > 1:
        raise ValueError(f"columns of one table have {sorted(lengths)} rows; give one length")
    return lengths.pop() if lengths else 0


def _write_part(
    comm: MPI.Comm, path: Path, state: Snapshot, rows: Mapping[str, Sequence[int]], group: range, attempts: Attempts
) -> Part | None:
    """Write the rows of a group of ranks on its first rank and return what became of them there."""
    file = temporary(path) / f"part_{group.start:04d}.h5"
    writes = comm.rank == group.start
    writer = attempts.attempt(Hdf5Writer, file) if writes else None
    for name, array, counts in _arrays(comm, state, rows):
        dataset = attempts.attempt(_create, writer, name, array, sum(counts[r] for r in group)) if writes else None
        collect(comm, group, counts, array, partial(attempts.attempt, _store, dataset))
    if writer is None:
        return None
    attempts.always(writer.close)
    return attempts.attempt(_describe, file, group)


def _arrays(
    comm: MPI.Comm, state: Snapshot, rows: Mapping[str, Sequence[int]]
) -> list[tuple[str, Rows, Sequence[int]]]:
    """Return name, this rank's array and the rows of every rank, for all that a part holds."""
    out: list[tuple[str, Rows, Sequence[int]]] = []
    for level, (boxes, owners) in enumerate(zip(state.header.boxes, state.header.owners, strict=True)):
        counts = np.bincount(owners, weights=cells_of(boxes), minlength=comm.size).astype(np.int64).tolist()
        out += [(f"level{level}/{name}", arrays[level], counts) for name, arrays in state.fields.items()]
    for table, columns in state.tables.items():
        out += [(f"{table}/{column}", _row_major(array), rows[table]) for column, array in columns.items()]
    return out


def _row_major(array: Array) -> Rows:
    """Return rows that can be cut off cheaply, also of the transpose of a structure of arrays."""
    return Interleaved(list(array.T)) if array.ndim == 2 and not array.flags.c_contiguous else array


def _create(writer: Hdf5Writer, name: str, rows: Rows, count: int) -> h5py.Dataset:
    return writer.h5.create_dataset(name, shape=(count, *rows.shape[1:]), dtype=rows.dtype)


def _store(dataset: h5py.Dataset, offset: int, piece: Array) -> None:
    dataset[offset : offset + len(piece)] = piece


def _describe(file: Path, group: range) -> Part:
    return Part(file.name, group.start, group.stop, file.stat().st_size, sha256(file))


def _manifest(state: Snapshot, rows: Mapping[str, Sequence[int]], parts: Sequence[Part]) -> Manifest:
    tables = {name: list(columns) for name, columns in state.tables.items()}
    return Manifest(state.header, list(state.fields), tables, rows, parts)


def _finish(path: Path, manifest: Manifest) -> None:
    file = temporary(path) / MANIFEST
    file.write_text(encode(manifest))
    sync(file)
    publish(path)

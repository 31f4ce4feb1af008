"""One HDF5 file of distributed arrays, written by a few ranks.

With one writer it is one file. With more, each writes a part beside it, and the file proper shows the parts as one through
virtual datasets; it needs no parallel HDF5. Names of parts do not end as those of HDF5 files, lest clients that open a whole
folder take them for files of their own.
"""

from __future__ import annotations

import contextlib
import glob
import os
from collections.abc import Callable, Iterator, Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import Any

import h5py
import numpy as np
from numpy.typing import NDArray

from ..errors import OutputError
from ..mpi import MPI
from .atomic_files import TEMPORARY, Hdf5Writer, publish, remove, require_seal, seal_of, temporary
from .vetting import require_readable
from .writer_ranks import (
    Attempts,
    Rows,
    Writers,
    collect,
    collect_rows,
    group_of,
    merge,
    one_line,
    row_bytes,
    said_to_first,
)

Array = NDArray[Any]

# Datasets: the names of the parts beside a file, their sizes, and the checksums at their ends.
PARTS, BYTES, SEALS = "amrpic/parts", "amrpic/part_bytes", "amrpic/part_sha256"


# What h5py and NumPy raise where a file holds something else than is expected.
UNREADABLE = (
    *(OSError, KeyError, TypeError, ValueError, RuntimeError),
    *(AttributeError, IndexError, ArithmeticError, MemoryError),
)


class RowTable:
    """Rows of a structured type, of which only slices are ever made: a group with a dataset for each column.

    `order` names the columns by which rows are ordered, on each rank and then in each part.
    """

    def __init__(
        self, dtype: np.dtype[Any], numbers: Array, rows: Callable[[Array], Array], order: Sequence[str]
    ) -> None:
        """`rows(some of numbers)` makes rows; `numbers` has them in order."""
        self.dtype, self.order = dtype, order
        self.shape = (len(numbers),)
        self._numbers, self._rows = numbers, rows

    def __getitem__(self, rows: slice, /) -> Array:
        return self._rows(self._numbers[rows])


def write(
    comm: MPI.Comm,
    path: Path,
    arrays: Mapping[str, Rows],
    describe: Callable[[h5py.File], object],
    attempts: Attempts,
    writers: Writers,
) -> None:
    """Write arrays into the file `path`, which is there whole and synced on return, or unchanged. Collective.

    `arrays` are this rank's rows by the name of their dataset, or group; all ranks have the same names and types, in the same
    order. `describe` adds the rest, on rank 0. Raises OutputError on all ranks.
    """
    groups = writers.groups(comm.size, comm.allreduce(sum(rows.shape[0] * row_bytes(rows) for rows in arrays.values())))
    group, alone = group_of(groups, comm.rank), len(groups) == 1
    parts = [] if alone else [part_of(path, index) for index in range(len(groups))]
    file = path if alone else parts[groups.index(group)]
    writes = comm.rank == group.start
    writer = attempts.attempt(Hdf5Writer, temporary(file)) if writes else None
    rows = write_rows(comm, group, arrays, writer, attempts).sum(axis=0)
    if writer is not None:
        if alone:
            attempts.attempt(describe, writer.h5)
        attempts.always(writer.close)
    try:
        attempts.settle(comm)
    except OutputError:
        if writes:
            with contextlib.suppress(OSError):
                remove(temporary(file))
        comm.barrier()  # whoever removes the folder meets no other who does
        raise
    published = attempts.attempt(_published, file, rows) if writes else None
    rows_of_parts = said_to_first(comm, published, groups)
    if comm.rank == 0:
        if parts and all(rows_of_part is not None for rows_of_part in rows_of_parts):
            attempts.attempt(_write_master, path, dict(zip(parts, rows_of_parts, strict=True)), arrays, describe)
        attempts.attempt(_remove_stale, path, parts)
        with contextlib.suppress(OSError):
            remove(temporary(path))  # it is gone already unless an attempt failed
    attempts.settle(comm)


def part_of(path: Path, index: int) -> Path:
    """Return the name of a part of a file that has several."""
    return path.with_name(f"{path.stem}.part{index:04d}")


def name_parts(h5: h5py.File, folder: Path, parts: Sequence[Path]) -> None:
    """Note the files whose values a file in the folder shows, their sizes and checksums, for `require_parts`."""
    h5[PARTS] = [os.path.relpath(part, folder) for part in parts]
    h5[BYTES] = np.array([part.stat().st_size for part in parts], dtype=np.int64)
    h5[SEALS] = [seal_of(part) for part in parts]


def parts_of(h5: h5py.File) -> list[str]:
    """Return the names of the files whose values a file shows."""
    return h5[PARTS].asstr()[:].tolist() if PARTS in h5 else []


def require_parts(h5: h5py.File, folder: Path) -> None:
    """Raise ValueError if a part of a file is not whole in the folder: HDF5 would silently give nan for what is not there."""
    names = parts_of(h5)
    seals = h5[SEALS].asstr()[:] if SEALS in h5 else [""] * len(names)
    for name, size, seal in zip(names, h5[BYTES][:].tolist() if names else (), seals, strict=True):
        try:
            actual = (folder / name).stat().st_size
        except OSError:
            raise ValueError(f"its part {name} is not beside it") from None
        if actual != size:
            raise ValueError(f"its part {name} has {actual} bytes instead of {size}")
        if seal and seal_of(folder / name) != seal:
            raise ValueError(f"its part {name} is another one, or changed since")


def opened(path: Path) -> h5py.File:
    """Return a file, open for reading, with all that it shows beside it. Raises InputError, or one of `UNREADABLE`."""
    require_readable(path)
    h5 = h5py.File(path, "r", locking=False)
    try:
        require_parts(h5, path.parent)
    except UNREADABLE:  # HDF5's own as well: a damaged group is found where its members are looked for
        h5.close()
        raise
    return h5


def require_whole(path: Path) -> None:
    """Raise an exception if a file or one of those whose values it shows is not as it was written."""
    require_seal(path)
    with h5py.File(path, "r", locking=False) as h5:
        require_parts(h5, path.parent)
        parts = parts_of(h5)
    for part in parts:
        require_sealed_part(path.parent / part)


def require_sealed_part(path: Path) -> None:
    """Raise OSError or ValueError, which names it, if a part is not as it was written."""
    try:
        require_whole(path)
    except (OSError, ValueError) as error:
        raise ValueError(f"of its part {path.name}, {one_line(error)}") from None


def write_rows(
    comm: MPI.Comm,
    group: range,
    arrays: Mapping[str, Rows],
    writer: Hdf5Writer | None,
    attempts: Attempts,
) -> Array:
    """Write the rows of a group of ranks on its first rank, which has the `writer`; return what `collect_rows` does there.

    Collective over the group.
    """
    table = collect_rows(comm, group, list(arrays.values()))
    for (name, rows), counts in zip(arrays.items(), table.T.tolist(), strict=True):
        created = attempts.attempt(_create, writer, name, rows, sum(counts)) if writer is not None else None
        store = partial(attempts.attempt, _store, created)
        if isinstance(rows, RowTable):
            merge(comm, group, counts, rows, rows.order, store)
        else:
            collect(comm, group, counts, rows, store)
    return table


def _datasets(name: str, rows: Rows) -> Iterator[tuple[str, str | None, np.dtype[Any]]]:
    """Yield the datasets of an array: name, column that it holds, None: all, type."""
    if rows.dtype.names is None:
        yield name, None, rows.dtype
    for column in rows.dtype.names or ():
        yield f"{name}/{column}", column, rows.dtype[column]


def _create(writer: Hdf5Writer, name: str, rows: Rows, count: int) -> list[tuple[h5py.Dataset, str | None]]:
    shape = (count, *rows.shape[1:])
    return [
        (writer.h5.create_dataset(path, shape=shape, dtype=dtype), column)
        for path, column, dtype in _datasets(name, rows)
    ]


def _store(created: Sequence[tuple[h5py.Dataset, str | None]], offset: int, piece: Array) -> None:
    for dataset, column in created:
        dataset[offset : offset + len(piece)] = piece if column is None else piece[column]


def _published(file: Path, rows: Array) -> Array:
    """Publish a file and return `rows`."""
    publish(file)
    return rows


def _remove_stale(path: Path, parts: Sequence[Path]) -> None:
    """Remove the parts of an earlier file in this one's place, and what a run that died left half written."""
    stem = glob.escape(path.stem)
    for pattern in (f"{stem}.part*", f"{stem}.*{TEMPORARY}"):
        for stale in set(path.parent.glob(pattern)) - set(parts):
            remove(stale)


def _write_master(
    path: Path, parts: Mapping[Path, Array], arrays: Mapping[str, Rows], describe: Callable[[h5py.File], object]
) -> None:
    """Write and publish the file that shows the parts, with their rows of each array, as one."""
    with Hdf5Writer(temporary(path)) as h5:
        for number, (name, rows) in enumerate(arrays.items()):
            lengths = [int(rows_of_part[number]) for rows_of_part in parts.values()]
            for dataset, _, dtype in _datasets(name, rows):
                _show_as_one(h5, dataset, dtype, rows.shape[1:], dict(zip(parts, lengths, strict=True)))
        describe(h5)
        name_parts(h5, path.parent, list(parts))
    publish(path)


def _show_as_one(
    h5: h5py.File, name: str, dtype: np.dtype[Any], of_row: tuple[int, ...], lengths: Mapping[Path, int]
) -> None:
    """Make a virtual dataset of the parts' rows, one after the other; a lost part reads as nan, or 0 of whole numbers."""
    layout = h5py.VirtualLayout(shape=(sum(lengths.values()), *of_row), dtype=dtype)
    start = 0
    for part, length in lengths.items():
        if length:
            layout[start : start + length] = h5py.VirtualSource(part.name, name, shape=(length, *of_row), dtype=dtype)
        start += length
    if start == 0:
        h5.create_dataset(name, shape=(0, *of_row), dtype=dtype)
    else:
        h5.create_virtual_dataset(name, layout, fillvalue=np.nan if dtype.kind == "f" else 0)

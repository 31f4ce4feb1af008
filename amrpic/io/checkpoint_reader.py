"""Reading checkpoints, on any number of ranks."""

from __future__ import annotations

import contextlib
import warnings
from collections.abc import Callable, Sequence
from pathlib import Path

import h5py
import numpy as np
from mpi4py import MPI

from ..errors import InputError
from ..mesh.boxes import cells_of, equal_shares
from ..parallel import together
from .atomic_files import sha256
from .checkpoint_manifest import REMEDY, Array, Header, Manifest, Part, decode
from .checkpoint_writer import Snapshot, newest_first
from .writer_ranks import Attempts

Run = tuple[int, int, int]  # part, first row in it, number of rows


def find_latest_valid(comm: MPI.Comm, directory: Path) -> Path | None:
    """Return the checkpoint of a directory that was written last and is whole; None if there is none. Collective.

    Rank 0 warns of each broken one that is passed over.
    """
    candidates: list[Path] = []
    with together(comm, InputError):
        if comm.rank == 0:
            candidates = newest_first(Path(directory))
    for path in comm.bcast(candidates):
        try:
            verify(comm, path)
            return path
        except InputError as error:
            if comm.rank == 0:
                warnings.warn(str(error), stacklevel=2)
    return None


def verify(comm: MPI.Comm, path: Path) -> Manifest:
    """Return the manifest after comparing the checksums of manifest and parts with the files. Collective.

    Raises InputError on all ranks, naming what is missing or damaged.
    """
    path = Path(path)
    manifest = read_manifest(comm, path)
    attempts = Attempts(f"checkpoint {path} cannot be read", REMEDY)
    for part in manifest.parts[comm.rank :: comm.size]:
        attempts.attempt(_check_sum, path, part)
    attempts.settle(comm, InputError)
    return manifest


def read_manifest(comm: MPI.Comm, path: Path) -> Manifest:
    """Return the manifest of a checkpoint whose parts are there in full size. Collective; InputError on all ranks."""
    found: Manifest | InputError | None = None
    if comm.rank == 0:
        try:
            found = decode(Path(path))
            for part in found.parts:
                _check_size(Path(path), part)
        except InputError as error:
            found = error
    found = comm.bcast(found)
    if isinstance(found, Manifest):
        return found
    raise InputError(str(found))


def _check_size(path: Path, part: Part) -> None:
    try:
        size = (path / part.file).stat().st_size
    except OSError:
        raise InputError(f"checkpoint {path} lacks its part {part.file}; {REMEDY}") from None
    if size != part.bytes:
        raise InputError(f"part {part.file} of checkpoint {path} has {size} bytes instead of {part.bytes}; {REMEDY}")


def _check_sum(path: Path, part: Part) -> None:
    if sha256(path / part.file) != part.sha256:
        raise ValueError(f"the checksum of {part.file} is wrong")


def read(comm: MPI.Comm, path: Path, owners: Callable[[Header], Sequence[Array]] | None = None) -> Snapshot:
    """Return the state in a checkpoint, distributed over the ranks of `comm`, however many wrote it. Collective.

    `owners(header)` says which rank gets the cells of each box of each level; by default the ranks that wrote them,
    or, on another number of ranks, consecutive boxes with about equally many cells. Table rows go to the ranks that
    wrote them, or in equal shares and in their order; particles then still have to migrate to their cells.
    Raises InputError on all ranks; call `verify` before to have the checksums compared.
    """
    path = Path(path)
    manifest = read_manifest(comm, path)
    header = manifest.header
    if owners is not None:
        new_owners = [np.asarray(o, dtype=np.int64) for o in owners(header)]
    elif manifest.ranks == comm.size:
        new_owners = list(header.owners)
    else:
        new_owners = [equal_shares(boxes, comm.size) for boxes in header.boxes]
    attempts = Attempts(f"checkpoint {path} cannot be read", REMEDY)
    state = attempts.attempt(_read_share, comm, path, manifest, new_owners)
    attempts.settle(comm, InputError)
    assert state is not None
    return state


class _Parts:
    """The files of a checkpoint, opened where rows of them are wanted."""

    def __init__(self, path: Path, parts: Sequence[Part]) -> None:
        self._path, self._parts = path, parts
        self._files: dict[int, h5py.File] = {}
        self._open = contextlib.ExitStack()

    def __enter__(self) -> _Parts:
        return self

    def __exit__(self, *_: object) -> None:
        self._open.close()

    def rows(self, name: str, runs: Sequence[Run]) -> Array:
        """Return the rows of all runs of a dataset as one array."""
        like = self._file(runs[0][0] if runs else 0)[name]
        out = np.empty((sum(length for _, _, length in runs), *like.shape[1:]), like.dtype)
        offset = 0
        for part, start, length in runs:
            self._file(part)[name].read_direct(out, np.s_[start : start + length], np.s_[offset : offset + length])
            offset += length
        return out

    def _file(self, part: int) -> h5py.File:
        if part not in self._files:
            file = h5py.File(self._path / self._parts[part].file, "r", locking=False)
            self._files[part] = self._open.enter_context(file)
        return self._files[part]


def _read_share(comm: MPI.Comm, path: Path, manifest: Manifest, owners: Sequence[Array]) -> Snapshot:
    header = manifest.header
    fields: dict[str, list[Array]] = {name: [] for name in manifest.fields}
    tables: dict[str, dict[str, Array]] = {}
    with _Parts(path, manifest.parts) as parts:
        for level in range(len(header.boxes)):
            runs = _box_runs(manifest, level, np.flatnonzero(owners[level] == comm.rank))
            for name in manifest.fields:
                fields[name].append(parts.rows(f"level{level}/{name}", runs))
        for table, rows in manifest.rows.items():
            runs = _row_runs(rows, comm, manifest.parts)
            tables[table] = {column: parts.rows(f"{table}/{column}", runs) for column in manifest.tables[table]}
    return Snapshot(_redistributed(header, owners), fields, tables)


def _redistributed(header: Header, owners: Sequence[Array]) -> Header:
    return Header(**{**vars(header), "owners": list(owners)})


def _box_runs(manifest: Manifest, level: int, wanted: Array) -> list[Run]:
    """Return where the cells of the `wanted` boxes of a level lie."""
    cells, (part, start) = cells_of(manifest.header.boxes[level]), manifest.places(level)
    return _merged([(int(part[b]), int(start[b]), int(cells[b])) for b in wanted])


def _row_runs(rows: Sequence[int], comm: MPI.Comm, parts: Sequence[Part]) -> list[Run]:
    """Return where this rank's rows of a table lie: its own if as many ranks wrote, else an equal share."""
    edges = np.concatenate([[0], np.cumsum(rows, dtype=np.int64)])
    if len(rows) == comm.size:
        first, end = int(edges[comm.rank]), int(edges[comm.rank + 1])
    else:
        first, end = (int(edges[-1]) * r // comm.size for r in (comm.rank, comm.rank + 1))
    runs = []
    for index, part in enumerate(parts):
        start, stop = int(edges[part.first_rank]), int(edges[part.end_rank])
        low, high = max(first, start), min(end, stop)
        if low < high:
            runs.append((index, low - start, high - low))
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

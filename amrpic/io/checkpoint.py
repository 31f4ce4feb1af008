"""Checkpoints: the whole state of a run, in a directory that is there whole or not at all.

checkpoint_00001200/
    state.h5           what is small (step, time, scene, rows of each rank) as JSON in `header`, boxes and owners of each level,
                       and the arrays: cells by rank and box, rows of tables by rank
    state.part0000     rows of a group of ranks where several write, which state.h5 shows as one: see `shared_file`

Each file ends in a checksum of itself, and state.h5 has those of the parts.
"""

from __future__ import annotations

import contextlib
import json
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from functools import partial
from pathlib import Path
from typing import Any

import h5py
import numpy as np
from numpy.typing import NDArray

from ..errors import InputError
from ..mesh.boxes import cells_of, equal_shares
from ..mpi import MPI
from ..parallel import share
from . import shared_file
from .atomic_files import publish, remove, require_seal, temporary
from .provenance import Provenance
from .vetting import require_readable
from .writer_ranks import BY_SIZE, Attempts, Interleaved, Rows, Writers, one_line

FORMAT_VERSION = 4
STATE = "state.h5"
BEFORE_HDF5 = "manifest.json"  # in checkpoints of formats up to 3
HEADER, BOXES, OWNERS = "header", "mesh/level{}/boxes", "mesh/level{}/owners"
REMEDY = "restart from another checkpoint"

Array = NDArray[Any]


class UnreadableCheckpoint(InputError):
    """A checkpoint that is incomplete, damaged or foreign; another one may do."""


@dataclass(frozen=True)
class Header:
    """What every rank knows of a state. `domain` and `extra` hold what JSON can; numbers keep every bit."""

    step: int
    time: float  # s
    domain: Mapping[str, Any]
    boxes: Sequence[Array]  # per level (n, 6): lower x, y, z, upper x, y, z, inclusive
    owners: Sequence[Array]  # per level (n,): rank of each box
    about: Provenance = field(default_factory=Provenance)
    extra: Mapping[str, Any] = field(default_factory=dict)


@dataclass(frozen=True)
class Snapshot:
    """A state to write, or read: the header and this rank's share of the large arrays.

    `fields[name][level]` holds the cells of this rank's boxes in box order; `tables[name][column]` has a row per
    particle of this rank (any trailing shape). All ranks have the same names, levels and types.
    """

    header: Header
    fields: Mapping[str, Sequence[Array]] = field(default_factory=dict)
    tables: Mapping[str, Mapping[str, Array]] = field(default_factory=dict)


@dataclass(frozen=True)
class Contents:
    """What a checkpoint holds, and where."""

    header: Header
    fields: Sequence[str]
    tables: Mapping[str, Sequence[str]]  # their columns
    rows: Mapping[str, Sequence[int]]  # of each table, by the ranks that wrote them
    parts: Sequence[str]  # files beside the state

    @property
    def ranks(self) -> int:
        """Number of ranks that wrote."""
        return len(next(iter(self.rows.values()), ()))

    def starts(self, level: int) -> Array:
        """Return the row of the first cell of each box of a level: cells lie by rank, then by box."""
        cells = cells_of(self.header.boxes[level])
        order = np.lexsort((np.arange(len(cells)), self.header.owners[level]))
        starts = np.empty_like(cells)
        starts[order] = np.cumsum(cells[order]) - cells[order]
        return starts


def is_checkpoint(path: Path) -> bool:
    """Whether a path is a checkpoint, of any version."""
    return (path / STATE).exists() or (path / BEFORE_HDF5).exists()


# ---- writing ----


def write(comm: MPI.Comm, path: Path, state: Snapshot, writers: Writers = BY_SIZE) -> None:
    """Write a state into the new directory `path`: there whole and synced on return, or not at all. Collective.

    Raises OutputError on all ranks.
    """
    path = Path(path)
    attempts = Attempts(f"cannot write checkpoint {path}")
    attempts.on_rank_0(comm, _start, path)
    lengths = {name: len(next(iter(columns.values()))) for name, columns in state.tables.items()}
    describe = partial(_describe, state=state, lengths=comm.gather(lengths) or [])
    try:
        shared_file.write(comm, temporary(path) / STATE, _arrays(state), describe, attempts, writers)
        attempts.on_rank_0(comm, publish, path)
    finally:
        if comm.rank == 0:
            with contextlib.suppress(OSError):
                remove(temporary(path))  # it is gone already unless an attempt failed


def _start(path: Path) -> None:
    """Make the empty directory that is written to; leftovers of runs that died are removed."""
    path.parent.mkdir(parents=True, exist_ok=True)
    for leftover in path.parent.glob(temporary(Path("checkpoint_*")).name):
        remove(leftover)
    remove(temporary(path))
    temporary(path).mkdir()


def _arrays(state: Snapshot) -> dict[str, Rows]:
    """Return this rank's share of all arrays, by the names of their datasets."""
    levels = range(len(state.header.boxes))
    arrays: dict[str, Rows] = {f"level{l}/{name}": values[l] for l in levels for name, values in state.fields.items()}
    for table, columns in state.tables.items():
        arrays |= {f"{table}/{column}": _row_major(array) for column, array in columns.items()}
    return arrays


def _row_major(array: Array) -> Rows:
    """Return rows that can be cut off cheaply, also of the transpose of a structure of arrays."""
    return Interleaved(list(array.T)) if array.ndim == 2 and not array.flags.c_contiguous else array


def _describe(h5: h5py.File, state: Snapshot, lengths: Sequence[Mapping[str, int]]) -> None:
    """Add the header to a file with the arrays of a state, of whose tables each rank has so many rows."""
    header = state.header
    content = {
        "format_version": FORMAT_VERSION,
        **{name: getattr(header, name) for name in ("step", "time", "domain", "extra")},
        "about": asdict(header.about),
        "fields": list(state.fields),
        "tables": {name: list(columns) for name, columns in state.tables.items()},
        "rows": {name: [of_rank[name] for of_rank in lengths] for name in state.tables},
        "levels": len(header.boxes),
    }
    h5[HEADER] = json.dumps(content, default=_plain)
    for level, (boxes, owners) in enumerate(zip(header.boxes, header.owners, strict=True)):
        h5[BOXES.format(level)], h5[OWNERS.format(level)] = boxes, owners


def _plain(value: Any) -> Any:
    """Return what JSON does not know as what it does."""
    return dict(value) if isinstance(value, Mapping) else value.tolist()  # of NumPy


# ---- reading ----


def open_state(path: Path) -> tuple[h5py.File, Contents]:
    """Return the file of a checkpoint, open, and what is in it. Raises UnreadableCheckpoint for what is none."""
    file = Path(path) / STATE
    if (Path(path) / BEFORE_HDF5).exists() and not file.exists():
        raise UnreadableCheckpoint(
            f"{path} is a checkpoint of an earlier version of amrpic, which alone reads it; {REMEDY}"
        )
    try:
        h5 = h5py.File(file, "r", locking=False)
    except (FileNotFoundError, NotADirectoryError):
        raise UnreadableCheckpoint(f"{path} is not a checkpoint: it has no {STATE}; {REMEDY}") from None
    except OSError as error:
        raise UnreadableCheckpoint(f"{file} is damaged or foreign: {one_line(error)}; {REMEDY}") from None
    try:
        shared_file.require_parts(h5, file.parent)
        return h5, _contents(h5)
    except shared_file.UNREADABLE as error:
        h5.close()
        raise UnreadableCheckpoint(f"checkpoint {path} is damaged or foreign: {one_line(error)}; {REMEDY}") from None
    except UnreadableCheckpoint as error:
        h5.close()
        raise UnreadableCheckpoint(f"{path} {error}") from None


def open_vetted(path: Path) -> tuple[h5py.File, Contents]:
    """Do the same for a checkpoint whose checksums nobody looks at; a process of its own reads it first."""
    require_readable(Path(path) / STATE)
    return open_state(path)


def _contents(h5: h5py.File) -> Contents:
    content = json.loads(h5[HEADER].asstr()[()])
    if content["format_version"] != FORMAT_VERSION:
        raise UnreadableCheckpoint(
            f"has checkpoint format {content['format_version']}, this version reads {FORMAT_VERSION}; use what wrote it"
        )
    boxes, owners = ([h5[name.format(l)][()] for l in range(content["levels"])] for name in (BOXES, OWNERS))
    about = Provenance(**content["about"])
    header = Header(content["step"], content["time"], content["domain"], boxes, owners, about, content["extra"])
    return Contents(header, content["fields"], content["tables"], content["rows"], shared_file.parts_of(h5))


def read_contents(comm: MPI.Comm, path: Path) -> Contents:
    """Return what a checkpoint holds, with its parts there in full size. Collective; UnreadableCheckpoint on all ranks."""
    contents: Contents | str = ""
    if comm.rank == 0:
        try:
            if (Path(path) / STATE).exists():
                require_seal(Path(path) / STATE)
            h5, contents = open_state(path)
            h5.close()
        except UnreadableCheckpoint as error:
            contents = str(error)
        except (OSError, ValueError) as error:
            contents = f"{Path(path) / STATE} is damaged: {one_line(error)}; {REMEDY}"
    contents = comm.bcast(contents)
    if isinstance(contents, str):
        raise UnreadableCheckpoint(contents)
    return contents


def read(
    comm: MPI.Comm,
    path: Path,
    owners: Callable[[Header], Sequence[Array]] | None = None,
    contents: Contents | None = None,
) -> Snapshot:
    """Return the state in a checkpoint, distributed over the ranks of `comm`, however many wrote it. Collective.

    `owners(header)` says which rank gets the cells of each box of each level; by default the ranks that wrote them,
    or, on another number of ranks, consecutive boxes with about equally many cells. Table rows go to the ranks that
    wrote them, or in equal shares and in their order; particles then still have to migrate to their cells.
    Each rank reads its share, and looks at the checksums of the parts that it is dealt. `contents` are those of
    `read_contents`, if they were read before. Raises UnreadableCheckpoint on all ranks for what is damaged.
    """
    path = Path(path)
    contents = contents or read_contents(comm, path)
    header = contents.header
    if owners is not None:
        new_owners = [np.asarray(o, dtype=np.int64) for o in owners(header)]
    elif contents.ranks == comm.size:
        new_owners = list(header.owners)
    else:
        new_owners = [equal_shares(boxes, comm.size) for boxes in header.boxes]
    attempts = Attempts(f"checkpoint {path} is damaged", REMEDY)
    for part in contents.parts[comm.rank :: comm.size]:
        attempts.attempt(shared_file.require_sealed_part, path / part)
    attempts.settle(comm, UnreadableCheckpoint)  # before HDF5 meets what is damaged
    state = attempts.attempt(_read_share, comm, path, contents, new_owners)
    attempts.settle(comm, UnreadableCheckpoint)
    assert state is not None
    return state


def require_whole(path: Path) -> None:
    """Raise UnreadableCheckpoint if any part of a checkpoint is missing or damaged. Serial."""
    contents = read_contents(MPI.COMM_SELF, path)
    for part in contents.parts:
        try:
            shared_file.require_sealed_part(Path(path) / part)
        except (OSError, ValueError) as error:
            raise UnreadableCheckpoint(f"checkpoint {path} is damaged: {one_line(error)}; {REMEDY}") from None


def _read_share(comm: MPI.Comm, path: Path, contents: Contents, owners: Sequence[Array]) -> Snapshot:
    header = contents.header
    fields: dict[str, list[Array]] = {name: [] for name in contents.fields}
    with h5py.File(path / STATE, "r", locking=False) as h5:
        for level, boxes in enumerate(header.boxes):
            own_boxes = np.flatnonzero(owners[level] == comm.rank)
            slices = _joined(contents.starts(level)[own_boxes], cells_of(boxes)[own_boxes])
            for name in contents.fields:
                fields[name].append(_rows(h5[f"level{level}/{name}"], slices))
        tables = {}
        for table, columns in contents.tables.items():
            ends = np.cumsum([0, *contents.rows[table]])
            same = contents.ranks == comm.size
            own = slice(*(ends[comm.rank : comm.rank + 2].tolist() if same else share(comm, int(ends[-1]))))
            tables[table] = {column: _rows(h5[f"{table}/{column}"], [own]) for column in columns}
    return Snapshot(replace(header, owners=list(owners)), fields, tables)


def _joined(starts: Array, lengths: Array) -> list[slice]:
    """Return runs of rows as slices, those that follow on each other as one."""
    slices: list[slice] = []
    for start, end in zip(starts.tolist(), (starts + lengths).tolist(), strict=True):
        if slices and slices[-1].stop == start:
            start = slices.pop().start
        slices.append(slice(start, end))
    return slices


def _rows(dataset: h5py.Dataset, slices: Sequence[slice]) -> Array:
    """Return some rows of a dataset, one run after the other."""
    rows = np.empty((sum(part.stop - part.start for part in slices), *dataset.shape[1:]), dataset.dtype)
    start = 0
    for part in slices:
        end = start + part.stop - part.start
        if end > start:
            dataset.read_direct(rows, part, slice(start, end))
        start = end
    return rows

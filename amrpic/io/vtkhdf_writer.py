"""Field dumps: potential, charge density and electric field as VTKHDF OverlappingAMR, which ParaView and VTK open.

With one writer a dump is one file. With more, each writes a part beside it, and the file proper shows the parts as one
through virtual datasets; it needs no parallel HDF5.
"""

from __future__ import annotations

import contextlib
import glob
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import Any

import h5py
import numpy as np
from numpy.typing import NDArray

from ..errors import OutputError
from ..mesh.boxes import cells_of
from ..mesh.field import Field, VectorField
from ..mesh.hierarchy import Hierarchy
from ..mesh.window import AT_REST, Window
from .atomic_files import TEMPORARY, Hdf5Writer, publish, remove, temporary
from .provenance import Provenance
from .writer_ranks import Attempts, Interleaved, Rows, collect, group_of, writer_groups

VTKHDF_VERSION = (2, 2)

Fields = Mapping[str, Field | VectorField]


def path_of(directory: Path, step: int) -> Path:
    """Return where the field dump of a step lies in a run's directory."""
    return Path(directory) / f"fields_{step:08d}.vtkhdf"


def write(
    path: Path,
    hierarchy: Hierarchy,
    fields: Fields,
    step: int,
    time: float,
    about: Provenance,
    writers: int = 1,
    window: Window = AT_REST,
) -> None:
    """Write fields into the file `path`, which is there whole and synced on return, or unchanged. Collective.

    Ranks form `writers` groups (0: each its own); the first of a group writes what it receives from one rank at a time,
    in small pieces. Coordinates are those of the mesh; where its `window` is, is noted. Raises OutputError on all ranks.
    """
    path = Path(path)
    comm = hierarchy.comm
    attempts = Attempts(f"cannot write fields {path}", "free some space or choose another output folder")
    groups = writer_groups(comm.size, writers)
    parts = [part_of(path, index) for index in range(len(groups))] if len(groups) > 1 else []
    describe = partial(_describe, hierarchy=hierarchy, fields=fields, step=step, time=time, about=about, window=window)
    mine = group_of(groups, comm.rank)
    _write_file(parts[mine] if parts else path, hierarchy, fields, groups[mine], None if parts else describe, attempts)
    if parts and comm.rank == 0:
        attempts.attempt(_write_master, path, parts, groups, hierarchy, fields, describe)
    if comm.rank == 0:
        attempts.attempt(_remove_stale, path, parts)
        with contextlib.suppress(OSError):
            remove(temporary(path))  # it is gone already unless an attempt failed
    attempts.settle(comm)


def part_of(path: Path, index: int) -> Path:
    """Return the name of a part of a dump that has several."""
    return path.with_name(f"{path.stem}.part{index:04d}.h5")


def _remove_stale(path: Path, parts: Sequence[Path]) -> None:
    """Remove the parts of an earlier dump in this one's place, and what a run that died left half written."""
    beside = glob.escape(path.stem)
    for pattern in (f"{beside}.part*.h5", f"{beside}.*{TEMPORARY}"):
        for stale in set(path.parent.glob(pattern)) - set(parts):
            remove(stale)


# ---- the layout ----


def _order(hierarchy: Hierarchy, level: int) -> NDArray[Any]:
    """Return box numbers in the order of the file: by owner, so that each rank's cells are one run of rows."""
    return np.argsort(hierarchy.owners(level), kind="stable")


def _counts(hierarchy: Hierarchy, level: int) -> list[int]:
    """Return the cells of a level on each rank."""
    cells = cells_of(hierarchy.boxes(level))
    return np.bincount(hierarchy.owners(level), weights=cells, minlength=hierarchy.comm.size).astype(np.int64).tolist()


def _rows(field: Field | VectorField, level: int) -> Rows:
    if isinstance(field, VectorField):
        return Interleaved([component.array(level) for component in field.components])
    return field.array(level)


def _dataset_name(level: int, name: str) -> str:
    return f"VTKHDF/Level{level}/CellData/{name}"


def _write_file(
    file: Path,
    hierarchy: Hierarchy,
    fields: Fields,
    group: range,
    describe: Callable[[Hdf5Writer], None] | None,
    attempts: Attempts,
) -> None:
    """Write the cells of a group of ranks on its first rank, and publish the file if no rank failed. Collective."""
    writes = hierarchy.comm.rank == group.start
    writer = attempts.attempt(Hdf5Writer, temporary(file)) if writes else None
    for level in range(hierarchy.levels):
        counts = _counts(hierarchy, level)
        for name, field in fields.items():
            rows = _rows(field, level)
            shape = (sum(counts[rank] for rank in group), *rows.shape[1:])
            dataset = attempts.attempt(_create, writer, level, name, shape, rows.dtype) if writes else None
            collect(hierarchy.comm, group, counts, rows, partial(attempts.attempt, _store, dataset))
    if describe and writes:
        attempts.attempt(describe, writer)
    if writer is not None:
        attempts.always(writer.close)
    try:
        attempts.settle(hierarchy.comm)
    except OutputError:
        if writes:
            with contextlib.suppress(OSError):
                remove(temporary(file))
        raise
    if writes:
        attempts.attempt(publish, file)
    attempts.settle(hierarchy.comm)


def _create(writer: Hdf5Writer, level: int, name: str, shape: tuple[int, ...], dtype: np.dtype[Any]) -> h5py.Dataset:
    return writer.h5.create_dataset(_dataset_name(level, name), shape=shape, dtype=dtype)


def _store(dataset: h5py.Dataset, offset: int, piece: NDArray[Any]) -> None:
    dataset[offset : offset + len(piece)] = piece


def _describe(
    writer: Hdf5Writer,
    hierarchy: Hierarchy,
    fields: Fields,
    step: int,
    time: float,
    about: Provenance,
    window: Window,
) -> None:
    """Add all that makes a file with cell data a VTKHDF one, and what it is."""
    root = writer.h5.require_group("VTKHDF")
    root.attrs["Version"] = np.array(VTKHDF_VERSION, dtype=np.int64)
    root.attrs.create("Type", np.bytes_(b"OverlappingAMR"))
    root.attrs["Origin"] = np.array(hierarchy.domain.lower, dtype=np.float64)
    root.attrs.create("GridDescription", np.bytes_(b"XYZ"))
    for level in range(hierarchy.levels):
        group = root.require_group(f"Level{level}")
        group.attrs["Spacing"] = np.asarray(hierarchy.spacing(level), dtype=np.float64)
        boxes = hierarchy.boxes(level)[_order(hierarchy, level)]
        group["AMRBox"] = boxes[:, [0, 3, 1, 4, 2, 5]].astype(np.int32)
        for name, field in fields.items():
            group[f"CellData/{name}"].attrs["unit"] = field.unit
    ours = writer.h5.require_group("amrpic")
    ours.attrs.update(step=step, time=time, version=about.version, seed=about.seed)
    ours.attrs["upper"] = np.array(hierarchy.domain.upper, dtype=np.float64)
    ours.attrs.update(window_origin=window.origin, window_axes=window.axes)
    ours["scene"] = about.scene_text  # a dataset, since attributes end at 64 KiB


# ---- several writers ----


def _write_master(
    path: Path,
    parts: Sequence[Path],
    groups: Sequence[range],
    hierarchy: Hierarchy,
    fields: Fields,
    describe: Callable[[Hdf5Writer], None],
) -> None:
    """Write and publish the file that shows the parts as one."""
    writer = Hdf5Writer(temporary(path))
    for level in range(hierarchy.levels):
        counts = _counts(hierarchy, level)
        for name, field in fields.items():
            _show_as_one(writer.h5, _dataset_name(level, name), parts, groups, counts, _rows(field, level))
    describe(writer)
    writer.h5["amrpic/parts"] = [part.name for part in parts]
    writer.h5["amrpic/part_bytes"] = np.array([part.stat().st_size for part in parts], dtype=np.int64)
    writer.close()
    publish(path)


def _show_as_one(
    h5: h5py.File, name: str, parts: Sequence[Path], groups: Sequence[range], counts: Sequence[int], rows: Rows
) -> None:
    """Make a virtual dataset of the parts' rows, one after the other; a lost part reads as nan."""
    layout = h5py.VirtualLayout(shape=(sum(counts), *rows.shape[1:]), dtype=rows.dtype)
    start = 0
    for part, group in zip(parts, groups, strict=True):
        length = sum(counts[rank] for rank in group)
        if length:
            source = h5py.VirtualSource(part.name, name, shape=(length, *rows.shape[1:]), dtype=rows.dtype)
            layout[start : start + length] = source
        start += length
    h5.create_virtual_dataset(name, layout, fillvalue=np.nan)

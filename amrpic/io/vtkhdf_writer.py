"""Field dumps: potential, charge density and electric field as VTKHDF OverlappingAMR, which ParaView and VTK open."""

from __future__ import annotations

from collections.abc import Mapping
from functools import partial
from pathlib import Path

import h5py
import numpy as np

from ..mesh.field import Field, VectorField
from ..mesh.hierarchy import Hierarchy
from ..mesh.window import AT_REST, Window
from . import shared_file
from .provenance import Provenance
from .writer_ranks import BY_SIZE, Attempts, Interleaved, Rows, Writers

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
    writers: Writers = BY_SIZE,
    window: Window = AT_REST,
) -> None:
    """Write fields into the file `path`, which is there whole and synced on return, or unchanged. Collective.

    One or several ranks write what they receive from others in small pieces: `shared_file`. Coordinates are those of the
    mesh; where its `window` is, is noted. Raises OutputError on all ranks.
    """
    path = Path(path)
    attempts = Attempts(f"cannot write fields {path}", "free some space or choose another output folder")
    arrays = {
        _dataset_name(level, name): _rows(field, level)
        for level in range(hierarchy.levels)
        for name, field in fields.items()
    }
    describe = partial(_describe, hierarchy=hierarchy, fields=fields, step=step, time=time, about=about, window=window)
    shared_file.write(hierarchy.comm, path, arrays, describe, attempts, writers)


def _rows(field: Field | VectorField, level: int) -> Rows:
    if isinstance(field, VectorField):
        return Interleaved([component.array(level) for component in field.components])
    return field.array(level)


def _dataset_name(level: int, name: str) -> str:
    return f"VTKHDF/Level{level}/CellData/{name}"


def _describe(
    h5: h5py.File,
    hierarchy: Hierarchy,
    fields: Fields,
    step: int,
    time: float,
    about: Provenance,
    window: Window,
) -> None:
    """Add all that makes a file with cell data a VTKHDF one, and what it is."""
    root = h5.require_group("VTKHDF")
    root.attrs["Version"] = np.array(VTKHDF_VERSION, dtype=np.int64)
    root.attrs.create("Type", np.bytes_(b"OverlappingAMR"))
    root.attrs["Origin"] = np.array(hierarchy.domain.lower, dtype=np.float64)
    root.attrs.create("GridDescription", np.bytes_(b"XYZ"))
    for level in range(hierarchy.levels):
        group = root.require_group(f"Level{level}")
        group.attrs["Spacing"] = np.asarray(hierarchy.spacing(level), dtype=np.float64)
        # By owner, so that each rank's cells are one run of rows.
        boxes = hierarchy.boxes(level)[np.argsort(hierarchy.owners(level), kind="stable")]
        group["AMRBox"] = boxes[:, [0, 3, 1, 4, 2, 5]].astype(np.int32)
        for name, field in fields.items():
            group[f"CellData/{name}"].attrs["unit"] = field.unit
    ours = h5.require_group("amrpic")
    ours.attrs.update(step=step, time=time, version=about.version, seed=about.seed)
    ours.attrs["upper"] = np.array(hierarchy.domain.upper, dtype=np.float64)
    ours.attrs.update(window_origin=window.origin, window_axes=window.axes)
    ours["scene"] = about.scene_text  # a dataset, since attributes end at 64 KiB

"""Field dumps: potential, charge density and electric field as VTKHDF OverlappingAMR, which ParaView and VTK open.

A view of the same values for yt is beside it in the file: `yt_view`.
"""

from __future__ import annotations

import contextlib
import json
from collections.abc import Mapping
from functools import partial
from pathlib import Path

import h5py
import numpy as np
from numpy.typing import NDArray

from ..mesh.field import Field, VectorField
from ..mesh.hierarchy import Hierarchy
from ..mpi import MPI
from . import shared_file, yt_view
from .atomic_files import publish, temporary
from .provenance import Moment, Provenance
from .writer_ranks import BY_SIZE, Attempts, Interleaved, Rows, Writers

VTKHDF_VERSION = (2, 2)
SERIES = "fields.vtkhdf.series"

Fields = Mapping[str, Field | VectorField]


def path_of(directory: Path, step: int, kind: str = "fields") -> Path:
    """Return where the field dump of a step, or one of another kind, lies in a run's directory."""
    return Path(directory) / f"{kind}_{step:08d}.vtkhdf"


def write(
    path: Path,
    hierarchy: Hierarchy,
    fields: Fields,
    moment: Moment,
    about: Provenance,
    writers: Writers = BY_SIZE,
) -> None:
    """Write fields into the file `path`, which is there whole and synced on return, or unchanged. Collective.

    One or several ranks write what they receive from others in small pieces: `shared_file`. The mesh lies where its window
    shows it, which is noted. Raises OutputError on all ranks.
    """
    path = Path(path)
    attempts = Attempts(f"cannot write fields {path}")
    arrays = {
        DATASETS.format(level, name): _rows(field, level)
        for level in range(hierarchy.levels)
        for name, field in fields.items()
    }
    describe = partial(_describe, hierarchy=hierarchy, fields=fields, moment=moment, about=about)
    shared_file.write(hierarchy.comm, path, arrays, describe, attempts, writers)


def list_time(comm: MPI.Comm, directory: Path, moment: Moment, kind: str = "fields") -> None:
    """Note the time of a dump in the list that ParaView opens as one animation. Collective; OutputError.

    It is JSON: the files in the order of their times. Dumps that are no longer there leave it.
    """
    path, dump = Path(directory) / SERIES.replace("fields", kind), path_of(directory, moment.step, kind)
    attempts = Attempts(f"cannot write {path}")

    def write_list() -> None:
        times: dict[str, float] = {}
        with contextlib.suppress(ValueError):  # a damaged list is begun anew
            times = listed_times(path)
        times = {name: at for name, at in times.items() if path.with_name(name).exists()} | {dump.name: moment.time}
        files = [{"name": name, "time": at} for name, at in sorted(times.items(), key=lambda item: item[1])]
        temporary(path).write_text(json.dumps({"file-series-version": "1.0", "files": files}, indent=1) + "\n")
        publish(path)

    attempts.on_rank_0(comm, write_list)


def listed_times(path: Path) -> dict[str, float]:
    """Return the time, s, of each file in a list of times; none if there is no list. Raises ValueError if it is damaged."""
    try:
        return {str(entry["name"]): float(entry["time"]) for entry in json.loads(path.read_text())["files"]}
    except FileNotFoundError:
        return {}
    except (KeyError, TypeError, UnicodeDecodeError) as error:
        raise ValueError(f"it is no list of times ({error})") from None


def _rows(field: Field | VectorField, level: int) -> Rows:
    if isinstance(field, VectorField):
        return Interleaved([component.array(level) for component in field.components])
    return field.array(level)


DATASETS = "VTKHDF/Level{}/CellData/{}"


def boxes_as_written(hierarchy: Hierarchy, level: int) -> NDArray[np.int64]:
    """Return the boxes of a level, (n, 6), in the order of their cells in a file: by owner, so that those of a rank follow."""
    return hierarchy.boxes(level)[np.argsort(hierarchy.owners(level), kind="stable")].astype(np.int64)


def _describe(
    h5: h5py.File,
    hierarchy: Hierarchy,
    fields: Fields,
    moment: Moment,
    about: Provenance,
) -> None:
    """Add all that makes a file with cell data a VTKHDF one, and what it is."""
    root = h5.require_group("VTKHDF")
    root.attrs["Version"] = np.array(VTKHDF_VERSION, dtype=np.int64)
    root.attrs.create("Type", np.bytes_(b"OverlappingAMR"))
    domain, window = moment.window.shown(hierarchy.domain), moment.window
    root.attrs["Origin"] = np.array(domain.lower, dtype=np.float64)
    root.attrs.create("GridDescription", np.bytes_(b"XYZ"))
    levels = [boxes_as_written(hierarchy, level) for level in range(hierarchy.levels)]
    for level, boxes in enumerate(levels):
        group = root.require_group(f"Level{level}")
        group.attrs["Spacing"] = np.asarray(hierarchy.spacing(level), dtype=np.float64)
        group["AMRBox"] = boxes[:, [0, 3, 1, 4, 2, 5]].astype(np.int32)
        for name, field in fields.items():
            group[f"CellData/{name}"].attrs["unit"] = field.unit
    if sum(map(len, levels)) <= yt_view.LARGEST:
        yt_view.add(h5, domain, levels, {name: f.unit for name, f in fields.items()}, DATASETS, moment.time)
    amrpic = note(h5, moment, about)
    amrpic.attrs["upper"] = np.array(domain.upper, dtype=np.float64)
    amrpic.attrs.update(window_origin=window.origin, window_axes=window.axes, window_pivot=window.pivot)


def note(h5: h5py.File, moment: Moment, about: Provenance) -> h5py.Group:
    """Add to a file of which run and moment it is, in a group of ours, and return that."""
    group = h5.require_group("amrpic")
    group.attrs.update(step=moment.step, time=moment.time, version=about.version, seed=about.seed)
    group["scene"] = about.scene_text  # a dataset, since attributes end at 64 KiB
    return group

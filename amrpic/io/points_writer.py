"""Points with what they carry, as VTKHDF PolyData, which ParaView and VTK open: written, and read at once."""

from __future__ import annotations

from collections.abc import Mapping
from functools import partial
from pathlib import Path

import h5py
import numpy as np

from ..errors import InputError
from ..mpi import MPI
from . import shared_file
from .provenance import Moment, Provenance
from .shared_file import UNREADABLE
from .vtkhdf_writer import VTKHDF_VERSION, note
from .writer_ranks import BY_SIZE, Attempts, Writers, one_line

KIND = "points"
PLACES, VALUES = "VTKHDF/Points", "VTKHDF/PointData/{}"


def write(
    comm: MPI.Comm,
    path: Path,
    position: np.ndarray,
    values: Mapping[str, np.ndarray],
    units: Mapping[str, str],
    moment: Moment,
    about: Provenance,
    writers: Writers = BY_SIZE,
) -> None:
    """Write points at positions (n, 3) in m with `values`, (n,) or (n, components), of this rank into the file `path`.

    The file is there whole and synced on return, or unchanged. All ranks have the same names. Collective; OutputError on all
    ranks.
    """
    attempts = Attempts(f"cannot write points {path}")
    arrays = {PLACES: np.ascontiguousarray(position)}
    arrays |= {VALUES.format(name): np.ascontiguousarray(column) for name, column in values.items()}
    describe = partial(_describe, units=units, moment=moment, about=about)
    shared_file.write(comm, Path(path), arrays, describe, attempts, writers)


def read(path: Path) -> dict[str, np.ndarray]:
    """Return the positions and values of all points in a file, by names. Raises InputError."""
    try:
        with shared_file.opened(path) as h5:
            values = {name: column[()] for name, column in h5[VALUES.format("")].items()}
            return {"position": h5[PLACES][()], **values}
    except UNREADABLE as error:
        raise InputError(f"{path} cannot be read: {one_line(error)}; give a points_*.vtkhdf that a run wrote") from None


def _describe(h5: h5py.File, units: Mapping[str, str], moment: Moment, about: Provenance) -> None:
    """Add all that makes a file with points a VTKHDF one: each point is a vertex by itself."""
    root = h5.require_group("VTKHDF")
    root.attrs["Version"] = np.array(VTKHDF_VERSION, dtype=np.int64)
    root.attrs.create("Type", np.bytes_(b"PolyData"))
    count = len(h5[PLACES])
    root["NumberOfPoints"] = np.array([count], dtype=np.int64)
    for kind in ("Vertices", "Lines", "Strips", "Polygons"):
        cells = count if kind == "Vertices" else 0
        group = root.require_group(kind)
        group["NumberOfCells"] = group["NumberOfConnectivityIds"] = np.array([cells], dtype=np.int64)
        group["Connectivity"] = np.arange(cells, dtype=np.int64)
        group["Offsets"] = np.arange(cells + 1, dtype=np.int64)
    for name, unit in units.items():
        h5[VALUES.format(name)].attrs["unit"] = unit
    note(h5, moment, about)

"""The surfaces of electrodes as a VTK file, which ParaView shows beside the fields."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from ..conductors.surface import quadrilaterals
from ..errors import OutputError
from ..mesh.domain import Domain
from ..scene.electrodes import Electrode
from .atomic_files import publish, temporary
from .writer_ranks import one_line

FILE = "electrodes.vtk"


def write(path: Path, electrodes: Sequence[Electrode], domain: Domain) -> None:
    """Write the surfaces of electrodes in a domain; each quadrilateral has the number of its electrode. Serial; OutputError."""
    points, faces, owner, count = [np.empty((0, 3))], [np.empty((0, 4), np.int64)], [np.empty(0, np.int64)], 0
    for number, electrode in enumerate(electrodes):
        corners, quads = quadrilaterals(electrode.shape, domain.lower, domain.upper)
        points.append(corners)
        faces.append(quads + count)
        owner.append(np.full(len(quads), number))
        count += len(corners)
    place, quads, of = np.concatenate(points), np.concatenate(faces), np.concatenate(owner)
    names = ", ".join(f"{number} {electrode.name}" for number, electrode in enumerate(electrodes))
    rows = np.concatenate([np.full((len(quads), 1), 4), quads], axis=1)
    text = [
        f"# vtk DataFile Version 3.0\namrpic electrodes: {names}"[:255] + "\nBINARY\nDATASET POLYDATA\n",
        f"POINTS {len(place)} double\n",
        f"\nPOLYGONS {len(rows)} {rows.size}\n",
        f"\nCELL_DATA {len(rows)}\nSCALARS electrode int 1\nLOOKUP_TABLE default\n",
    ]
    data = [b"", place.astype(">f8").tobytes(), rows.astype(">i4").tobytes(), of.astype(">i4").tobytes()]
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        temporary(path).write_bytes(b"".join(head.encode() + body for head, body in zip(text, data, strict=True)))
        publish(path)
    except OSError as error:
        raise OutputError(f"cannot write {path}: {one_line(error)}; choose another output folder") from None

"""A view of a field dump as openPMD: the meshes of each level as virtual datasets, and a link to the particles of the step.

It holds no values: these stay in the field file and the particle file of the same run. A level is one dense mesh on the box
around all of its boxes, nan where none of them is; level 0 of φ is the record "phi", the finer ones are "phi_lvl1" and so on,
as other codes with refined meshes name them.
"""

from __future__ import annotations

import os
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import h5py
import numpy as np
from numpy.typing import NDArray

from ..mesh.boxes import cells_of
from ..mesh.domain import AXES
from ..mesh.field import Field, VectorField
from ..mesh.hierarchy import Hierarchy
from ..mesh.window import Window
from . import virtual
from .atomic_files import Hdf5Writer, publish, temporary
from .openpmd_files import describe_file, set_text
from .provenance import Moment, Provenance
from .shared_file import name_parts
from .vtkhdf_writer import DATASETS, boxes_as_written
from .writer_ranks import Attempts

FOLDER = "openpmd"  # in a run's directory: viewers take all files of a folder for one series
LARGEST = 2000  # boxes of a view: the time to make one grows faster than their number
DIMENSIONS = {  # powers of length, mass, time, current, temperature, amount, luminous intensity
    "C/m^3": (-3, 0, 1, 1, 0, 0, 0),
    "V": (2, 1, -3, -1, 0, 0, 0),
    "V/m": (1, 1, -3, -1, 0, 0, 0),
    "T": (0, 1, -2, -1, 0, 0, 0),
}


def path_of(directory: Path, step: int) -> Path:
    """Return where the view of a step lies in a run's directory."""
    return Path(directory) / FOLDER / f"openpmd_{step:08d}.h5"


def write(
    path: Path,
    hierarchy: Hierarchy,
    fields: Mapping[str, Field | VectorField],
    fields_file: Path,
    particles_file: Path | None,
    moment: Moment,
    about: Provenance,
) -> None:
    """Write the view into the file `path`, and make its folder. Collective; raises OutputError on all ranks.

    `fields_file` holds the fields, as `vtkhdf_writer` wrote them; `particles_file` the particles of the step, if they were.
    Meshes lie where their window shows them, which has their axes.
    """
    attempts = Attempts(f"cannot write {path}")

    def write_view() -> None:
        path.parent.mkdir(parents=True, exist_ok=True)
        with Hdf5Writer(temporary(path)) as h5:
            describe_file(h5, path, moment, about)
            set_text(h5, "meshesPath", "fields/")
            for level in range(hierarchy.levels):
                boxes = boxes_as_written(hierarchy, level)
                for name, field in fields.items():
                    _add(
                        h5,
                        f"/data/{moment.step}/fields",
                        name,
                        field,
                        level,
                        boxes,
                        hierarchy,
                        moment.window,
                        _from(path, fields_file),
                    )
            files = [fields_file]
            if particles_file is not None:
                group = f"/data/{moment.step}/particles"
                set_text(h5, "particlesPath", "particles/")
                h5[group] = h5py.ExternalLink(_from(path, particles_file), group)
                files.append(particles_file)
            name_parts(h5, path.parent, files)
        publish(path)

    attempts.on_rank_0(hierarchy.comm, write_view)


def _from(path: Path, target: Path) -> str:
    """Return how a file is named in another one."""
    return os.path.relpath(target, path.parent)


def _add(
    h5: h5py.File,
    group: str,
    name: str,
    field: Field | VectorField,
    level: int,
    boxes: NDArray[np.int64],
    hierarchy: Hierarchy,
    window: Window,
    file: str,
) -> None:
    """Add the record of a field on a level."""
    lower, upper = boxes[:, :3].min(axis=0), boxes[:, 3:].max(axis=0) + 1
    spacing = np.asarray(hierarchy.spacing(level))
    record = f"{group}/{name}" + (f"_lvl{level}" if level else "")
    vector = isinstance(field, VectorField)
    rows = (int(cells_of(boxes).sum()), *((len(AXES),) if vector else ()))
    for column, component in enumerate(AXES) if vector else ((None, ""),):
        shape = tuple((upper - lower)[::-1].tolist())
        places = _places(boxes, lower, DATASETS.format(level, name), rows, column)
        dataset = virtual.show(h5, f"{record}/{component}".rstrip("/"), shape, places, file)
        dataset.attrs.update(unitSI=1.0, position=np.full(3, 0.5))
    attributes = h5[record].attrs
    set_text(h5[record], "geometry", "cartesian")
    set_text(h5[record], "dataOrder", "C")
    attributes["axisLabels"] = np.array([axis.encode() for axis in reversed(AXES)])
    attributes["gridSpacing"] = spacing[::-1]
    attributes["gridGlobalOffset"] = (window.shown(hierarchy.domain).lower + lower * spacing)[::-1]
    attributes["windowAxes"] = np.ravel(window.axes)  # along which x, y and z are, in the laboratory
    attributes.update(gridUnitSI=1.0, timeOffset=0.0, unitDimension=np.array(DIMENSIONS[field.unit], dtype=np.float64))
    attributes["refinementRatio"] = np.full(3, 2 if level else 1, dtype=np.uint32)


def _places(
    boxes: NDArray[np.int64], lower: NDArray[np.int64], dataset: str, rows: tuple[int, ...], column: int | None
) -> Iterator[tuple[Any, Any, virtual.RowSource]]:
    cells = cells_of(boxes)
    for box, count, end in zip(boxes, cells.tolist(), np.cumsum(cells).tolist(), strict=True):
        first, size = (box[:3] - lower)[::-1], (box[3:] - box[:3] + 1)[::-1]
        yield first, size, virtual.RowSource(dataset, rows, end - count, count, column)

"""A view of field files for yt: the groups of the Grid Data Format (GDF), a virtual dataset for each box and component.

It opens by `yt.load(path)`, with units. The values stay where VTKHDF has them.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import h5py
import numpy as np
from numpy.typing import NDArray

from ..mesh.boxes import cells_of
from ..mesh.domain import AXES, Domain
from . import virtual

LARGEST = 2000  # boxes of a view: it costs some 0.5 ms and 3 KB for each
X_FASTEST = 1  # of GDF's orders of cells


def add(
    h5: h5py.File, domain: Domain, boxes: Sequence[NDArray[Any]], units: Mapping[str, str], paths: str, time: float
) -> None:
    """Add the view to a file: of the boxes of all levels, each (n, 6), in the order of their cells in the file.

    `units` are those of the fields by name, `paths.format(level, name)` are their datasets; `time` is in s.
    """
    h5.create_group("gridded_data_format").attrs.update(format_version=1.0, data_software=np.bytes_(b"amrpic"))
    h5.create_group("simulation_parameters").attrs.update(
        refine_by=np.int64(2),
        dimensionality=np.int64(3),
        domain_dimensions=np.array(domain.cells, dtype=np.int64),
        domain_left_edge=np.array(domain.lower),
        domain_right_edge=np.array(domain.upper),
        current_time=time,
        unique_identifier=np.bytes_(b"amrpic"),
        cosmological_simulation=np.int64(0),
        num_ghost_zones=np.int64(0),
        field_ordering=np.int64(X_FASTEST),
        geometry=np.int64(0),
        boundary_conditions=np.array([not periodic for periodic in domain.periodic for _ in "lu"], dtype=np.int64),
    )
    for dimension, unit in (("length", "m"), ("time", "s"), ("mass", "kg"), ("velocity", "m/s"), ("magnetic", "T")):
        h5[f"dataset_units/{dimension}_unit"] = 1.0
        h5[f"dataset_units/{dimension}_unit"].attrs["unit"] = unit
    sources = {
        name + axis: (name, column)
        for name in units
        for axis, column in (zip(AXES, range(3), strict=True) if h5[paths.format(0, name)].ndim == 2 else (("", None),))
    }
    for component, (name, _) in sources.items():
        h5.create_group(f"field_types/{component}").attrs["field_units"] = np.bytes_(units[name].replace("^", "**"))
    h5["grid_left_index"] = np.concatenate([level[:, :3] for level in boxes]).astype(np.int64)
    h5["grid_dimensions"] = np.concatenate([_sizes(level) for level in boxes]).astype(np.int32)
    h5["grid_level"] = np.repeat(np.arange(len(boxes)), [len(level) for level in boxes])
    count = len(h5["grid_level"])
    h5["grid_parent_id"] = np.full(count, -1, dtype=np.int64)  # which yt finds by itself
    h5["grid_particle_count"] = np.zeros((count, 1), dtype=np.int64)
    number = 0
    for level, of_level in enumerate(boxes):
        shapes = {name: h5[paths.format(level, name)].shape for name in units}
        cells = cells_of(of_level)
        for size, count, end in zip(_sizes(of_level), cells.tolist(), np.cumsum(cells).tolist(), strict=True):
            for component, (name, column) in sources.items():
                rows = virtual.RowSource(paths.format(level, name), shapes[name], end - count, count, column)
                shape = tuple(size[::-1].tolist())
                virtual.show(h5, f"data/grid_{number:010d}/{component}", shape, [((0, 0, 0), shape, rows)])
            number += 1


def _sizes(boxes: NDArray[Any]) -> NDArray[Any]:
    """Return cells per axis, (n, 3), of boxes (n, 6)."""
    return boxes[:, 3:] - boxes[:, :3] + 1

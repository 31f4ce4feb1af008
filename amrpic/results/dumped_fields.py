"""The fields of a dump as fields on a hierarchy."""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, cast

import numpy as np

from ..errors import InputError
from ..io.field_reader import Dump, open_dump
from ..mesh.domain import AXES, Domain
from ..mesh.field import Field, Holds, VectorField
from ..mesh.hierarchy import Hierarchy
from ..mesh.patch import Patch
from ..mesh.window import AT_REST, Window
from ..mpi import MPI
from ..parallel import together
from ..scene.scene import Scene

SIZES_OF_POINTS = 8, 2  # of boxes, and their blocking factor


def is_of_points(scene: Mapping[str, Any]) -> bool:
    """Whether the scene of a run, as a file holds it, is of material points."""
    return "method" in scene


def scene_of(data: Mapping[str, Any], path: Path) -> Scene:
    """Return the scene of what a path of a run says of it. Raises InputError if that is not of particles in cells."""
    if is_of_points(data):
        raise InputError(
            f"{path} is of material points, whose scene is not read back; look at the tables and fields, or use amrpic plot"
        )
    return Scene.from_dict(data, source=f"the scene in {path}")


@dataclass(frozen=True)
class DumpedFields(Mapping[str, Field | VectorField]):
    """The fields of one dump by name, `["phi"]` or `.phi`; each rank reads its boxes when a field is asked for.

    They are where the `window` of the mesh shows them: in the laboratory, except for the turn of its axes.
    """

    path: Path
    step: int
    time: float  # s
    hierarchy: Hierarchy
    units: Mapping[str, str]
    potential_holds: Holds
    mesh: Domain  # in its own coordinates
    window: Window = AT_REST
    _read: dict[str, Field | VectorField] = field(default_factory=dict, repr=False)

    @classmethod
    def read(cls, comm: MPI.Comm, path: Path) -> DumpedFields:
        """Return the fields of a dump, on the ranks of a communicator. Collective; InputError on all ranks."""
        with together(comm, InputError), open_dump(path) as dump:
            data = json.loads(dump.scene_text)
            if is_of_points(data):
                corners = dump.lower.tolist(), dump.upper.tolist()
                mesh, sizes = Domain(*corners, data["domain"]["cells"], "dirichlet"), SIZES_OF_POINTS
                holds: Holds = "points"
            else:
                scene = scene_of(data, path)
                mesh, holds = scene.domain.value, scene.solver.potential_holds
                sizes = scene.refinement.max_grid_size, scene.refinement.blocking_factor
            step, time, units = dump.step, dump.time, dict(dump.units)
            boxes = [level.boxes for level in dump.levels[1:]]
            window = dump.window
        hierarchy = Hierarchy(comm, window.shown(mesh), boxes, *sizes)
        return cls(path, step, time, hierarchy, units, holds, mesh, window)

    @property
    def at_rest(self) -> DumpedFields:
        """The same fields in the coordinates of the mesh. Collective to make."""
        hierarchy = self.hierarchy
        boxes = [hierarchy.boxes(level) for level in range(1, hierarchy.levels)]
        sizes = hierarchy.max_grid_size, hierarchy.blocking_factor
        return replace(self.on(Hierarchy(hierarchy.comm, self.mesh, boxes, *sizes)), window=AT_REST)

    def on(self, hierarchy: Hierarchy) -> DumpedFields:
        """The same fields on another hierarchy; nan in cells that the dump does not have."""
        return replace(self, hierarchy=hierarchy, _read={})

    def __getitem__(self, name: str) -> Field | VectorField:
        if name not in self.units:
            raise InputError(f"{self.path} holds no {name}; choose among {', '.join(self.units)}")
        if name not in self._read:
            with together(self.hierarchy.comm, InputError):
                self._read[name] = self._values(name)
        return self._read[name]

    def _values(self, name: str) -> Field | VectorField:
        with open_dump(self.path) as dump:
            parts = [Field.unset(self.hierarchy, self.units[name]) for _ in (AXES if dump.is_vector(name) else "1")]
            for patches in zip(*(part.patches for part in parts), strict=True):
                values = _region(dump, name, patches[0])
                for patch, component in zip(patches, np.moveaxis(values, -1, 0), strict=True):
                    patch.data[...] = component
        parts[0].holds = self.potential_holds if name == "phi" else "points"
        return parts[0] if len(parts) == 1 else VectorField(*parts)

    @property
    def rho(self) -> Field:
        """Charge density, C/m³. Collective at the first access, as all of these."""
        return cast(Field, self["rho"])

    @property
    def phi(self) -> Field:
        """Potential, V."""
        return cast(Field, self["phi"])

    @property
    def E(self) -> VectorField:
        """Electric field, V/m."""
        return cast(VectorField, self["E"])

    @property
    def B(self) -> VectorField:
        """Magnetic field of the particles, T; InputError if they have none that counts, as slow beams."""
        return cast(VectorField, self["B"])

    def __iter__(self) -> Iterator[str]:
        return iter(self.units)

    def __len__(self) -> int:
        return len(self.units)


def _region(dump: Dump, name: str, patch: Patch) -> np.ndarray:
    """Return the values of a dump in the cells of a patch, (nx, ny, nz, components), whatever boxes the dump has; else nan."""
    first, last = np.array(patch.lower), np.array(patch.upper)
    out = np.full((*patch.data.shape, 3 if dump.is_vector(name) else 1), np.nan)
    if patch.level >= len(dump.levels):
        return out
    level = dump.levels[patch.level]
    boxes = level.boxes
    for box in level.table.meeting(first.tolist(), last.tolist()):
        values = dump.values(name, patch.level, box)
        values = values.reshape(*values.shape[:3], -1)
        low, high = np.maximum(boxes[box, :3], first), np.minimum(boxes[box, 3:], last) + 1
        in_patch = tuple(map(slice, low - first, high - first))
        in_box = tuple(map(slice, low - boxes[box, :3], high - boxes[box, :3]))
        out[in_patch] = values[in_box]
    return out

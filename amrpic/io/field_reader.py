"""The fields of dumps, box by box: of field files, of checkpoints, and of a run itself, as its ranks hold them."""

from __future__ import annotations

import json
from collections.abc import Mapping
from functools import cached_property
from pathlib import Path
from typing import Any

import h5py
import numpy as np
from numpy.typing import NDArray

from ..errors import InputError
from ..mesh.boxes import cells_of
from ..mesh.composite import Composite, Level, LiveFields
from ..mesh.domain import AXES, Domain
from ..mesh.field import Field, VectorField
from ..mesh.hierarchy import Hierarchy
from ..mesh.window import Window, window_of
from ..particles.frame import Frame
from ..units import SPEED_OF_LIGHT
from .checkpoint import is_checkpoint, open_vetted
from .provenance import Moment
from .shared_file import UNREADABLE, opened
from .writer_ranks import one_line

Array = NDArray[Any]


class Dump(Composite):
    """A field dump, open for reading; a context manager. Values are read when they are asked for.

    Its domain is where the `window` of the mesh shows it; values of vectors are along the axes of the window.

    Ranks of `comm` may share one: each has the boxes that are `here`. A file is not shared.
    Raises InputError if the file is missing, damaged, or something else.
    """

    window: Window

    def __init__(self, path: Path) -> None:
        self.path = Path(path)
        try:
            self._h5 = opened(self.path)
        except UNREADABLE as error:
            raise self._refusal(one_line(error) if self.path.exists() else "No such file or directory") from None
        try:
            self._read_description()
        except UNREADABLE as error:
            self._h5.close()
            raise self._refusal(f"it is no field dump of amrpic ({one_line(error)})") from None

    @cached_property
    def periodic(self) -> tuple[bool, bool, bool]:
        boundary = json.loads(self.scene_text).get("domain", {}).get("boundary", {})
        x, y, z = ("periodic" in boundary.get(axis, ()) for axis in AXES)
        return x, y, z

    @property
    def label(self) -> str:
        return str(self.path)

    def _refusal(self, reason: str) -> InputError:
        return InputError(
            f"{self.path} cannot be read: {reason}; give a fields_*.vtkhdf file or a checkpoint that a run wrote"
        )

    def _read_description(self) -> None:
        root, amrpic = self._h5["VTKHDF"], self._h5["amrpic"]
        self.step, self.time = int(amrpic.attrs["step"]), float(amrpic.attrs["time"])  # time in s
        self.version, self.seed = str(amrpic.attrs["version"]), int(amrpic.attrs["seed"])
        self.lower, self.upper = np.array(root.attrs["Origin"]), np.array(amrpic.attrs["upper"])  # m
        self.window = window_of({key.removeprefix("window_"): value for key, value in amrpic.attrs.items()})
        self.levels = [self._read_level(root[f"Level{l}"]) for l in range(sum(key.startswith("Level") for key in root))]
        self.units = {name: str(values.attrs["unit"]) for name, values in root["Level0/CellData"].items()}

    @staticmethod
    def _read_level(group: h5py.Group) -> Level:
        boxes = group["AMRBox"][:].astype(np.int64)[:, [0, 2, 4, 1, 3, 5]]
        cells = cells_of(boxes)
        return Level(np.array(group.attrs["Spacing"]), boxes, np.cumsum(cells) - cells)

    def __enter__(self) -> Dump:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def close(self) -> None:
        """Close the file."""
        self._h5.close()

    @property
    def scene_text(self) -> str:
        """The resolved scene as JSON."""
        return str(self._h5["amrpic/scene"].asstr()[()])

    def _values(self, name: str, level: int, box: int | np.integer[Any]) -> Array:
        cells = self._size(level, box)
        start = int(self.levels[level].starts[box])
        flat = self._h5[f"VTKHDF/Level{level}/CellData/{name}"][start : start + int(np.prod(cells))]
        if flat.ndim == 1:
            return flat.reshape(cells, order="F")
        return np.stack([flat[:, c].reshape(cells, order="F") for c in range(flat.shape[1])], axis=-1)

    def is_vector(self, name: str) -> bool:
        """Whether `values` gives vectors."""
        return bool(self._h5[f"VTKHDF/Level0/CellData/{name}"].ndim == 2) if name in self.units else False


class CheckpointDump(Dump):
    """The fields of a checkpoint, open for reading like a field dump. Raises InputError if it is none, or damaged."""

    def __init__(self, path: Path) -> None:
        self.path = Path(path)
        self._h5, contents = open_vetted(self.path)
        header = self._header = contents.header
        self.step, self.time = header.step, header.time
        self.version, self.seed = header.about.version, header.about.seed
        self.window = window_of(header.extra.get("course", {}).get("window", {}))
        domain = Domain(*(header.domain[key] for key in ("lower", "upper", "cells")))
        spacing, domain_shown = domain.spacing, self.window.shown(domain)
        self.lower, self.upper = np.array(domain_shown.lower), np.array(domain_shown.upper)  # m
        self.levels = [
            Level(spacing / 2**level, boxes, contents.starts(level)) for level, boxes in enumerate(header.boxes)
        ]
        self._stored = set(contents.fields)
        members = header.extra.get("frames", {}).get("members", [])
        self._beta = Frame(**members[0]).beta if len(members) == 1 else (0.0, 0.0, 0.0)
        present = {"E": "efield_x" in self._stored, "B": "bfield_x" in self._stored or any(self._beta)}
        self.units = {name: unit for name, unit in UNITS.items() if present.get(name, name in self._stored)}

    def is_vector(self, name: str) -> bool:
        return name in ("E", "B")

    @property
    def scene_text(self) -> str:
        return self._header.about.scene_text

    def _values(self, name: str, level: int, box: int | np.integer[Any]) -> Array:
        if self.is_vector(name):
            if name == "B" and "bfield_x" not in self._stored:  # that of charge in one frame
                electric = self._vector("efield", "_of_charge" if "phi_of_charge" in self._stored else "", level, box)
                if "phi_of_images" in self._stored:  # images move against it
                    electric = electric - self._vector("efield", "_of_images", level, box)
                return np.cross(self._beta, electric) / SPEED_OF_LIGHT
            return self._vector("efield" if name == "E" else "bfield", "", level, box)
        cells, start = self._size(level, box), int(self.levels[level].starts[box])
        return self._h5[f"level{level}/{name}"][start : start + int(np.prod(cells))].reshape(cells, order="F")

    def _vector(self, name: str, suffix: str, level: int, box: int | np.integer[Any]) -> Array:
        return np.stack([self._values(f"{name}_{axis}{suffix}", level, box) for axis in AXES], axis=-1)


class LiveDump(LiveFields, Dump):
    """Fields of a hierarchy, shared by its ranks, as their dump would show them. Values are those of the fields."""

    def __init__(
        self,
        path: Path,
        hierarchy: Hierarchy,
        fields: Mapping[str, Field | VectorField],
        moment: Moment,
        scene_text: str = "{}",
    ) -> None:
        """`path` is that of the dump, whether it is written or not."""
        super().__init__(hierarchy, {name: field.parts for name, field in fields.items()})
        domain = moment.window.shown(hierarchy.domain)
        self.lower, self.upper, self.window = np.array(domain.lower), np.array(domain.upper), moment.window
        self.path, self.step, self.time, self._scene_text = Path(path), moment.step, moment.time, scene_text

    @property
    def scene_text(self) -> str:
        return self._scene_text

    def close(self) -> None:
        """Nothing is open."""


UNITS = {"rho": "C/m^3", "phi": "V", "E": "V/m", "B": "T"}  # of the fields of a checkpoint


def open_dump(path: Path) -> Dump:
    """Return the dump at a path, open for reading: a field file, a checkpoint, or the latest of those in a run's folder.

    Raises InputError if there is none.
    """
    path = Path(path)
    if is_checkpoint(path):
        return CheckpointDump(path)
    if not path.is_dir():
        return Dump(path)
    for pattern, kind in (("fields_*.vtkhdf", Dump), ("checkpoint_????????", CheckpointDump)):
        if paths := sorted(path.glob(pattern)):
            return kind(paths[-1])
    raise InputError(
        f"{path} holds neither fields_*.vtkhdf nor checkpoint_*; name a folder that a run wrote into, or a dump in it"
    )

"""Reading field dumps, box by box."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import h5py
import numpy as np
from numpy.typing import NDArray

from ..boxes import cells_of
from ..errors import InputError
from .collect import one_line

Array = NDArray[Any]


@dataclass(frozen=True)
class Level:
    """The boxes of a level of a dump."""

    spacing: Array  # (3,) m
    boxes: Array  # (n, 6): lower x, y, z, upper x, y, z, inclusive
    starts: Array  # (n,): row of the first cell of each box


class Dump:
    """A field dump, open for reading; a context manager. Values are read when they are asked for.

    Raises InputError if the file is missing, damaged, or something else.
    """

    def __init__(self, path: Path) -> None:
        self.path = Path(path)
        try:
            self._h5 = h5py.File(self.path, "r", locking=False)
        except OSError as error:
            reason = error.strerror if isinstance(error, FileNotFoundError) else one_line(error)
            raise self._refusal(reason or "") from None
        try:
            self._read_description()
        except (KeyError, AttributeError, TypeError, ValueError, OSError) as error:
            self._h5.close()
            raise self._refusal(f"it is no field dump of amrpic ({one_line(error)})") from None
        except InputError:
            self._h5.close()
            raise

    def _refusal(self, reason: str) -> InputError:
        return InputError(f"{self.path} cannot be read: {reason}; give a fields_*.vtkhdf file that a run wrote")

    def _read_description(self) -> None:
        root, ours = self._h5["VTKHDF"], self._h5["amrpic"]
        self.step, self.time = int(ours.attrs["step"]), float(ours.attrs["time"])  # time in s
        self.version, self.seed = str(ours.attrs["version"]), int(ours.attrs["seed"])
        self.lower, self.upper = np.array(root.attrs["Origin"]), np.array(ours.attrs["upper"])  # m
        self.levels = [self._read_level(root[f"Level{l}"]) for l in range(sum(key.startswith("Level") for key in root))]
        self.units = {name: str(values.attrs["unit"]) for name, values in root["Level0/CellData"].items()}
        if "parts" in ours:
            for name, size in zip(ours["parts"].asstr()[:], ours["part_bytes"][:], strict=True):
                self._check_part(name, int(size))

    @staticmethod
    def _read_level(group: h5py.Group) -> Level:
        boxes = group["AMRBox"][:].astype(np.int64)[:, [0, 2, 4, 1, 3, 5]]
        cells = cells_of(boxes)
        return Level(np.array(group.attrs["Spacing"]), boxes, np.cumsum(cells) - cells)

    def _check_part(self, name: str, size: int) -> None:
        # HDF5 would silently give nan for what is not there.
        try:
            found = (self.path.parent / name).stat().st_size
        except OSError:
            raise self._refusal(f"its part {name} is not beside it") from None
        if found != size:
            raise self._refusal(f"its part {name} has {found} bytes instead of {size}")

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

    def values(self, name: str, level: int, box: int | np.integer[Any]) -> Array:
        """Return a field in a box of a level: (nx, ny, nz), or (nx, ny, nz, 3) of a vector."""
        description = self.levels[level]
        lower, upper = description.boxes[box, :3], description.boxes[box, 3:]
        shape = tuple(int(n) for n in upper - lower + 1)
        start = int(description.starts[box])
        flat = self._h5[f"VTKHDF/Level{level}/CellData/{name}"][start : start + int(np.prod(shape))]
        if flat.ndim == 1:
            return flat.reshape(shape, order="F")
        return np.stack([flat[:, c].reshape(shape, order="F") for c in range(flat.shape[1])], axis=-1)

    def covered(self, level: int, box: int | np.integer[Any]) -> Array:
        """Return where a finer level covers the cells of a box, bool (nx, ny, nz)."""
        lower, upper = self.levels[level].boxes[box, :3], self.levels[level].boxes[box, 3:]
        out = np.zeros(upper - lower + 1, dtype=bool)
        if level + 1 == len(self.levels):
            return out
        finer = self.levels[level + 1].boxes
        low, high = np.maximum(finer[:, :3] // 2, lower), np.minimum(finer[:, 3:] // 2, upper)
        for b in np.flatnonzero(np.all(low <= high, axis=1)):
            x, y, z = (slice(i, j + 1) for i, j in zip(low[b] - lower, high[b] - lower, strict=True))
            out[x, y, z] = True
        return out

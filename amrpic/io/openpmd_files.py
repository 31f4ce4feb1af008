"""What all openPMD files (HDF5) have in common: opening one, the iteration in it that is meant, and what one says of itself."""

from __future__ import annotations

import contextlib
from collections.abc import Iterable, Iterator, Sequence
from pathlib import Path
from typing import Any

import h5py
import numpy as np

from ..errors import InputError
from . import shared_file
from .provenance import Moment, Provenance
from .shared_file import UNREADABLE
from .writer_ranks import one_line


@contextlib.contextmanager
def opened(path: Path, kind: str, remedy: str) -> Iterator[h5py.File]:
    """Open a file for a while; whatever goes wrong becomes InputError, in words of `kind` it is and a `remedy`."""
    try:
        with shared_file.opened(Path(path)) as h5:
            yield h5
    except FileNotFoundError:
        raise InputError(
            f"{kind} {path} does not exist; correct the path (relative ones start at the scene file)"
        ) from None
    except UNREADABLE as reason:
        raise InputError(f"{kind} {path} cannot be read as openPMD ({one_line(reason)}); {remedy}") from None


def base(h5: h5py.File, where: str, iteration: int | None) -> str:
    """Return the path of an iteration, which must be given if there are several; raises InputError, `where` naming the file."""
    path = text(h5.attrs["basePath"])
    if "%T" not in path:
        return path
    before, after = path.split("%T")
    return before + chosen(where, "iteration", list(h5[before]), iteration) + after


def chosen(where: str, key: str, names: Sequence[str], choice: str | int | None) -> str:
    """Return the name that is wanted, a number if it is one, or the only one; raises InputError if there is not one such."""
    matches = [name for name in names if choice is None or name == choice or (name.isdigit() and int(name) == choice)]
    if len(matches) == 1:
        return matches[0]
    problem = f"no {key} {choice}" if choice is not None else f"{len(names)} {key}s"
    raise InputError(f"{where} holds {problem}; set {key} to one of {', '.join(names) or 'another file'}")


def dimension_text(powers: Iterable[Any]) -> str:
    """Return a unitDimension as a product of SI units; "1" of a plain number."""
    factors = [
        unit if power == 1 else f"{unit}^{power:g}"
        for unit, power in zip(("m", "kg", "s", "A", "K", "mol", "cd"), map(float, powers), strict=False)
        if power
    ]
    return " ".join(factors) or "1"


def text(value: Any) -> str:
    """Return an attribute that is a text."""
    value = np.ravel(value)[0] if isinstance(value, np.ndarray) else value
    return value.decode() if isinstance(value, bytes) else str(value)


def describe_file(h5: h5py.File, path: Path, moment: Moment, about: Provenance) -> None:
    """Add what holds for a new file of one iteration as a whole but where meshes and particles are."""
    name = path.name.replace(f"{moment.step:08d}", "%08T")
    texts = {
        "openPMD": "1.1.0",
        "basePath": "/data/%T/",
        "iterationEncoding": "fileBased",
        "iterationFormat": name if "%08T" in name else "%T",
        "software": "amrpic",
        "softwareVersion": about.version,
    }
    for key, value in texts.items():
        set_text(h5, key, value)
    h5.attrs["openPMDextension"] = np.uint32(0)
    h5["amrpic/scene"] = about.scene_text
    h5.require_group(f"/data/{moment.step}").attrs.update(time=moment.time, dt=0.0, timeUnitSI=1.0)


def set_text(target: h5py.Group, key: str, value: str) -> None:
    """Set an attribute that is a text of fixed length, as readers of openPMD expect it."""
    target.attrs.create(key, np.bytes_(value.encode()))

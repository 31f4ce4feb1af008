"""What all openPMD files (HDF5) have in common: opening one, and the iteration in it that is meant."""

from __future__ import annotations

import contextlib
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import h5py
import numpy as np

from ..errors import InputError
from .shared_file import require_parts
from .writer_ranks import one_line


@contextlib.contextmanager
def opened(path: Path, what: str, remedy: str) -> Iterator[h5py.File]:
    """Open a file for a while; whatever goes wrong becomes InputError, in words of `what` it is and a `remedy`."""
    try:
        with h5py.File(path, "r", locking=False) as h5:
            require_parts(h5, Path(path).parent)
            yield h5
    except FileNotFoundError:
        raise InputError(
            f"{what} {path} does not exist; correct the path (relative ones start at the scene file)"
        ) from None
    except (OSError, KeyError, TypeError, ValueError) as reason:
        raise InputError(f"{what} {path} cannot be read as openPMD ({one_line(reason)}); {remedy}") from None


def base(h5: h5py.File, where: str, iteration: int | None) -> str:
    """Return the path of an iteration, which must be given if there are several; raises InputError, `where` naming the file."""
    path = text(h5.attrs["basePath"])
    if "%T" not in path:
        return path
    before, after = path.split("%T")
    return before + chosen(where, "iteration", list(h5[before]), iteration) + after


def chosen(where: str, key: str, names: Sequence[str], wanted: str | int | None) -> str:
    """Return the name that is wanted, a number if it is one, or the only one; raises InputError if there is not one such."""
    found = [name for name in names if wanted is None or name == wanted or (name.isdigit() and int(name) == wanted)]
    if len(found) == 1:
        return found[0]
    what = f"no {key} {wanted}" if wanted is not None else f"{len(names)} {key}s"
    raise InputError(f"{where} holds {what}; set {key} to one of {', '.join(names) or 'another file'}")


def text(value: Any) -> str:
    """Return an attribute that is a text."""
    value = np.ravel(value)[0] if isinstance(value, np.ndarray) else value
    return value.decode() if isinstance(value, bytes) else str(value)

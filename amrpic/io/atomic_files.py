"""Files that appear whole or not at all: temporary names, syncing, renaming."""

from __future__ import annotations

import contextlib
import hashlib
import io
import os
import shutil
from pathlib import Path
from typing import Any

import h5py

TEMPORARY = ".tmp"  # the name of a file or directory that is still being written ends so
REPLACED = ".replaced"  # a complete directory that steps aside while its successor takes its name


class _Deferred(io.FileIO):
    """A file that keeps the first error of writing to itself until it is asked."""

    error: OSError | None = None

    def write(self, data: Any, /) -> int:
        view = memoryview(data).cast("B")
        done = 0
        try:
            while done < len(view) and self.error is None:
                done += super().write(view[done:]) or 0
        except OSError as error:
            self.error = error
        return len(view)

    def truncate(self, size: int | None = None, /) -> int:
        try:
            return super().truncate(size)
        except OSError as error:
            self.error = self.error or error
            return size or 0


class Hdf5Writer:
    """A new HDF5 file, `h5`; `close` syncs it and raises OSError if any byte could not be written.

    HDF5 crashes the process when it closes a file on a disk that has filled up. Here it never learns of that.
    """

    def __init__(self, path: Path) -> None:
        self._file = _Deferred(path, "w+")
        self.h5 = h5py.File(self._file, "w", libver=("earliest", "v110"))

    def close(self) -> None:
        self.h5.close()
        with self._file:
            if self._file.error is not None:
                raise self._file.error
            os.fsync(self._file.fileno())


def temporary(path: Path) -> Path:
    """Return the name under which `path` is written before it is published."""
    return path.with_name(path.name + TEMPORARY)


def replaced(path: Path) -> Path:
    """Return the name that an existing directory `path` bears while its successor takes its place."""
    return path.with_name(path.name + REPLACED)


def sync(path: Path) -> None:
    """Force a file or a directory to storage."""
    descriptor = os.open(path, os.O_RDONLY)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)


def publish(path: Path) -> None:
    """Give what was written under the temporary name of `path` its final name, at once and for good.

    Files below a directory must have been synced by their writers.
    """
    source = temporary(path)
    sync(source)
    if path.is_dir():
        # A directory cannot be renamed onto a full one: the old one steps aside first. Whoever looks for it finds it
        # under that name should the process die between the two renames.
        remove(replaced(path))
        os.rename(path, replaced(path))
    os.replace(source, path)
    sync(path.parent)
    remove(replaced(path))


def remove(path: Path) -> None:
    """Delete a file or a directory if it is there."""
    if path.is_dir() and not path.is_symlink():
        shutil.rmtree(path)
        return
    with contextlib.suppress(FileNotFoundError):
        path.unlink()


def sha256(path: Path) -> str:
    """Return the SHA-256 of a file's content in hexadecimal."""
    with path.open("rb") as stream:
        return hashlib.file_digest(stream, "sha256").hexdigest()

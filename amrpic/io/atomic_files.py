"""Files that appear whole or not at all: temporary names, syncing, renaming; and checksums by which damage is found later."""

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
SEAL = b"\namrpic sha256 "  # followed by 64 hexadecimal digits at the end of an HDF5 file, which readers of HDF5 do not look at
SEAL_BYTES = len(SEAL) + 64
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

    def readinto(self, buffer: Any, /) -> int:
        """What was not written reads as zeros, since HDF5 follows the addresses that it finds."""
        view = memoryview(buffer).cast("B")
        done = super().readinto(view) or 0
        if self.error is not None:
            view[done:] = bytes(len(view) - done)
            return len(view)
        return done

    def truncate(self, size: int | None = None, /) -> int:
        try:
            return super().truncate(size)
        except OSError as error:
            self.error = self.error or error
            return size or 0


class Hdf5Writer:
    """A new HDF5 file, `h5`; `close` adds a checksum for `require_seal`, syncs, and raises OSError if a byte was not written.

    HDF5 crashes the process when it closes a file on a disk that has filled up. Here it never learns of that; but what it
    reads back is missing then, so it may fail with words of its own. The error of `close` is the cause, and comes before.
    `with` closes the file, also after an error.
    """

    def __init__(self, path: Path) -> None:
        self._file = _Deferred(path, "w+")
        self.h5 = h5py.File(self._file, "w", libver=("earliest", "v110"))

    def __enter__(self) -> h5py.File:
        return self.h5

    def __exit__(self, *error: object) -> None:
        self.close()

    def close(self) -> None:
        """For the checksum the file is read again, from memory as a rule."""
        with self._file:
            try:
                self.h5.close()
            except (OSError, RuntimeError):
                if self._file.error is None:
                    raise
            if self._file.error is None:
                self._file.seek(0)
                digest = hashlib.file_digest(self._file, "sha256").hexdigest()
                self._file.seek(0, os.SEEK_END)
                self._file.write(SEAL + digest.encode())
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


def require_seal(path: Path) -> None:
    """Raise ValueError if a file that `Hdf5Writer` sealed is cut short or has changed since; OSError if it cannot be read."""
    left = path.stat().st_size - SEAL_BYTES
    total = hashlib.sha256()
    with path.open("rb") as file:
        while left > 0 and (piece := file.read(min(left, 2**20))):
            total.update(piece)
            left -= len(piece)
        seal = file.read()
    if not seal.startswith(SEAL):
        raise ValueError("the checksum at its end is missing: it is cut short, or another program or version wrote it")
    if seal[len(SEAL) :] != total.hexdigest().encode():
        raise ValueError("its checksum is wrong: bytes of it have changed")


def seal_of(path: Path) -> str:
    """Return the checksum at the end of a file that `Hdf5Writer` sealed. Raises ValueError if there is none, and OSError."""
    with path.open("rb") as file:
        file.seek(max(file.seek(0, os.SEEK_END) - SEAL_BYTES, 0))
        seal = file.read()
    if not seal.startswith(SEAL):
        raise ValueError(f"the checksum at the end of {path.name} is missing")
    return seal[len(SEAL) :].decode(errors="replace")

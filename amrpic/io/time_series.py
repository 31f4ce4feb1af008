"""The time series: one line of text per step, appended at once, that survives a kill at any moment.

Text, because everything opens it; a line is complete when it ends, so that the torn end of a killed run is recognised.
Numbers are written so that they read back bit for bit.
"""

from __future__ import annotations

import errno
import json
import os
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from mpi4py import MPI
from numpy.typing import NDArray

from ..errors import InputError, OutputError
from ..parallel import raise_together
from ..units import Quantity
from .atomic_files import publish, temporary
from .provenance import Provenance
from .writer_ranks import Attempts, one_line

FORMAT = "amrpic series"


class Series:
    """A series file open for appending, by rank 0; the other ranks hold an empty handle. Collective to make.

    Rows after `keep_to_step` are cut off, which a restart from that step needs; without it the file is begun anew.
    The first column is the step. Raises OutputError on all ranks.
    """

    def __init__(
        self,
        comm: MPI.Comm,
        path: Path,
        columns: Sequence[Quantity],
        about: Provenance,
        keep_to_step: int | None = None,
    ) -> None:
        self.columns = tuple(columns)
        self._path, self._comm, self._descriptor = Path(path), comm, -1
        self._adding = self._attempts()
        attempts = self._attempts()
        if comm.rank == 0:
            attempts.attempt(self._open, about, keep_to_step)
        attempts.settle(comm)

    def _open(self, about: Provenance, keep_to_step: int | None) -> None:
        self._path.parent.mkdir(parents=True, exist_ok=True)
        kept = b""
        if keep_to_step is not None and self._path.exists():
            kept = _rows_to(self._path, self.columns, keep_to_step)
        work = temporary(self._path)
        work.write_bytes(_head(self.columns, about).encode() + kept)
        publish(self._path)
        self._descriptor = os.open(self._path, os.O_WRONLY | os.O_APPEND)

    def append(self, *rows: Mapping[str, float | str]) -> None:
        """Add rows, those of rank 0; what one lacks is zero. Collective; raises OutputError."""
        self.add(*rows)
        settle(self._comm, [self])

    def add(self, *rows: Mapping[str, float | str]) -> None:
        """Do the same without the other ranks, until `settle` tells them whether it failed. Local."""
        if self._comm.rank == 0:
            self._adding.attempt(self._write, "".join(_line(row, self.columns) for row in rows))

    @property
    def problem(self) -> str | None:
        """Why rows could not be added, on rank 0."""
        return self._adding.message

    def _write(self, line: str) -> None:
        if os.write(self._descriptor, line.encode()) < len(line):
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    def _attempts(self) -> Attempts:
        return Attempts(f"cannot write series {self._path}", "free some space or choose another output folder")

    def sync(self) -> None:
        """Force all rows to storage, as before a checkpoint that relies on them. Collective; raises OutputError."""
        attempts = self._attempts()
        if self._comm.rank == 0:
            attempts.attempt(os.fsync, self._descriptor)
        attempts.settle(self._comm)

    def close(self) -> None:
        """Close the file."""
        if self._descriptor >= 0:
            os.close(self._descriptor)
            self._descriptor = -1


def settle(comm: MPI.Comm, series: Iterable[Series]) -> None:
    """Raise OutputError on all ranks if rows of one of the series could not be added. Collective."""
    raise_together(comm, next((one.problem for one in series if one.problem is not None), None), OutputError)


def write(
    comm: MPI.Comm,
    path: Path,
    columns: Sequence[Quantity],
    rows: Sequence[Mapping[str, float | str]],
    about: Provenance,
) -> None:
    """Write a table that is not appended to, that of rank 0, in place of one that is there. Collective; raises OutputError."""
    path = Path(path)
    attempts = Attempts(f"cannot write table {path}", "free some space or choose another output folder")
    if comm.rank == 0:
        attempts.attempt(
            temporary(path).write_text, _head(columns, about) + "".join(_line(row, columns) for row in rows)
        )
        attempts.attempt(publish, path)
    attempts.settle(comm)


def read(path: Path) -> NDArray[Any]:
    """Return the complete rows of a series as a structured array, a field per column. Raises InputError."""
    return _parsed(Path(path))[1]


def scene_of(path: Path) -> dict[str, Any]:
    """Return the resolved scene of the run that wrote a series. Raises InputError."""
    return json.loads(_comment(path, "scene"))


def units_of(path: Path) -> dict[str, str]:
    """Return the unit of each column of a series. Raises InputError."""
    return dict(zip(read(path).dtype.names or (), _comment(path, "units").split(","), strict=True))


def _comment(path: Path, key: str) -> str:
    """Return what the head of a series says after a key."""
    try:
        with open(path, encoding="utf-8") as lines:
            return next(line for line in lines if line.startswith(f"# {key}: ")).partition(": ")[2].rstrip("\n")
    except (OSError, UnicodeDecodeError, StopIteration) as error:
        raise InputError(f"series {path} cannot be read: {one_line(error)}; give a file that a run wrote") from None


def _type(column: Quantity) -> str:
    return "U64" if column.is_text else "i8" if column.counts else "f8"


def _text(value: float | str, column: Quantity) -> str:
    """Return a value so that it reads back bit for bit; texts are to be words."""
    if isinstance(value, str):
        return value
    return str(int(value)) if column.counts else repr(float(value))


def _line(row: Mapping[str, float | str], columns: Sequence[Quantity]) -> str:
    return ",".join(_text(row.get(column.name, 0), column) for column in columns) + "\n"


def _head(columns: Sequence[Quantity], about: Provenance) -> str:
    return (
        f"# {FORMAT}, version {about.version}, seed {about.seed}\n"
        f"# scene: {about.scene_text}\n"
        f"# types: {','.join(_type(column) for column in columns)}\n"
        f"# units: {','.join(column.unit for column in columns)}\n"
        f"{','.join(column.name for column in columns)}\n"
    )


def _parsed(path: Path) -> tuple[list[bytes], NDArray[Any]]:
    """Return the complete lines of rows, and what they hold."""
    try:
        *lines, _torn = path.read_bytes().split(b"\n")  # what follows the last line end was cut off by a kill
        if not lines[0].startswith(f"# {FORMAT}".encode()):
            raise ValueError("it is not a series")
        comments = [line.decode()[2:] for line in lines if line.startswith(b"#")]
        types = next(line for line in comments if line.startswith("types: ")).removeprefix("types: ").split(",")
        names, *rows = [line for line in lines if not line.startswith(b"#")]
        dtype = np.dtype(list(zip(names.decode().split(","), types, strict=True)))
        values = (
            np.loadtxt([row.decode() for row in rows], delimiter=",", dtype=dtype, ndmin=1)
            if rows
            else np.zeros(0, dtype)
        )
    except (OSError, ValueError, IndexError, StopIteration) as error:
        raise InputError(f"series {path} cannot be read: {one_line(error)}; give a file that a run wrote") from None
    return rows, values


def _rows_to(path: Path, columns: Sequence[Quantity], step: int) -> bytes:
    """Return the lines of a series up to a step."""
    lines, values = _parsed(path)
    if values.dtype != np.dtype([(column.name, _type(column)) for column in columns]):
        raise ValueError("the file there has other columns")
    return b"".join(line + b"\n" for line, row in zip(lines, values, strict=True) if row[0] <= step)

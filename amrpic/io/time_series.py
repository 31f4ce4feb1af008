"""The time series: one line of text per step, appended at once, that survives a kill at any moment.

Text, because everything opens it: a line of names, then numbers, which read back bit for bit. A line is complete when it ends,
so that the torn end of a killed run is recognised. What else belongs to a table `series.csv` is in `series.json` beside it:
types and units of the columns, and the scene. Its first line has a checksum of both files, which is overwritten after each row:
after a kill it is that of all but the last rows.
"""

from __future__ import annotations

import contextlib
import errno
import hashlib
import json
import os
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..errors import InputError, OutputError
from ..mpi import MPI
from ..parallel import raise_together
from ..units import Column
from .atomic_files import publish, temporary
from .provenance import Provenance
from .writer_ranks import Attempts, one_line

FORMAT = "amrpic series"
TYPES = {"U64", "i8", "f8"}
ROW_BYTES = 2000  # at most, of usual rows


class Series:
    """A series file open for appending, by rank 0; the other ranks hold an empty handle. Collective to make.

    Rows after `keep_to_step` are cut off, which a restart from that step needs; without it the file is begun anew.
    The first column is the step. Raises OutputError on all ranks.
    """

    def __init__(
        self,
        comm: MPI.Comm,
        path: Path,
        columns: Sequence[Column],
        about: Provenance,
        keep_to_step: int | None = None,
    ) -> None:
        self.columns = tuple(columns)
        self._path, self._comm = Path(path), comm
        self._descriptor = self._beside = -1
        self._adding = self._attempts()
        self._attempts().on_rank_0(comm, self._open, about, keep_to_step)

    def _open(self, about: Provenance, keep_to_step: int | None) -> None:
        self._path.parent.mkdir(parents=True, exist_ok=True)
        lines = b""
        if keep_to_step is not None and self._path.exists():
            lines = _rows_to(self._path, self.columns, keep_to_step)
        self._sum, self._bytes = _publish(self._path, self.columns, about, lines)
        self._descriptor = os.open(self._path, os.O_WRONLY | os.O_APPEND)
        self._beside = os.open(beside(self._path), os.O_WRONLY)

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

    def _write(self, lines: str) -> None:
        text = lines.encode()
        if os.write(self._descriptor, text) < len(text):
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
        self._sum.update(text)
        self._bytes += len(text)
        os.pwrite(self._beside, _checksum(self._sum.hexdigest(), self._bytes), 0)

    def _attempts(self) -> Attempts:
        return Attempts(f"cannot write series {self._path}")

    def sync(self) -> None:
        """Force all rows to storage, as before a checkpoint that relies on them. Collective; raises OutputError."""
        self._attempts().on_rank_0(self._comm, os.fsync, self._descriptor)

    def close(self) -> None:
        """Close the files."""
        for descriptor in (self._descriptor, self._beside):
            if descriptor >= 0:
                os.close(descriptor)
        self._descriptor = self._beside = -1


def settle(comm: MPI.Comm, series: Iterable[Series]) -> None:
    """Raise OutputError on all ranks if rows of one of the series could not be added. Collective."""
    raise_together(comm, next((table.problem for table in series if table.problem is not None), None), OutputError)


def write(
    comm: MPI.Comm,
    path: Path,
    columns: Sequence[Column],
    rows: Sequence[Mapping[str, float | str]],
    about: Provenance,
) -> None:
    """Write a table that is not appended to, that of rank 0, in place of one that is there. Collective; raises OutputError."""
    path = Path(path)
    lines = "".join(_line(row, columns) for row in rows).encode() if comm.rank == 0 else b""
    Attempts(f"cannot write table {path}").on_rank_0(comm, _publish, path, columns, about, lines)


def read(path: Path) -> NDArray[Any]:
    """Return the complete rows of a series as a structured array, a field per column. Raises InputError."""
    return _parsed(Path(path))[1]


def latest(path: Path, names: Sequence[str], count: int) -> dict[str, list[float]]:
    """Return at most the `count` latest values of those numeric columns that there are, without reading the whole file.

    Raises InputError.
    """
    try:
        with open(path, "rb") as file:
            head = file.readline()
            start = max(file.seek(0, os.SEEK_END) - count * ROW_BYTES, len(head))
            file.seek(start)
            lines = file.read().decode().split("\n")[start > len(head) : -1]  # whole ones
        columns = head.decode().strip().split(",")
        rows = [line.split(",") for line in lines[-count:]]
        return {name: [float(row[columns.index(name)]) for row in rows] for name in names if name in columns}
    except (OSError, ValueError, IndexError) as error:
        raise _unreadable(path, error) from None


def require_whole(path: Path) -> None:
    """Raise InputError if a table, or what describes it, is cut short, torn, or has changed since it was written."""
    path = Path(path).with_suffix(".csv")
    _parsed(path)
    first, _, described = beside(path).read_bytes().partition(b"\n")
    rows, length = path.read_bytes(), 0
    with contextlib.suppress(ValueError):
        length = int(first.rpartition(b":")[2].strip(b" ,"))
    # Rows that a killed run added after the checksum are as good as others if they are whole.
    reason = None if rows.endswith(b"\n") else "its last line is incomplete"
    if length > len(rows):
        reason = f"it has {len(rows)} of {length} bytes"
    elif first + b"\n" != _checksum(hashlib.sha256(described + rows[:length]).hexdigest(), length):
        reason = f"its checksum in {beside(path).name} is missing or wrong: bytes have changed"
    if reason is not None:
        raise InputError(f"series {path} is damaged: {reason}; a restart keeps the rows up to its checkpoint")


def _checksum(digest: str, length: int) -> bytes:
    """Return the first line of what describes a table of so many bytes: it has the same length for any."""
    return f'{{"sha256": "{digest}", "bytes": {length:15},\n'.encode()


def scene_of(path: Path) -> dict[str, Any]:
    """Return the resolved scene of the run that wrote a series. Raises InputError."""
    return about_of(path)["scene"]


def units_of(path: Path) -> dict[str, str]:
    """Return the unit of each column of a series. Raises InputError."""
    return {column["name"]: column["unit"] for column in about_of(path)["columns"]}


def about_of(path: Path) -> dict[str, Any]:
    """Return what is known of a series besides its rows: format, version, seed, scene, columns. Raises InputError."""
    try:
        about = json.loads(beside(path).read_text(encoding="utf-8"))
        if not isinstance(about, dict) or about.get("format") != FORMAT or not {"scene", "columns"} <= set(about):
            raise ValueError(f"{beside(path).name} does not describe a series")
    except (OSError, ValueError) as error:
        raise _unreadable(path, error) from None
    return about


def beside(path: Path) -> Path:
    """Return where what describes a series lies."""
    return Path(path).with_suffix(".json")


def _unreadable(path: Path, error: Exception) -> InputError:
    return InputError(f"series {path} cannot be read: {one_line(error)}; give a file that a run wrote")


def _type(column: Column) -> str:
    return "U64" if column.is_text else "i8" if column.counts else "f8"


def _text(value: float | str, column: Column) -> str:
    """Return a value so that it reads back bit for bit; texts are to be words."""
    if isinstance(value, str):
        return value
    return str(int(value)) if column.counts else repr(float(value))


def _line(row: Mapping[str, float | str], columns: Sequence[Column]) -> str:
    return ",".join(_text(row.get(column.name, 0), column) for column in columns) + "\n"


def _publish(path: Path, columns: Sequence[Column], about: Provenance, rows: bytes) -> tuple[hashlib._Hash, int]:
    """Write a table with these lines of rows, and what describes it, in place of what is there.

    Return the checksum of both, and the bytes of the table.
    """
    described = {
        "format": FORMAT,
        "version": about.version,
        "seed": about.seed,
        "columns": [{"name": column.name, "type": _type(column), "unit": column.unit} for column in columns],
        "scene": about.scene,
    }
    description = json.dumps(described, indent=1).removeprefix("{\n").encode()
    table = (",".join(column.name for column in columns) + "\n").encode() + rows
    total = hashlib.sha256(description + table)
    for file, content in ((beside(path), _checksum(total.hexdigest(), len(table)) + description), (path, table)):
        temporary(file).write_bytes(content)
        publish(file)
    return total, len(table)


def _parsed(path: Path) -> tuple[list[bytes], NDArray[Any]]:
    """Return the complete lines of rows, and what they hold."""
    try:
        names, *rows = path.read_bytes().split(b"\n")[:-1]  # what follows the last line end was cut off by a kill
        columns = about_of(path)["columns"]
        if not {column["type"] for column in columns} <= TYPES:
            raise ValueError(f"a type of {beside(path).name} is none of {', '.join(sorted(TYPES))}")
        dtype = np.dtype([(column["name"], column["type"]) for column in columns])
        if names.decode().split(",") != list(dtype.names or ()):
            raise ValueError(f"its columns are not those of {beside(path).name}")
        values = (
            np.loadtxt([row.decode() for row in rows], delimiter=",", dtype=dtype, ndmin=1)
            if rows
            else np.zeros(0, dtype)
        )
    except (OSError, ValueError, TypeError, KeyError) as error:
        raise _unreadable(path, error) from None
    return rows, values


def _rows_to(path: Path, columns: Sequence[Column], step: int) -> bytes:
    """Return the lines of a series up to a step."""
    lines, values = _parsed(path)
    if values.dtype != np.dtype([(column.name, _type(column)) for column in columns]):
        raise ValueError("the file there has other columns")
    return b"".join(line + b"\n" for line, row in zip(lines, values, strict=True) if row[0] <= step)

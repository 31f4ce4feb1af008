"""The particle stages as plain loops in C, one particle at a time: what times per particle are divided by.

They are bound by memory and arithmetic as ours are, and are the same code whatever we change. So a time over theirs, both of
the same turn, can be compared between processors and between days.
"""

from __future__ import annotations

import ctypes
import functools
import subprocess
import tempfile
from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np

Array = np.ndarray
SOURCE = Path(__file__).with_suffix(".c")
COMMAND = ("cc", "-O3", "-march=native", "-fno-math-errno", "-shared", "-fPIC", "-o")
PLAIN = ("deposit", "gather+push", "migrate", "moments")  # stages that there are


@functools.cache
def library() -> ctypes.CDLL:
    """The loops, compiled for this processor."""
    with tempfile.TemporaryDirectory() as folder:
        out = Path(folder) / "plain.so"
        subprocess.run([*COMMAND, str(out), str(SOURCE), "-lm"], check=True)
        return ctypes.CDLL(str(out))


def _at(array: Array) -> ctypes.c_void_p:
    return ctypes.c_void_p(array.ctypes.data)


def _list(columns: Sequence[Array]) -> ctypes.Array[ctypes.c_void_p]:
    return (ctypes.c_void_p * len(columns))(*(column.ctypes.data for column in columns))


class PlainStages:
    """The stages of particles in the unit cube of `cells`³ cells, sorted as given; columns of (n,) each."""

    def __init__(
        self,
        cells: int,
        position: Array,
        momentum: Array,
        moved: Array,
        weight: Array,
        charge: float,
        mass: float,
        dt: float,
    ) -> None:
        """`position`, `momentum`, and `moved`, where `migrate` finds them: (n, 3) in SI; `weight` (n,), charge C, mass kg."""
        self._columns = [np.ascontiguousarray(c) for c in (*position.T, *momentum.T)]
        self._moved = [*(np.ascontiguousarray(c) for c in moved.T), *self._columns[3:]]
        self._weight = np.array(weight)
        self._id = np.arange(len(position), dtype=np.int64)
        self._cells, self._charge, self._mass, self._dt = cells, charge, mass, dt
        x, y, z = np.meshgrid(*[2 * np.pi * (np.arange(cells) + 0.5) / cells] * 3, indexing="ij", sparse=True)
        wave = np.sin(x) * np.cos(y + 2 * z)
        self._field = np.ascontiguousarray(np.stack([wave] * 3, axis=-1).transpose(2, 1, 0, 3))
        self.works: dict[str, Callable[[], object]] = {
            "deposit": self.deposit,
            "gather+push": self.gather_and_push,
            "migrate": self.migrate,
            "moments": self.moments,
        }

    @property
    def _count(self) -> ctypes.c_int64:
        return ctypes.c_int64(len(self._id))

    def _new(self) -> list[Array]:
        return [np.empty(len(self._id)) for _ in range(6)]

    def deposit(self) -> Array:
        """Return the charge in each cell, (cells, cells, cells), z slowest."""
        rho = np.empty((self._cells,) * 3)
        library().deposit(self._count, self._cells, *map(_at, self._columns[:3]), _at(self._weight), _at(rho))
        return rho

    def gather_and_push(self) -> list[Array]:
        """Return places and momenta after a step."""
        out, numbers = self._new(), (self._charge * self._dt, self._mass, self._dt)
        arguments = (_list(self._columns), _at(self._field), *map(ctypes.c_double, numbers), _list(out))
        library().gather_and_push(self._count, self._cells, *arguments)
        return out

    def migrate(self) -> tuple[list[Array], Array]:
        """Return places and momenta, and ids, by bricks."""
        out, ids = self._new(), np.empty_like(self._id)
        library().migrate(self._count, self._cells, _list(self._moved), _at(self._id), _list(out), _at(ids))
        return out, ids

    def moments(self) -> Array:
        """Return the sums."""
        out = np.empty(19)
        arguments = (
            _list(self._columns),
            _list(self._columns[3:]),
            _at(self._weight),
            ctypes.c_double(self._mass),
            _at(out),
        )
        library().moments(self._count, *arguments)
        return out

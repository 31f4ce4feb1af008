"""The cases that solvers are timed on: those of exact.amrex, one uniform mesh, and long and flat cells."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from mpi4py import MPI

import amrpic
from exact import amrex
from exact.sources import EPS0

Array = np.ndarray
Function = Callable[[Array, Array, Array], Array]
FAMILIES = ("static", "bunch", "uniform")
STRETCHED = {"cubes": (1.0, 1.0, 1.0), "1:1:10": (1.0, 1.0, 10.0), "1:5:5": (1.0, 5.0, 5.0)}


class Remembered:
    """A function of places that is evaluated once for each set of them: solvers are timed, not error functions."""

    def __init__(self, function: Function) -> None:
        self.function = function
        self._known: dict[tuple, Array] = {}

    def __call__(self, x: Array, y: Array, z: Array) -> Array:
        key = (len(x), *(float(axis[end]) for axis in (x, y, z) for end in (0, -1) if len(axis)))
        if key not in self._known:
            self._known[key] = self.function(x, y, z)
        return self._known[key]


@dataclass
class Problem:
    """A charge density in C/m³ on a hierarchy, the potential on its Dirichlet faces, and the exact one where it is known."""

    hierarchy: amrpic.Hierarchy
    density: Function
    walls: Function | None = None  # zero where none is given
    exact: Function | None = None

    @cached_property
    def rho(self) -> amrpic.Field:
        return amrpic.Field(self.hierarchy).fill(self.density)

    @property
    def cells(self) -> int:
        return sum(self.hierarchy.cells(level) for level in range(self.hierarchy.levels))


def problem(comm: MPI.Comm, case: str, boxes: int) -> Problem:
    """Return a case by name, "static 64" say, in boxes of at most so many cells along an axis. Collective."""
    family, size = case.split()
    n = int(size)
    if family == "static":
        source = amrex.static_source()
        hierarchy = amrex.static(comm, n, boxes)
    elif family == "bunch":
        ten = amrex.bunch_source()
        return Problem(amrex.bunch(comm, n, boxes), ten.density, Remembered(ten.potential), ten.potential)
    elif family == "uniform":
        domain = amrpic.Domain((0, 0, 0), (1, 1, 1), (n,) * 3, boundary="dirichlet")
        blocking = math.gcd(n, 8) if n % 2 == 0 else 8
        return Problem(amrpic.Hierarchy(comm, domain, (), boxes, blocking), amrex.static_source().density)
    else:
        return stretched(comm, family, n, boxes)
    return Problem(hierarchy, source.density, Remembered(source.potential), source.potential)


def stretched(comm: MPI.Comm, cells: str, n: int, boxes: int) -> Problem:
    """The mesh and charge of `static`, as wide as `cells` says, between grounded walls: cubes, or long or flat cells."""
    width = STRETCHED[cells]
    domain = amrpic.Domain((0, 0, 0), width, (n,) * 3, boundary="dirichlet")
    levels = [[((first * n // 2,) * 3, ((first + 2) * n // 2 - 1,) * 3)] for first in (1, 3)]
    hierarchy = amrpic.Hierarchy(comm, domain, levels, max_grid_size=boxes)

    def density(x: Array, y: Array, z: Array) -> Array:
        square = sum((axis / length - 0.5) ** 2 for axis, length in zip((x, y, z), width, strict=True))
        return EPS0 * np.exp(-square / (2 * 0.03**2))

    return Problem(hierarchy, density)

"""Meshes on which order is measured: each at any base resolution that is a multiple of eight."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np
from mpi4py import MPI

from amrpic.mesh.domain import BoundarySpec, Domain
from amrpic.mesh.hierarchy import Hierarchy

# A box as its lower and upper corners in eighths of the domain; a level is a list of them.
Eighths = tuple[tuple[float, float, float], tuple[float, float, float]]


@dataclass(frozen=True)
class Mesh:
    """Refined regions, in proportion to the domain."""

    levels: tuple[tuple[Eighths, ...], ...] = ()
    size: tuple[float, float, float] = (1.0, 1.0, 1.0)  # of the domain, m; its lower corner is the origin

    def hierarchy(self, comm: MPI.Comm, cells: int, boundary: BoundarySpec, max_grid_size: int = 32) -> Hierarchy:
        """The mesh with so many base cells per axis. Collective."""
        domain = Domain((0, 0, 0), self.size, (cells,) * 3, boundary=boundary)
        levels = [
            [(_index(lower, cells, level), tuple(i - 1 for i in _index(upper, cells, level))) for lower, upper in boxes]
            for level, boxes in enumerate(self.levels, start=1)
        ]
        return Hierarchy(comm, domain, levels, max_grid_size=max_grid_size, blocking_factor=2)


def blocks(comm: MPI.Comm, chosen: Callable[[int, int, int], bool], cells: int = 16, block: int = 4) -> Hierarchy:
    """The unit cube, with the chosen blocks of `block` fine cells refined. Collective."""
    count = 2 * cells // block
    boxes = [
        (tuple(block * i for i in place), tuple(block * i + block - 1 for i in place))
        for place in np.ndindex(count, count, count)
        if chosen(*place)
    ]
    domain = Domain((0, 0, 0), (1, 1, 1), (cells,) * 3, boundary="dirichlet")
    return Hierarchy(comm, domain, [boxes], max_grid_size=16, blocking_factor=block)


def _index(corner: tuple[float, float, float], cells: int, level: int) -> tuple[int, ...]:
    index = np.array(corner) / 8 * cells * 2**level
    assert np.all(index == np.round(index)), f"{corner} is between the cells of level {level}"
    return tuple(int(i) for i in index)


def around(levels: int) -> tuple[tuple[Eighths, ...], ...]:
    """Levels of one box each, half the size of the one before and off its centre."""
    lower, size, out = np.array([1.0, 2.0, 1.0]), 4.0, []
    for _ in range(levels):
        out.append(((tuple(lower), tuple(lower + size)),))
        lower = lower + size * np.array([1, 2, 3]) / 8
        size /= 2
    return tuple(out)


MIDDLE = ((2, 2, 2), (6, 6, 6))
MESHES: Mapping[str, Mesh] = {
    "uniform": Mesh(),
    "nested cubes": Mesh(((MIDDLE,), (((3, 3, 3), (5, 5, 5)),))),
    "L-shape": Mesh(((((2, 2, 2), (6, 4, 6)), ((2, 4, 2), (4, 6, 6))),)),
    "disjoint patches": Mesh(((((1, 1, 1), (3, 3, 3)), ((5, 5, 5), (7, 7, 7))),)),
    "patch at a face": Mesh(((((0, 2, 2), (3, 6, 6)),),)),
    "patch at an edge": Mesh(((((0, 0, 2), (3, 3, 6)),),)),
    "patch at a corner": Mesh(((((0, 0, 0), (3, 3, 3)),),)),
    "six levels off centre": Mesh(around(6)),
    "cells 1:1:10": Mesh(((MIDDLE,),), size=(1.0, 1.0, 10.0)),
}

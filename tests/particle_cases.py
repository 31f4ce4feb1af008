"""Particles on the awkward hierarchies, and a deposit and gather in plain NumPy that share no code with the package."""

from __future__ import annotations

import itertools

import numpy as np
from mpi4py import MPI

import amrpic
import hierarchies
from amrpic.particles import Particles
from amrpic.species import Species, SpeciesTable

CHARGE, MASS = -1.5e-19, 9e-31
ONE_KIND = SpeciesTable((Species(charge=CHARGE, mass=MASS),))


def hierarchy_of(case: hierarchies.Case, comm: MPI.Comm) -> amrpic.Hierarchy:
    domain = amrpic.Domain(case.lower, case.upper, case.cells, case.boundary)
    return amrpic.Hierarchy(comm, domain, case.levels, case.max_grid_size, case.blocking_factor)


def scattered(hierarchy: amrpic.Hierarchy, count: int, seed: int = 0) -> Particles:
    """Return this rank's part of random particles that fill the domain up to its walls."""
    rng = np.random.default_rng(seed)
    lower, upper = np.array(hierarchy.domain.lower), np.array(hierarchy.domain.upper)
    position = lower + (upper - lower) * rng.random((count, 3))
    particles = Particles(
        position, rng.normal(size=(count, 3)), rng.random(count), np.arange(count, dtype=np.int64), ONE_KIND
    )
    return particles.select(slice(hierarchy.comm.rank, None, hierarchy.comm.size))


def everywhere(comm: MPI.Comm, particles: Particles) -> dict[str, np.ndarray]:
    """Return the arrays of the particles of all ranks, in order of their ids, on every rank."""
    parts = comm.allgather(tuple(np.array(a) for a in particles.arrays))
    arrays = [np.concatenate(pieces) for pieces in zip(*parts, strict=True)]
    order = np.argsort(arrays[3])
    return {name: a[order] for name, a in zip(("position", "momentum", "weight", "id"), arrays, strict=True)}


def dense(field: amrpic.Field, level: int) -> np.ndarray:
    """Return the field on a level as one array over the whole domain, nan where the level has no cells, on every rank."""
    hierarchy = field.hierarchy
    out = np.full(np.array(hierarchy.domain.cells) * 2**level, np.nan)
    mine = [(p.lower, p.upper, np.array(p.data)) for p in field.patches if p.level == level]
    for lower, upper, data in itertools.chain(*hierarchy.comm.allgather(mine)):
        out[tuple(slice(a, b + 1) for a, b in zip(lower, upper, strict=True))] = data
    return out


class Mesh:
    """All levels as dense arrays: which cells exist, and how they are found."""

    def __init__(self, hierarchy: amrpic.Hierarchy) -> None:
        self.domain = hierarchy.domain
        self.exists = []
        for level in range(hierarchy.levels):
            mask = np.zeros(np.array(self.domain.cells) * 2**level, dtype=bool)
            for box in hierarchy.boxes(level):
                mask[box[0] : box[3] + 1, box[1] : box[4] + 1, box[2] : box[5] + 1] = True
            self.exists.append(mask)

    def coordinate(self, x: np.ndarray, level: int) -> np.ndarray:
        return (x - np.array(self.domain.lower)) / self.domain.spacing * 2**level

    def finest(self, x: np.ndarray) -> int:
        """Return the finest level that has the cell around a point."""
        levels = [l for l in range(len(self.exists)) if self.exists[l][tuple(self.coordinate(x, l).astype(int))]]
        return max(levels)

    def inside(self, level: int, cell: np.ndarray) -> tuple[int, ...]:
        """Return the cell that stands for one beyond the domain: its periodic image, or the wall cell."""
        size = self.exists[level].shape
        pairs = zip(cell, size, self.domain.periodic, strict=True)
        return tuple(int(c % n) if wraps else int(min(max(c, 0), n - 1)) for c, n, wraps in pairs)

    def cloud(self, x: np.ndarray, level: int) -> list[tuple[np.ndarray, float]]:
        """Return the eight cells that a particle touches, with its share in each."""
        s = self.coordinate(x, level) - 0.5
        low = np.floor(s).astype(int)
        out = []
        for corner in itertools.product((0, 1), repeat=3):
            cell = low + corner
            out.append((cell, float(np.prod(1 - np.abs(s - cell)))))
        return out

    def covered(self, level: int, cell: tuple[int, ...]) -> bool:
        return level + 1 < len(self.exists) and bool(self.exists[level + 1][tuple(2 * c for c in cell)])


def deposit_by_hand(mesh: Mesh, particles: dict[str, np.ndarray]) -> list[np.ndarray]:
    """Return the charge per cell of each level, uncovered cells only."""
    charge = [np.zeros(mask.shape) for mask in mesh.exists]

    def give(level: int, cell: np.ndarray, share: float) -> None:
        place = mesh.inside(level, cell)
        if not mesh.exists[level][place]:
            give(level - 1, np.array(place) // 2, share)
        elif mesh.covered(level, place):
            for corner in itertools.product((0, 1), repeat=3):
                give(level + 1, 2 * np.array(place) + corner, share / 8)
        else:
            charge[level][place] += share

    for x, weight in zip(particles["position"], particles["weight"], strict=True):
        level = mesh.finest(x)
        for cell, share in mesh.cloud(x, level):
            give(level, cell, share * weight * CHARGE)
    return charge


def gather_by_hand(mesh: Mesh, values: list[np.ndarray], position: np.ndarray) -> np.ndarray:
    """Return a field, given dense on each level, at the positions."""

    def at(level: int, cell: np.ndarray) -> float:
        place = mesh.inside(level, cell)
        if mesh.exists[level][place]:
            return values[level][place]
        parent, side = np.array(place) // 2, 2 * (np.array(place) % 2) - 1
        total = 0.0
        for corner in itertools.product((0, 1), repeat=3):
            total += 0.75 ** (3 - sum(corner)) * 0.25 ** sum(corner) * at(level - 1, parent + side * corner)
        return total

    out = np.empty(len(position))
    for n, x in enumerate(position):
        level = mesh.finest(x)
        out[n] = sum(share * at(level, cell) for cell, share in mesh.cloud(x, level))
    return out

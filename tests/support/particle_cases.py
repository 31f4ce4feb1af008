"""Particles on the awkward hierarchies, and a deposit and gather in plain NumPy that share no code with the package."""

from __future__ import annotations

import itertools

import numpy as np
import pytest
from mpi4py import MPI

import amrpic
import hierarchies
from amrpic.particles.clouds import PLAIN, Clouds
from amrpic.particles.particles import Particles
from amrpic.particles.species import Species, SpeciesTable
from amrpic.stages.deposit import deposit
from amrpic.stages.migrate import migrate

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


def placed(case: hierarchies.Case, comm: MPI.Comm, count: int) -> tuple[amrpic.Hierarchy, Particles]:
    hierarchy = hierarchy_of(case, comm)
    particles, lost = migrate(scattered(hierarchy, count), hierarchy)
    assert len(lost) == 0
    return hierarchy, particles


def assert_same_bits(particles: Particles, expected: Particles) -> None:
    """This rank's particles, one by one."""
    for array, expected_array in zip(particles.arrays, expected.arrays, strict=True):
        np.testing.assert_array_equal(array, expected_array)


def everywhere(comm: MPI.Comm, particles: Particles) -> dict[str, np.ndarray]:
    """Return the arrays of the particles of all ranks, in order of their ids, on every rank."""
    parts = comm.allgather(tuple(np.array(a) for a in particles.arrays))
    arrays = [np.concatenate(pieces) for pieces in zip(*parts, strict=True)]
    order = np.argsort(arrays[3])
    return {name: a[order] for name, a in zip(("position", "momentum", "weight", "id"), arrays, strict=True)}


def places(comm: MPI.Comm, particles: Particles) -> np.ndarray:
    """Return where each particle lies among those of all ranks, by id, on every rank. Ids are 0, 1, 2 and so on."""
    ids = np.concatenate(comm.allgather(particles.id))
    out = np.empty_like(ids)
    out[ids] = np.arange(len(ids))
    return out


def dense(field: amrpic.Field, level: int) -> np.ndarray:
    """Return the field on a level as one array over the whole domain, nan where the level has no cells, on every rank."""
    hierarchy = field.hierarchy
    out = np.full(np.array(hierarchy.domain.cells) * 2**level, np.nan)
    mine = [(p.lower, p.upper, np.array(p.data)) for p in field.patches if p.level == level]
    for lower, upper, data in itertools.chain(*hierarchy.comm.allgather(mine)):
        out[tuple(slice(a, b + 1) for a, b in zip(lower, upper, strict=True))] = data
    return out


def random_field(hierarchy: amrpic.Hierarchy) -> amrpic.Field:
    """A field of noise that does not depend on the ranks, covered cells the mean of their children."""
    return amrpic.Field(hierarchy).fill(lambda x, y, z: np.sin(1e4 * x * (y + 2) + 3e4 * z)).average_down()


# Share of a cell in a particle at `x`, in cell widths from the lower face of the cell.
SPLINES = {
    "nearest-grid-point": lambda x: float(0 <= x < 1),
    "cloud-in-cell": lambda x: max(0.0, 1 - abs(x - 0.5)),
    "triangular-shaped-cloud": lambda x: (
        0.75 - (x - 0.5) ** 2 if abs(x - 0.5) < 0.5 else max(0.0, 1.5 - abs(x - 0.5)) ** 2 / 2
    ),
}


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

    def cloud_level(self, x: np.ndarray, clouds: Clouds) -> int:
        """Return the level on which a particle is spread: matched clouds of particles that are less than one cell of the next
        coarser level away from an unrefined cell of it belong to that level, and there it may be so again."""
        level = self.finest(x)
        while clouds.matched and level > 0 and self._distance_to_unrefined(x, level - 1) <= 1:
            level -= 1
        return level

    def _distance_to_unrefined(self, x: np.ndarray, level: int) -> float:
        """Return the largest of the distances along the axes, in cells of the level, up to two of them."""
        s = self.coordinate(x, level)
        nearest = 2.0
        for step in itertools.product((-1, 0, 1), repeat=3):
            cell = s.astype(int) + step
            if not self.covered(level, self.inside(level, cell)):
                nearest = min(nearest, float(np.maximum(np.maximum(cell - s, s - cell - 1), 0).max()))
        return nearest

    def cloud(self, x: np.ndarray, level: int, shape: str = "cloud-in-cell") -> list[tuple[np.ndarray, float]]:
        """Return the cells that a particle touches, with its share in each."""
        s = self.coordinate(x, level)
        axes = [[(cell, SPLINES[shape](s[d] - cell)) for cell in int(s[d]) + np.array([-1, 0, 1])] for d in range(3)]
        cloud = [(np.array(cells), np.prod(w)) for cells, w in (zip(*c, strict=True) for c in itertools.product(*axes))]
        return [(cell, float(share)) for cell, share in cloud if share > 0]

    def covered(self, level: int, cell: tuple[int, ...]) -> bool:
        return level + 1 < len(self.exists) and bool(self.exists[level + 1][tuple(2 * c for c in cell)])


def deposit_by_hand(mesh: Mesh, particles: dict[str, np.ndarray], clouds: Clouds = PLAIN) -> list[np.ndarray]:
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
        level = mesh.cloud_level(x, clouds)
        for cell, share in mesh.cloud(x, level, clouds.shape):
            give(level, cell, share * weight * CHARGE)
    return charge


def gather_by_hand(mesh: Mesh, values: list[np.ndarray], position: np.ndarray, clouds: Clouds = PLAIN) -> np.ndarray:
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
        level = mesh.cloud_level(x, clouds)
        out[n] = sum(share * at(level, cell) for cell, share in mesh.cloud(x, level, clouds.shape))
    return out


def assert_as_by_hand(
    hierarchy: amrpic.Hierarchy, particles: Particles, case: hierarchies.Case, clouds: Clouds = PLAIN
) -> None:
    density, mesh = deposit(particles, hierarchy, clouds), Mesh(hierarchy)
    expected = deposit_by_hand(mesh, everywhere(hierarchy.comm, particles), clouds)
    scale = abs(particles.total_charge(hierarchy.comm))
    for level in reversed(range(hierarchy.levels)):
        if level + 1 < hierarchy.levels:  # covered cells hold the sum of their children
            nx, ny, nz = expected[level].shape
            expected[level] += expected[level + 1].reshape(nx, 2, ny, 2, nz, 2).sum(axis=(1, 3, 5))
        found = dense(density, level) * np.prod(hierarchy.spacing(level))
        exists = mesh.exists[level]
        assert np.array_equal(~np.isnan(found), exists)
        assert found[exists] == pytest.approx(expected[level][exists], rel=0, abs=1e-14 * scale), (case.name, clouds)

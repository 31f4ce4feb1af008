"""What a preview warns of: bunches that the mesh does not resolve, too few particles in cells, open faces that are near."""

from __future__ import annotations

import itertools
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from ..mesh.domain import AXES, Domain
from ..mesh.field import Field
from ..mesh.hierarchy import Hierarchy
from ..mpi import MPI
from ..particles.particles import Particles
from ..scene.scene import Scene
from ..stages.diagnostics import moments
from ..stages.tag import living
from ..units import falls_short

CELLS_PER_SIGMA = 2.0
PARTICLES_PER_CELL = 3.0  # in cells that hold any, on the level that holds most particles
SIGMAS_TO_FACE = 4.0


@dataclass(frozen=True)
class _Extent:
    """Where a bunch is, each (3,) in m."""

    mean: np.ndarray
    rms: np.ndarray
    first: np.ndarray  # particle along each axis that has walls
    last: np.ndarray

    @classmethod
    def of(cls, comm: MPI.Comm, bunch: Particles, domain: Domain) -> _Extent:
        """Return that of a bunch, nan without particles. Collective."""
        measured = moments(comm, bunch, domain=domain)
        ends = np.array([-bunch.position.min(axis=0, initial=np.inf), bunch.position.max(axis=0, initial=-np.inf)])
        first, last = comm.allreduce(ends, MPI.MAX)
        return cls(measured.mean, measured.rms, -first, last)


def warnings_of(scene: Scene, particles_per_cell: Field, bunches: Sequence[Particles]) -> list[str]:
    """Return one sentence for each thing that spoils results and can be seen before a run. Collective.

    `bunches` are those of the scene one by one, in their order.
    """
    comm, hierarchy = particles_per_cell.comm, particles_per_cell.hierarchy
    out: list[str] = []
    bunches_left = iter(bunches)
    for number, bunch in enumerate(scene.bunches):
        copies = [_Extent.of(comm, copy, hierarchy.domain) for copy in itertools.islice(bunches_left, bunch.copies)]
        sized = [extent for extent in copies if np.isfinite(extent.rms).all() and extent.rms.min() > 0]
        if sized:
            out += _of_bunch(f"bunches.{number}", sized, hierarchy)
    return [*out, *_few_in_cells(particles_per_cell)]


def _of_bunch(name: str, copies: Sequence[_Extent], hierarchy: Hierarchy) -> Iterator[str]:
    domain, finest = hierarchy.domain, hierarchy.spacing(hierarchy.levels - 1)
    cells = np.min([extent.rms for extent in copies], axis=0) / finest
    axis = int(np.argmin(cells))
    if falls_short(cells[axis], CELLS_PER_SIGMA):
        yield (
            f"{name} has {cells[axis]:.2g} cells of the finest level per rms size along {AXES[axis]}, where "
            f"{CELLS_PER_SIGMA:g} are advisable; raise refinement.levels or domain.cells"
        )
    for at, (side, face, end) in enumerate((("lower", domain.lower, "first"), ("upper", domain.upper, "last"))):
        distance = np.min([np.abs(face - extent.mean) / extent.rms for extent in copies], axis=0)
        # beyond the last particle; a bunch that ends well before the face is none of these
        room = np.min(
            [np.abs(face - extent.mean) - np.abs(getattr(extent, end) - extent.mean) - extent.rms for extent in copies],
            axis=0,
        )
        # walls may be near on purpose, as a cathode is
        cut = np.array([faces[at] == "open" for faces in domain.boundary]) & (room <= 0)
        axis = int(np.argmin(np.where(cut, distance, np.inf)))
        if cut[axis] and falls_short(distance[axis], SIGMAS_TO_FACE):
            yield (
                f"{name} has its centre {distance[axis]:.2g} rms sizes from the face {AXES[axis]}_{side}, where "
                f"{SIGMAS_TO_FACE:g} are advisable; enlarge the domain"
            )


def _few_in_cells(particles_per_cell: Field) -> Iterator[str]:
    """Warn of noise on the level that holds most particles."""
    comm = particles_per_cell.comm
    sums = comm.allreduce(
        np.array([[numbers.sum(), np.count_nonzero(numbers)] for numbers in living(particles_per_cell)], dtype=float)
    )
    level = int(np.argmax(sums[:, 0]))
    particles, cells = sums[level]
    if particles > 0 and falls_short(particles / cells, PARTICLES_PER_CELL):
        yield (
            f"cells of level {level} that hold particles hold {particles / cells:.2g} of them in the mean, where "
            f"{PARTICLES_PER_CELL:g} are advisable: the density is mostly noise; use more particles or fewer levels"
        )

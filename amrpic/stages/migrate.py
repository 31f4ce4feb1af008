"""Migrate: particles to the ranks that own their boxes."""

from __future__ import annotations

import numpy as np
from mpi4py import MPI

from .. import _native
from ..errors import ParticleError
from ..mesh.hierarchy import Hierarchy
from ..parallel import raise_together
from ..particles.particles import Particles, Sorting

NONE = np.zeros(0, dtype=np.int64)


def migrate(particles: Particles, hierarchy: Hierarchy) -> tuple[Particles, Particles]:
    """Return this rank's particles, and those that it lost because they lie outside the domain. Collective.

    Positions are wrapped along periodic axes. Each particle goes to the rank that owns the finest box around it, and is sorted
    there by level, box and brick of 8³ cells. Those of a brick keep their order: by the rank and the place where they were, and
    behind them those that came through a periodic face. Lost particles stay as they are, on the rank that held them. Raises
    ParticleError on all ranks if a position or momentum is not finite.
    """
    arrived, lost = migrate_without(particles, hierarchy, NONE)
    return arrived, particles.select(lost)


def migrate_without(particles: Particles, hierarchy: Hierarchy, gone: np.ndarray) -> tuple[Particles, np.ndarray]:
    """Return the same as `migrate` without the particles at some indices, int64 (m,) ascending; of the lost ones the indices.

    Collective.
    """
    weight = particles.one_weight(hierarchy.comm)
    given = particles if weight is not None else particles.with_own_weights()
    plan = _native.Migration(hierarchy.particle_mesh, *given.arrays, gone)
    here = Particles.allocate(plan.arriving, particles.species, weight)
    starts = np.empty(hierarchy.particle_mesh.slots + 1, dtype=np.int64)
    finite = plan.finish(*here.arrays, starts)
    if not hierarchy.comm.allreduce(finite, MPI.LAND):
        _refuse_not_finite(particles, hierarchy.comm)
    arrived = Particles(*here.arrays, here.species, Sorting(hierarchy, starts))
    return arrived, plan.lost


def particles_per_box(particles: Particles, hierarchy: Hierarchy) -> list[np.ndarray]:
    """Return the number of particles in each box, int64 (boxes,) per level, the same on all ranks. Collective.

    The particles may be sorted on another hierarchy, or not at all; those outside the domain are not counted.
    """
    counts = _native.count_per_box(hierarchy.native, particles.position)
    for level in counts:
        hierarchy.comm.Allreduce(MPI.IN_PLACE, level)
    return counts


def _refuse_not_finite(particles: Particles, comm: MPI.Comm) -> None:
    """Raise ParticleError on all ranks: a rank that holds particles that are not finite names one. Collective."""
    bad = np.flatnonzero(~(np.isfinite(particles.position) & np.isfinite(particles.momentum)).all(axis=1))
    count = comm.allreduce(len(bad))
    raise_together(comm, _complaint(particles, bad[0], count) if len(bad) else None, ParticleError)


def _complaint(particles: Particles, first: int, count: int) -> str:
    return (
        f"{count} particles have a position or momentum that is not finite, among them id {particles.id[first]} at "
        f"{particles.position[first].tolist()} m with {particles.momentum[first].tolist()} kg m/s; correct the input or "
        "the fields of elements, or shorten the time step"
    )

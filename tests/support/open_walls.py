"""Values behind open walls: meshes and charges on them, and the values of all ranks as planes."""

from __future__ import annotations

import numpy as np
from mpi4py import MPI

from amrpic import Domain, Field, Hierarchy
from amrpic._native import FreeSpace


def mesh(cells, spacing=(1.0, 1.0, 1.0), refined=(), comm=MPI.COMM_SELF, boundary="open", **kwargs):
    """A hierarchy with `refined` boxes of level 1, all cut on any pair of cells."""
    domain = Domain((0, 0, 0), tuple(n * h for n, h in zip(cells, spacing, strict=True)), cells, boundary)
    return Hierarchy(comm, domain, [list(refined)] if refined else [], **{"blocking_factor": 2, **kwargs})


def density(hierarchy, *charges):
    """The density of charges given on all cells of each level, (x, y, z)."""
    out = Field(hierarchy)
    for patch in out.patches:
        inside = tuple(slice(a, b + 1) for a, b in zip(patch.lower, patch.upper, strict=True))
        patch.data[...] = charges[patch.level][inside] / np.prod(hierarchy.spacing(patch.level))
    return out


def with_patch(fine, lower, upper, shape=(1, 1, 1), comm=MPI.COMM_SELF, **kwargs):
    """The density of charges given on fine cells, on a patch of these (base cells lower .. upper) and base cells around it;
    the domain has edges of `shape`."""
    n = fine.shape[0] // 2
    base = fine.reshape(n, 2, n, 2, n, 2).sum((1, 3, 5))
    patch = (tuple(2 * a for a in lower), tuple(2 * b + 1 for b in upper))
    return density(mesh((n, n, n), np.array(shape) / n, [patch], comm, **kwargs), base, fine)


def noise(shape):
    """Charges that are much larger here and there."""
    return np.random.default_rng(5).random(shape) ** 8


def own_walls(rho, **kwargs):
    """Per level the faces, cells and values behind this rank's open walls."""
    return FreeSpace(rho.hierarchy.native, **kwargs).walls(rho.native)


def planes_of(rho, level=0, **kwargs):
    """Values behind the six walls, (lower axis, upper axis), of all ranks; nan where there are none. Collective."""
    faces, cells, values = own_walls(rho, **kwargs)[level]
    extent = np.array(rho.hierarchy.domain.cells) << level
    out = []
    for face in range(6):
        axes = [d for d in range(3) if d != face // 2]
        plane = np.full(extent[axes], -np.inf)
        plane[tuple(cells[faces == face][:, axes].T)] = values[faces == face]
        rho.hierarchy.comm.Allreduce(MPI.IN_PLACE, plane, op=MPI.MAX)
        out.append(np.where(np.isinf(plane), np.nan, plane))
    return out


def walls(charges, spacing=(1.0, 1.0, 1.0), boundary="open", **kwargs):
    """Values behind the walls of a mesh of one level."""
    return planes_of(density(mesh(charges.shape, spacing, boundary=boundary), charges), **kwargs)


def greatest_difference(planes, others):
    return max(np.abs(a - b).max() for a, b in zip(planes, others, strict=True))

"""Which cells want refinement: by charge density, by field strength, and fixed regions.

Tags are one bool array per level, 1-D, aligned with `Field.array(level)`: this rank's cells, covered ones included, so
that a refined region stays refined while it still qualifies.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from mpi4py import MPI

from .errors import HierarchyError
from .field import Field, VectorField
from .hierarchy import Domain
from .parallel import raise_together

Tags = list[np.ndarray]
Region = tuple[int, Sequence[float], Sequence[float]]  # level that must exist there, lower and upper corner in m


def by_density(rho: Field, above: float, relative: bool = False) -> Tags:
    """Return where |ρ| exceeds `above` C/m³, or if `relative` that share of its maximum. Collective."""
    return _beyond([np.abs(rho.array(level)) for level in range(rho.hierarchy.levels)], above, relative, rho, "density")


def by_field(efield: VectorField, above: float, relative: bool = False) -> Tags:
    """Return where |E| exceeds `above` V/m, or if `relative` that share of its maximum. Collective."""
    strength = [
        np.sqrt(sum(component.array(level) ** 2 for component in efield.components))
        for level in range(efield.hierarchy.levels)
    ]
    return _beyond(strength, above, relative, efield.x, "field")


def _beyond(strength: list[np.ndarray], above: float, relative: bool, field: Field, what: str) -> Tags:
    comm = field.comm
    bad = sum(int(np.count_nonzero(~np.isfinite(values))) for values in strength)
    message = f"the {what} is not finite in {bad} cells of rank {comm.rank}, so no refinement follows from it"
    raise_together(comm, f"{message}; look for the step that broke it" if bad else None, HierarchyError)
    if relative:
        above = above * comm.allreduce(max((float(v.max()) for v in strength if v.size), default=0.0), op=MPI.MAX)
    return [values > above for values in strength]


def either(first: Tags, *others: Tags) -> Tags:
    """Return the cells that any of the given tags asks for."""
    return [np.logical_or.reduce(levels) for levels in zip(first, *others, strict=True)]


def tagged(comm: MPI.Comm, tags: Tags) -> list[int]:
    """Return the number of tagged cells per level, over all ranks. Collective."""
    return comm.allreduce(np.array([np.count_nonzero(values) for values in tags], dtype=np.int64)).tolist()


def static_boxes(domain: Domain, regions: Sequence[Region]) -> list[np.ndarray]:
    """Return the cells that regions in metres touch, as index boxes per refined level.

    Entry k holds the boxes (n, 6) of level k + 1 in its own indices, one per region that names this level. Along
    periodic axes a region may reach beyond the domain; along others it is clipped.

    Raises HierarchyError for a region without volume, outside the domain, or of a level below 1.
    """
    boxes = [
        (level, _index_box(domain, level, np.asarray(lo, float), np.asarray(up, float))) for level, lo, up in regions
    ]
    finest = max((level for level, _ in boxes), default=0)
    return [
        np.array([box for of, box in boxes if of == level], dtype=np.int32).reshape(-1, 6)
        for level in range(1, finest + 1)
    ]


def _index_box(domain: Domain, level: int, lower: np.ndarray, upper: np.ndarray) -> np.ndarray:
    what = f"static region from {lower.tolist()} to {upper.tolist()} m"
    if level < 1:
        raise HierarchyError(f"{what} asks for level {level}; refined levels start at 1")
    if max(domain.cells) * 2**level > 2**30:
        raise HierarchyError(f"{what} asks for level {level} with more than 2^30 cells along an axis; use fewer levels")
    if not (lower.shape == upper.shape == (3,) and np.all(np.isfinite([lower, upper])) and np.all(lower < upper)):
        raise HierarchyError(f"{what} has no volume; give three finite numbers each, upper ones above lower ones")
    spacing, cells = domain.spacing / 2**level, np.array(domain.cells) * 2**level
    # A face given on a cell face, as far as rounding can tell, touches no cell beyond it.
    slack = 1e-9
    first = np.floor((lower - domain.lower) / spacing + slack).astype(int)
    last = np.ceil((upper - domain.lower) / spacing - slack).astype(int) - 1
    wall = ~np.array(domain.periodic)
    if np.any(wall & ((last < 0) | (first >= cells))):
        limits = f"{list(domain.lower)} to {list(domain.upper)} m"
        raise HierarchyError(f"{what} lies outside the domain, {limits}; move it inside")
    first, last = np.where(wall, np.maximum(first, 0), first), np.where(wall, np.minimum(last, cells - 1), last)
    return np.concatenate([first, np.maximum(first, last)])

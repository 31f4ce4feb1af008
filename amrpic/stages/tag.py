"""Tag: cells to refine, by what they hold.

Tags are one bool array per level, 1-D, aligned with `Field.array(level)`: this rank's cells, covered ones included, so
that a refined region stays refined while it still qualifies.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from functools import partial
from typing import Any

import numpy as np

from .. import _native
from ..conductors.conductor import Conductor
from ..conductors.refined import Beside
from ..errors import HierarchyError, InputError
from ..mesh.domain import Domain
from ..mesh.field import Field, VectorField
from ..mesh.hierarchy import Hierarchy
from ..mesh.periods import nearest
from ..mpi import MPI
from ..parallel import raise_together, together
from ..particles.particles import Particles

Tags = list[np.ndarray]
Region = tuple[int, Sequence[float], Sequence[float]]  # level that must exist there, lower and upper corner in m


# ---- by the magnitude of a field ----
def magnitude(field: Field | VectorField, what: str) -> list[np.ndarray]:
    """Return |field| per level. Collective; HierarchyError on all ranks, naming `what`, if a value is not finite."""
    comm, levels = field.hierarchy.comm, range(field.hierarchy.levels)
    if isinstance(field, VectorField):
        values = [np.sqrt(sum(part.array(level) ** 2 for part in field.components)) for level in levels]
    else:
        values = [np.abs(field.array(level)) for level in levels]
    bad = sum(int(np.count_nonzero(~np.isfinite(v))) for v in values)
    message = f"the {what} is not finite in {bad} cells of rank {comm.rank}, so no refinement follows from it"
    raise_together(comm, f"{message}; look for the step that broke it" if bad else None, HierarchyError)
    return values


def largest(comm: MPI.Comm, values: Sequence[np.ndarray]) -> np.ndarray:
    """Return the largest of each level's values over all ranks; 0 where there are none. Collective."""
    most = np.array([v.max(initial=0.0) for v in values])
    comm.Allreduce(MPI.IN_PLACE, most, op=MPI.MAX)
    return most


def exceeding(values: Sequence[np.ndarray], above: Sequence[float] | np.ndarray) -> Tags:
    """Return where the values of each level exceed the threshold of that level."""
    return [level > threshold for level, threshold in zip(values, above, strict=True)]


# ---- by particles ----
def count(particles: Particles, hierarchy: Hierarchy, chosen: np.ndarray | None = None) -> Field:
    """Return how many macroparticles each cell holds, covered cells those of their children. Collective.

    `chosen`, bool (n,), leaves the others out. Particles must be sorted on the hierarchy.
    """
    sorting, numbers = particles.sorted_on(hierarchy), Field.unset(hierarchy)
    position, momentum, _, id = particles.arrays
    weight = np.broadcast_to(1.0, len(particles)) if chosen is None else chosen.astype(float)
    shape = _native.Shape.nearest_grid_point
    arrays = position, momentum, weight, id, sorting.starts
    _native.Deposition(
        hierarchy.particle_mesh, sorting.remote, shape, False, False, *arrays, 1.0, numbers.native
    ).finish()
    for level in range(hierarchy.levels):
        numbers.array(level)[:] = np.rint(numbers.array(level) * hierarchy.spacing(level).prod())
    return numbers


def living(numbers: Field) -> list[np.ndarray]:
    """Return how many macroparticles live in each cell of this rank, per level, in covered ones none; `numbers` by `count`."""
    out = []
    for level in range(numbers.hierarchy.levels):
        patches = [patch for patch in numbers.patches if patch.level == level]
        cells = [np.where(patch.covered, 0, patch.data).ravel(order="F") for patch in patches]
        out.append(np.concatenate([np.zeros(0), *cells]))
    return out


def between(numbers: Field, at_least: float, at_most: float) -> Tags:
    """Return the cells that hold something, at least and at most so much of it."""
    levels = (numbers.array(level) for level in range(numbers.hierarchy.levels))
    return [(n > 0) & (n >= at_least) & (n <= at_most) for n in levels]


def largest_inside(size: np.ndarray, particles: Particles, hierarchy: Hierarchy) -> np.ndarray:
    """Return the largest of a value per particle, (n,), inside each level, over all ranks. Collective."""
    sorting = particles.sorted_on(hierarchy)
    level_of = np.repeat(sorting.levels, np.diff(sorting.starts))
    on_level = largest(hierarchy.comm, [size[level_of == level] for level in range(hierarchy.levels)])
    return np.maximum.accumulate(on_level[::-1])[::-1]  # what lies on a level lies inside all coarser ones


def holding(size: np.ndarray, particles: Particles, hierarchy: Hierarchy, above: Sequence[float] | np.ndarray) -> Tags:
    """Return the cells that hold a particle whose value, of (n,), exceeds the threshold of their level. Collective."""
    beyond = {threshold: count(particles, hierarchy, size > threshold) for threshold in np.unique(above)}
    return [beyond[threshold].array(level) > 0 for level, threshold in enumerate(above)]


def in_spreads(values: np.ndarray, mean: np.ndarray, rms: np.ndarray) -> np.ndarray:
    """Return how many rms spreads values (n, 3) lie from their mean, (n,); components that spread by rounding do not count."""
    spread = rms > 1e-9 * np.linalg.norm(mean)
    return distance([values[:, d] - mean[d] for d in np.flatnonzero(spread)], rms[spread]) + np.zeros(len(values))


def distance(offsets: Sequence[np.ndarray], units: Sequence[float] | np.ndarray) -> np.ndarray:
    """Return the length of a vector whose components, arrays that broadcast, are each measured in a unit of its own."""
    return np.sqrt(sum(((offset / unit) ** 2 for offset, unit in zip(offsets, units, strict=True)), np.zeros(())))


# ---- by a function ----
def by_function(
    hierarchy: Hierarchy,
    function: Callable[..., Any],
    name: str,
    arguments: Sequence[str],
    quantities: Mapping[str, Field | VectorField | float],
) -> Tags:
    """Return where a function says so, called for each box of this rank with the arguments it names. Collective.

    `arguments` are names of `quantities`, level, x, y and z. Raises InputError on all ranks if the function fails on one.
    """
    tags = Field(hierarchy)
    with together(hierarchy.comm, InputError):
        for number, patch in enumerate(tags.patches):
            at_cells: dict[str, Any] = {"level": patch.level, **dict(zip("xyz", patch.centres(), strict=True))}
            at_cells |= {key: _on_patch(value, number) for key, value in quantities.items()}
            where = (
                f"the function {name} of refinement.rule on level {patch.level}, cells {patch.lower} to {patch.upper},"
            )
            try:
                answer = np.asarray(function(**{key: at_cells[key] for key in arguments}))
            except Exception as failure:
                raise InputError(f"{where} raised {type(failure).__name__}: {failure}; correct it") from failure
            patch.data[...] = _as_tags(answer, patch.data.shape, where)
    return [tags.array(level) > 0 for level in range(hierarchy.levels)]


def _on_patch(value: Field | VectorField | float, number: int) -> Any:
    if isinstance(value, VectorField):
        return tuple(_on_patch(component, number) for component in value.components)
    if not isinstance(value, Field):
        return value
    data = value.patches[number].data.view()
    data.flags.writeable = False
    return data


def _as_tags(answer: np.ndarray, shape: tuple[int, ...], where: str) -> np.ndarray:
    if answer.dtype != bool:
        raise InputError(f"{where} returned values of type {answer.dtype}; return bool, such as rho > 1e-6")
    try:
        return np.broadcast_to(answer, shape)
    except ValueError:
        raise InputError(f"{where} returned the shape {answer.shape}; return one bool per cell, {shape}") from None


# ---- together ----
def either(first: Tags, *rest_of_tags: Tags) -> Tags:
    """Return the cells that any of the given tags asks for."""
    return [np.logical_or.reduce(levels) for levels in zip(first, *rest_of_tags, strict=True)]


def both(first: Tags, *rest_of_tags: Tags) -> Tags:
    """Return the cells that all of the given tags ask for."""
    return [np.logical_and.reduce(levels) for levels in zip(first, *rest_of_tags, strict=True)]


def on_levels(tags: Tags, levels: Sequence[int]) -> Tags:
    """Return the tags of some levels alone."""
    return [values if level in levels else np.zeros_like(values) for level, values in enumerate(tags)]


def tagged(comm: MPI.Comm, tags: Tags) -> list[int]:
    """Return the number of tagged cells per level, over all ranks. Collective."""
    return comm.allreduce(np.array([np.count_nonzero(values) for values in tags], dtype=np.int64)).tolist()


# ---- by place ----
def within(
    hierarchy: Hierarchy, centre: np.ndarray, size: np.ndarray, axes: Sequence[int], at_least: float, at_most: float
) -> Tags:
    """Return the cells that reach between two distances from a centre (3,) m, in units of a size (3,) m along each axis.

    Distances are measured along `axes` alone, on periodic ones to the nearest image of the centre. Without a centre, nan, there
    is no such cell. Where a size is zero, only what lies at the centre is near.
    """
    tags, period = Field(hierarchy), hierarchy.domain.period
    for patch in tags.patches:
        half = hierarchy.spacing(patch.level) / 2
        units = [max(size[axis], 1e-9 * half[axis]) for axis in axes]
        offsets = [(axis, np.abs(nearest(patch.centres()[axis] - centre[axis], period(axis)))) for axis in axes]
        least = distance([np.maximum(o - half[axis], 0) for axis, o in offsets], units)
        most = distance([np.minimum(o + half[axis], period(axis) / 2) for axis, o in offsets], units)
        patch.data[...] = (least <= at_most) & (most >= at_least)
    return [tags.array(level) > 0 for level in range(hierarchy.levels)]


def at_electrodes(hierarchy: Hierarchy, electrodes: Sequence[Conductor], beside: Beside) -> Tags:
    """Return the cells that lie beside electrodes as a function of `conductors.refined` has it. Collective.

    Raises InputError on all ranks where a shape fails on one.
    """
    with together(hierarchy.comm, InputError):
        tags = [hierarchy.marked_by(level, partial(beside, electrodes)) for level in range(hierarchy.levels)]
    return tags


def inside(hierarchy: Hierarchy, boxes: Sequence[np.ndarray]) -> Tags:
    """Return the cells that touch index boxes of finer levels: `boxes[k]` (n, 6) are of level k + 1, in its indices."""
    tags = Field(hierarchy)
    for patch in tags.patches:
        for finer in range(patch.level, len(boxes)):
            for box in boxes[finer].reshape(-1, 6).astype(np.int64) // 2 ** (finer + 1 - patch.level):
                axes = [
                    _hits(patch.lower[d], patch.upper[d], box[d], box[d + 3], _period(hierarchy, patch.level, d))
                    for d in range(3)
                ]
                patch.data[np.ix_(*axes)] = 1
    return [tags.array(level) > 0 for level in range(hierarchy.levels)]


def _period(hierarchy: Hierarchy, level: int, axis: int) -> int | None:
    return hierarchy.domain.cells[axis] * 2**level if hierarchy.domain.periodic[axis] else None


def _hits(lower: int, upper: int, first: int, last: int, period: int | None) -> np.ndarray:
    """Return which of the cells from `lower` to `upper` lie from `first` to `last`, or in a periodic image of that."""
    cells = np.arange(lower, upper + 1)
    return (cells - first) % period <= last - first if period else (first <= cells) & (cells <= last)


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
    region_text = f"static region from {lower.tolist()} to {upper.tolist()} m"
    if level < 1:
        raise HierarchyError(f"{region_text} asks for level {level}; refined levels start at 1")
    if max(domain.cells) * 2**level > 2**30:
        raise HierarchyError(
            f"{region_text} asks for level {level} with more than 2^30 cells along an axis; use fewer levels"
        )
    if not (lower.shape == upper.shape == (3,) and np.all(np.isfinite([lower, upper])) and np.all(lower < upper)):
        raise HierarchyError(
            f"{region_text} has no volume; give three finite numbers each, upper ones above lower ones"
        )
    spacing, cells = domain.spacing / 2**level, np.array(domain.cells) * 2**level
    # A face given on a cell face, as far as rounding can tell, touches no cell beyond it.
    slack = 1e-9
    first = np.floor((lower - domain.lower) / spacing + slack).astype(int)
    last = np.ceil((upper - domain.lower) / spacing - slack).astype(int) - 1
    wall = ~np.array(domain.periodic)
    if np.any(wall & ((last < 0) | (first >= cells))):
        limits = f"{list(domain.lower)} to {list(domain.upper)} m"
        raise HierarchyError(f"{region_text} lies outside the domain, {limits}; move it inside")
    first, last = np.where(wall, np.maximum(first, 0), first), np.where(wall, np.minimum(last, cells - 1), last)
    return np.concatenate([first, np.maximum(first, last)])

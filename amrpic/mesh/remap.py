"""Fields carried to any mesh of the same domain: polynomials in the source's cells, averaged over what cells have in common.

The polynomial of a cell has the cell's mean, and the parts of a cell fill it, so integrals stay what they were. All sums run in
an order that the two meshes alone settle: the result depends neither on boxes nor on ranks.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from ..errors import HierarchyError, InputError
from ..parallel import raise_together
from .hierarchy import Hierarchy
from .overlaps import CommonPart, parts
from .patch import Patch
from .polynomials import Fits, exponents, neighbour_bounds, require_order
from .surroundings import CellLattice, Surroundings, block

Array = NDArray[Any]
Bounds = str | tuple[float, float] | None
ORDERS = (1, 2, 3, 4)
UNBOUNDED = float(np.finfo(float).max) / 8  # in place of infinite bounds: what is left up to there can be summed


class Values(Protocol):
    """Values on a hierarchy: a field."""

    hierarchy: Hierarchy

    @property
    def patches(self) -> list[Patch]: ...


def remap(field: Values, to: Values, order: int, bounds: Bounds) -> None:
    """Set the uncovered cells of `to` to a field on another hierarchy of the same domain. Collective; see `Field.remap`."""
    require_order(order, ORDERS, "the fit")
    _require_one_domain(field.hierarchy, to.hierarchy)
    source, target = CellLattice(field.hierarchy), CellLattice(to.hierarchy)
    limits = _checked_bounds(field, bounds)
    cells = _SourceCells(field, source, target, order, limits)
    patches = [patch for patch in to.patches if not patch.covered.all()]
    corners = [target.boxes[patch.level][patch.box] for patch in patches]
    regions = [list(_regions(target, patch.level, box, source)) for patch, box in zip(patches, corners, strict=True)]
    needed = {(region.level, box) for of_box in regions for region in of_box for box in region.boxes}
    boxes = _fetched(source, needed, cells.box)
    for patch, box, of_box in zip(patches, corners, regions, strict=True):
        patch.data[...] = _averaged(box, of_box, boxes, exponents(order))


def _require_one_domain(first: Hierarchy, second: Hierarchy) -> None:
    """Raise HierarchyError unless two hierarchies span one domain, on as many ranks."""
    a, b = first.domain, second.domain
    if (a.lower, a.upper) != (b.lower, b.upper):
        raise HierarchyError(
            f"the field lives on {a.lower} to {a.upper} m, the new hierarchy on {b.lower} to {b.upper} m; "
            "make both on one domain"
        )
    if first.comm.size != second.comm.size:
        raise HierarchyError(
            f"the field lives on {first.comm.size} ranks and the new hierarchy on {second.comm.size}; "
            "make both on one communicator"
        )


def _checked_bounds(field: Values, bounds: Bounds) -> Bounds:
    """Return bounds after checks. InputError on all ranks; collective if they are two numbers."""
    if bounds is None or (isinstance(bounds, str) and bounds == "neighbours"):
        return bounds
    try:
        if isinstance(bounds, str):
            raise TypeError
        least, most = (float(number) for number in bounds)
    except (TypeError, ValueError):
        raise InputError(f'bounds are {bounds!r:.60}; use "neighbours", or the least and the most value') from None
    if not least <= most:
        raise InputError(f"bounds are {least} and {most}; give the least value first, and none that is not a number")
    values = [patch.data[~patch.covered] for patch in field.patches]
    outside = [float(of_box[bad][0]) for of_box in values if (bad := ~((of_box >= least) & (of_box <= most))).any()]
    raise_together(
        field.hierarchy.comm,
        f"the field holds {outside[0]:g}, outside of the bounds {least:g} and {most:g}; give bounds around all that it holds"
        if outside
        else None,
        InputError,
    )
    return max(least, -UNBOUNDED), min(most, UNBOUNDED)


# ---- the cells of the source, with their polynomials ----


@dataclass(frozen=True)
class _Box:
    """What a box of the source holds."""

    values: Array  # (nx, ny, nz)
    coefficients: Array | None = None  # (monomials, nx, ny, nz), where cells are cut
    limits: Array | None = None  # (3, nx, ny, nz): least, most, and the share of its room that each part takes


class _SourceCells:
    """This rank's cells of the source."""

    def __init__(self, field: Values, source: CellLattice, target: CellLattice, order: int, bounds: Bounds) -> None:
        """Collective."""
        self._values = {(patch.level, patch.box): patch.data for patch in field.patches}
        self._source, self._target, self._fits, self._bounds = source, target, Fits(order), bounds
        cut = {
            (patch.level, patch.box): cells
            for patch in field.patches
            if not patch.covered.all() and (cells := self._cut(patch.level, patch.box, ~patch.covered)).any()
        }
        surroundings = {key: Surroundings.of_box(source, *key, self._fits.width) for key in cut}
        values = _fetched(source, set().union(*(key.needed for key in surroundings.values())), self.value)
        self._fits.prepare((surroundings[key], cells) for key, cells in cut.items())
        self._boxes = {key: self._fitted(surroundings[key], cut[key], lambda *box: values[box]) for key in cut}

    def value(self, level: int, box: int) -> Array:
        """Return the values in a box."""
        return self._values[level, box]

    def box(self, level: int, box: int) -> _Box:
        """Return all that a box holds."""
        if (level, box) in self._boxes:
            return self._boxes[level, box]
        values = self._values[level, box]
        return _Box(values, None, None if self._bounds is None else np.stack([values, values, 0 * values]))

    def _cut(self, level: int, box: int, leaves: Array) -> Array:
        """Return which leaves of a box do not lie in a single cell of the target, bool (nx, ny, nz)."""
        corners = self._source.boxes[level][box]
        whole = np.zeros(leaves.shape, dtype=bool)
        for region in _regions(self._source, level, corners, self._target):
            part = next(
                parts(corners, region.here, region.there, source_here=True)
            )  # with the lowest cell that each meets
            whole |= (part.of_source == 1) & region.leaves[region.inside(part)]
        return leaves & ~whole

    def _fitted(self, surroundings: Surroundings, cut: Array, of_box: Callable[[int, int], Array]) -> _Box:
        values = surroundings.values(of_box)
        coefficients = self._fits.coefficients(surroundings, cut, values)
        own = values[block(np.full(3, surroundings.width), surroundings.width + surroundings.size - 1)]
        limits = None
        if self._bounds is not None:
            if isinstance(self._bounds, str):
                least, most = neighbour_bounds(surroundings, values)
            else:
                least, most = (np.full(own.shape, bound) for bound in self._bounds)
            limits = np.stack([least, most, self._share(surroundings, own, coefficients, least, most)])
        return _Box(own, coefficients, limits)

    def _share(self, surroundings: Surroundings, own: Array, coefficients: Array, least: Array, most: Array) -> Array:
        """Return how much of its room each part of a cell takes of what clipping cuts off the others: below 0 downwards."""
        remainder, above, below = (np.zeros(own.shape) for _ in range(3))
        powers = exponents(self._fits.order)
        for region in _regions(self._source, surroundings.level, surroundings.box, self._target):
            for part in parts(surroundings.box, region.here, region.there, source_here=True):
                volume = part.of_source * region.leaves[region.inside(part)]
                mean = own + part.deviation(coefficients, powers)
                clipped = np.clip(mean, least, most)
                remainder += volume * (mean - clipped)
                above += volume * (most - clipped)
                below += volume * (clipped - least)
        room = np.where(remainder > 0, above, below)
        return np.divide(remainder, room, out=np.zeros(own.shape), where=room > 0)


# ---- the cells of the target ----


@dataclass(frozen=True)
class _Region:
    """Cells of a level of one mesh that meet a box of a level of the other."""

    lattice: CellLattice
    level: int
    lower: Array
    upper: Array
    here: Array  # cells of the domain along each axis on the level of the box
    there: Array  # on this level

    @cached_property
    def leaves(self) -> Array:
        """Which of them count, bool (nx, ny, nz)."""
        return self.lattice.leaves(self.level, self.lower, self.upper)

    @cached_property
    def boxes(self) -> list[int]:
        """The boxes that hold them."""
        return self.lattice.tables[self.level].meeting(self.lower.tolist(), self.upper.tolist()).tolist()

    def inside(self, part: CommonPart) -> tuple[Any, ...]:
        """Return the cells of a part as indices of the region."""
        ends = zip(part.axes, self.lower, self.upper, strict=True)
        return np.ix_(*(np.minimum(axis.other, high) - low for axis, low, high in ends))

    def assembled(self, of_boxes: Sequence[Array | None]) -> Array | None:
        """Return an array (..., nx, ny, nz) from those of the boxes, zero where they have none; none if all have none."""
        sample = next((values for values in of_boxes if values is not None), None)
        if sample is None:
            return None
        out = np.zeros((*sample.shape[:-3], *(self.upper - self.lower + 1)))
        for box, values in zip(self.boxes, of_boxes, strict=True):
            if values is None:
                continue
            corners = self.lattice.boxes[self.level][box]
            low, high = np.maximum(corners[:3], self.lower), np.minimum(corners[3:], self.upper)
            outside, inside = block(low - self.lower, high - self.lower), block(low - corners[:3], high - corners[:3])
            out[(Ellipsis, *outside)] = values[(Ellipsis, *inside)]
        return out


def _regions(of: CellLattice, level: int, corners: Array, target: CellLattice) -> Iterator[_Region]:
    """Yield what meets a box of one mesh on each level of the other that has cells there which count."""
    extent = of.extent(level)
    for number in range(target.hierarchy.levels):
        extent_of_other = target.extent(number)
        lower, upper = corners[:3] * extent_of_other // extent, ((corners[3:] + 1) * extent_of_other - 1) // extent
        region = _Region(target, number, lower, upper, extent, extent_of_other)
        if region.leaves.any():
            yield region


def _averaged(corners: Array, regions: list[_Region], boxes: dict[tuple[int, int], _Box], powers: Array) -> Array:
    """Return the means over the cells of a box of the target, (nx, ny, nz), from the cells of the source that meet it."""
    shape = corners[3:] - corners[:3] + 1
    total, least, most = np.zeros(shape), np.full(shape, np.inf), np.full(shape, -np.inf)
    for region in regions:
        of_boxes = [boxes[region.level, box] for box in region.boxes]
        values = region.assembled([box.values for box in of_boxes])
        coefficients = region.assembled([box.coefficients for box in of_boxes])
        limits = region.assembled([box.limits for box in of_boxes])
        assert values is not None
        for part in parts(corners, region.here, region.there, source_here=False):
            at = region.inside(part)
            used = region.leaves[at] & (part.of_target > 0)
            mean = values[at]
            if coefficients is not None:
                mean = mean + part.deviation(coefficients[(slice(None), *at)], powers)
            if limits is not None:
                mean = _limited(mean, *limits[(slice(None), *at)])
            total += np.where(used, part.of_target * mean, 0.0)
            least, most = np.where(used, np.minimum(least, mean), least), np.where(used, np.maximum(most, mean), most)
    return np.clip(total, least, most)  # a mean of these, except for rounding


def _limited(mean: Array, least: Array, most: Array, share: Array) -> Array:
    """Return means within bounds: clipped, and with their share of what clipping cut off, in proportion to the room left."""
    clipped = np.clip(mean, least, most)
    return np.clip(clipped + share * np.where(share > 0, most - clipped, clipped - least), least, most)


# ---- across ranks ----


def _fetched(
    lattice: CellLattice, needed: set[tuple[int, int]], own: Callable[[int, int], Any]
) -> dict[tuple[int, int], Any]:
    """Return what their owners hold in boxes, level and number, that this rank needs. Collective."""
    comm, hierarchy = lattice.hierarchy.comm, lattice.hierarchy
    if comm.size == 1:
        return {key: own(*key) for key in needed}
    owners = [hierarchy.owners(level) for level in range(hierarchy.levels)]
    requests: list[list[tuple[int, int]]] = [[] for _ in range(comm.size)]
    for level, box in sorted(needed):
        requests[owners[level][box]].append((level, box))
    requested = comm.alltoall(requests)
    replies = comm.alltoall([[own(*key) for key in boxes] for boxes in requested])
    pairs = zip(requests, replies, strict=True)
    return {key: values for boxes, of_rank in pairs for key, values in zip(boxes, of_rank, strict=True)}

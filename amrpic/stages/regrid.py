"""Regrid: a new hierarchy from tags, and fields carried over to it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from .. import _native
from ..errors import HierarchyError
from ..mesh.boxes import cells_of
from ..mesh.field import Field
from ..mesh.hierarchy import Hierarchy
from ..mesh.polynomials import require_order
from ..mesh.remap import Bounds
from ..parallel import raise_together

CARRIED_ORDERS = (2, 3, 4)


@dataclass(frozen=True)
class Regridding:
    """How boxes are made from tags."""

    max_levels: int = 2  # most levels, the base included
    buffer: int = 2  # cells around a tagged one that are refined with it: what moves stays inside until the next regrid
    nesting: int = 2  # cells of a level around the next finer one; 1 is enough for the operators
    efficiency: float = 0.7  # least fraction of a box's blocks that must be wanted, unless it is a single block

    def __post_init__(self) -> None:
        for name, least in ("max_levels", 1), ("buffer", 0), ("nesting", 1):
            if getattr(self, name) < least:
                raise HierarchyError(f"{name} of the regridding is {getattr(self, name)}; it must be at least {least}")
        if not 0 < self.efficiency <= 1:
            raise HierarchyError(f"efficiency of the regridding is {self.efficiency}; it must lie in (0, 1]")


def regrid(
    hierarchy: Hierarchy,
    tags: Sequence[np.ndarray],
    settings: Regridding,
    static: Sequence[np.ndarray] = (),
    staying: Sequence[np.ndarray] = (),
) -> Hierarchy:
    """Return the hierarchy that refines all tagged cells; `hierarchy` itself if its boxes are those. Collective.

    `tags[l]` is a bool per cell of this rank on level l, in the order of `Field.array(l)`; levels left out are not
    tagged. Of what `staying`, tags as well, would refine, that stays which is refined already. `static[k]` lists index boxes
    (n, 6) of level k + 1 that must exist in any case; they are aligned outward to the blocking factor, wrapped where
    periodic and clipped at walls. Tags add one level per call; static boxes come at once. The refined region depends
    neither on the number of ranks nor on `max_grid_size`.

    Raises HierarchyError on all ranks for tags that do not fit the cells and for static boxes that are empty or
    of a level above `max_levels`.
    """
    for boxes_given in tags, staying:
        raise_together(hierarchy.comm, _misfit(hierarchy, boxes_given), HierarchyError)
    if len(static) >= settings.max_levels:
        raise HierarchyError(
            f"static boxes are given for level {len(static)}, but max_levels is {settings.max_levels}, the base "
            f"included; raise it to {len(static) + 1}"
        )
    fixed = [np.ascontiguousarray(boxes, dtype=np.int32).reshape(-1, 6) for boxes in static]
    for level, boxes in enumerate(fixed, start=1):
        if len(empty := boxes[np.any(boxes[:, 3:] < boxes[:, :3], axis=1)]):
            raise HierarchyError(f"static box {empty[0].tolist()} of level {level} is empty; swap its corners")
    marks = _marks(tags, staying)
    try:
        levels = _native.refine(
            hierarchy.native, marks, fixed, settings.max_levels, settings.buffer, settings.nesting, settings.efficiency
        )
    except _native.HierarchyError as refused:
        raise HierarchyError(str(refused)) from None
    hierarchy_made = _like(hierarchy, levels)
    return hierarchy if hierarchy_made.same_mesh(hierarchy) else hierarchy_made


def _marks(tags: Sequence[np.ndarray], staying: Sequence[np.ndarray]) -> list[np.ndarray]:
    """Return a byte per cell: bit 0 for tagged, bit 1 for kept cells."""
    if not staying:
        return [np.ascontiguousarray(level, dtype=bool).view(np.uint8) for level in tags]
    return [
        np.asarray(of_tags, dtype=np.uint8) + 2 * np.asarray(stays, dtype=np.uint8)
        for of_tags, stays in zip(tags, staying, strict=True)
    ]


def _misfit(hierarchy: Hierarchy, tags: Sequence[np.ndarray]) -> str | None:
    if len(tags) > hierarchy.levels:
        return f"tags are given for {len(tags)} levels, but the hierarchy has {hierarchy.levels}; give at most as many"
    for level, values in enumerate(tags):
        local = hierarchy.local_boxes(level)
        cells = int(cells_of(hierarchy.boxes(level)[local.start : local.stop]).sum())
        if values.shape != (cells,):
            return (
                f"tags of level {level} on rank {hierarchy.comm.rank} have the shape {values.shape}, not ({cells},); "
                "give one per cell of this rank"
            )
    return None


def carry_over(field: Field, hierarchy: Hierarchy, order: int = 2, bounds: Bounds = None) -> Field:
    """Return the field on another hierarchy of the same domain. Collective.

    Cells that both have are copied; newly uncovered ones hold the mean of their former children. Newly refined ones keep the
    mean of the parent, so the integral stays what it was. At order 2, without bounds, they are interpolated by parabolas, of
    third order, at walls of second; else by least squares, of order + 1 up to walls: see `Field.remap`, also for bounds.

    Raises HierarchyError for another domain, InputError for orders other than 2 to 4, and bounds that make no sense.
    """
    if field.hierarchy.domain != hierarchy.domain:
        raise HierarchyError("the field lives on another domain than the new hierarchy; make both on one domain")
    require_order(order, CARRIED_ORDERS, "what is carried over")
    if order > 2 or bounds is not None:
        return field.remap(hierarchy, order, bounds)
    out = Field(hierarchy, field.unit)
    out.holds = field.holds
    _native.carry_over(field.native, out.native)
    return out


def _like(earlier: Hierarchy, levels: Sequence[np.ndarray]) -> Hierarchy:
    """Return a hierarchy of other refined levels on the same domain, which shares the boxes that stay."""
    sizes = earlier.max_grid_size, earlier.blocking_factor
    return Hierarchy(earlier.comm, earlier.domain, levels, *sizes, earlier=earlier)

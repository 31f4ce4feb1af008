"""The levels of boxes that refine a domain."""

from __future__ import annotations

import operator
from collections.abc import Callable, Sequence
from functools import cached_property, partial

import numpy as np

from .. import _native, tables
from ..conductors.conductor import Conductor
from ..conductors.refined import beside_edges, beside_surfaces
from ..errors import HierarchyError, InputError
from ..mpi import MPI
from ..parallel import own, together, world_by_default
from ..units import quantity
from .boxes import cells_of, table_of
from .domain import BOUNDARIES, Domain

# Of a hierarchy around electrodes.
NESTING = 2  # cells of a level around the next finer one
EFFICIENCY = 0.7  # least part of a box whose blocks were asked for


def _index_boxes(level: int, boxes: Sequence[Sequence[Sequence[int]]] | np.ndarray) -> np.ndarray:
    """Return boxes as (n, 6) of 32 bits; HierarchyError if they do not fit or are no whole numbers."""
    try:
        array = np.asarray(boxes)
    except ValueError:  # ragged
        array = np.array([np.nan])
    if array.size % 6 or (array.size and not np.issubdtype(array.dtype, np.integer)):
        raise HierarchyError(
            f"the boxes of level {level} are not pairs of three whole numbers; give ((i, j, k), (i, j, k))"
        )
    if array.size and np.abs(array).max() > np.iinfo(np.int32).max:
        raise HierarchyError(
            f"a box of level {level} has index {np.abs(array).max()}, beyond 32 bits; use fewer levels"
        )
    return array.astype(np.int32).reshape(-1, 6)


def _whole(value: int, name: str) -> int:
    """Return a number of cells; HierarchyError if it is no whole number of 32 bits."""
    try:
        number = operator.index(value)
    except TypeError:
        raise HierarchyError(f"{name} is {value!r}; give a whole number of cells") from None
    if abs(number) > np.iinfo(np.int32).max:
        raise HierarchyError(f"{name} is {number}; give a number of cells below 2^31")
    return number


def _covers(boxes: np.ndarray, boxes_inside: np.ndarray) -> bool:
    """Whether disjoint boxes (n, 6) hold all cells of other disjoint boxes (m, 6)."""
    table, own_rows = table_of(boxes), set(map(tuple, boxes.tolist()))
    for lower, upper in ((row[:3], row[3:]) for row in boxes_inside.tolist() if tuple(row) not in own_rows):
        near = boxes[table.meeting(lower, upper)].astype(np.int64)
        common = np.minimum(near[:, 3:], upper) - np.maximum(near[:, :3], lower) + 1
        if common.prod(axis=1).sum() < np.prod(np.subtract(upper, lower) + 1):
            return False
    return True


class Hierarchy:
    """The levels of a refined mesh, coarse to fine; immutable. Collective to make.

    `levels[k]` lists the boxes of level k + 1 as pairs of inclusive corner indices in that level's own index space, or is
    an (n, 6) array of them. Boxes may exceed `max_grid_size` and are cut; cells of level 0 cover the domain. Each level is
    shared out over the ranks by its cells. Where whole boxes leave a rank with more than 1.1 times the mean, those across
    the borders of ranks are halved, down to 8 cells per axis. With `base`, the boxes of level 0, all boxes are taken as they
    are, in their order: so those that were stored come back.

    Boxes start on multiples of the blocking factor and have a multiple of it, or end at the domain's upper face. Levels with
    the boxes of an `earlier` hierarchy share what is known of them, and are not checked again.

    `comm` may be left out: all ranks. Raises HierarchyError on all ranks for boxes that overlap, leave the domain, are not
    aligned so, or do not nest.
    """

    @world_by_default
    def __init__(
        self,
        comm: MPI.Comm,
        domain: Domain,
        levels: Sequence[Sequence[Sequence[Sequence[int]]] | np.ndarray] = (),
        max_grid_size: int = 24,
        blocking_factor: int = 8,
        base: np.ndarray | None = None,
        earlier: Hierarchy | None = None,
    ) -> None:
        boxes = [_index_boxes(number, level) for number, level in enumerate(levels, start=1)]
        self.max_grid_size = _whole(max_grid_size, "max_grid_size")
        self.blocking_factor = _whole(blocking_factor, "blocking_factor")
        codes = [BOUNDARIES.index(face) for faces in domain.boundary for face in faces]
        self.comm = own(comm)
        shared = None if earlier is None else earlier.native
        try:
            self.native: _native.Hierarchy = _native.Hierarchy(
                self.comm.py2f(),
                domain.lower,
                domain.upper,
                domain.cells,
                codes,
                boxes,
                self.max_grid_size,
                self.blocking_factor,
                _index_boxes(0, np.empty((0, 6), dtype=np.int32) if base is None else base),
                shared,
            )
        except _native.HierarchyError as refused:
            raise HierarchyError(str(refused)) from None
        self.domain = domain

    @classmethod
    @world_by_default
    def around(
        cls,
        comm: MPI.Comm,
        domain: Domain,
        electrodes: Sequence[Conductor],
        levels: int = 2,
        edges: int = 4,
        max_grid_size: int = 24,
        blocking_factor: int = 8,
        buffer: int = 2,
    ) -> Hierarchy:
        """Return a hierarchy with so many refined `levels` at surfaces of electrodes, and so many at their `edges`. Collective.

        Strong curvature counts as an edge. `buffer` cells around the cells there are refined too. The refined region
        depends neither on the number of ranks nor on `max_grid_size`. `comm` may be left out: all ranks.

        Raises HierarchyError on all ranks for numbers that make no hierarchy, InputError where a shape fails on one.
        """
        most = max(_whole(levels, "levels"), _whole(edges, "edges"))
        if min(levels, edges, _whole(buffer, "buffer")) < 0:
            raise HierarchyError(
                f"levels, edges and buffer are {levels}, {edges} and {buffer}; none of them may be negative"
            )
        hierarchy = cls(comm, domain, (), max_grid_size, blocking_factor)
        for _ in range(most):  # each adds a level
            marks = []
            with together(hierarchy.comm, InputError):
                for level in range(hierarchy.levels):
                    beside = beside_surfaces if level < levels else beside_edges
                    marks.append(hierarchy.marked_by(level, partial(beside, electrodes)).view(np.uint8))
            boxes = _native.refine(hierarchy.native, marks, [], most + 1, buffer, NESTING, EFFICIENCY)
            hierarchy = cls(comm, domain, boxes, max_grid_size, blocking_factor, earlier=hierarchy)
        return hierarchy

    @cached_property
    def particle_mesh(self) -> _native.ParticleMesh:
        """Native look-ups and exchange plans for particles on the hierarchy. Collective at the first access."""
        return _native.ParticleMesh(self.native)

    @property
    def lower(self) -> np.ndarray:
        """The domain's lower corner, (3,) in m."""
        return np.array(self.domain.lower)

    @property
    def levels(self) -> int:
        """Number of levels, the base included."""
        return self.native.levels

    def boxes(self, level: int) -> np.ndarray:
        """Boxes of a level, (n, 6) int: lower x, y, z and upper x, y, z, inclusive, in their order."""
        return self.native.boxes(self._checked(level))

    def owners(self, level: int) -> np.ndarray:
        """Rank that owns each box of a level, (n,) int."""
        return self.native.owners(self._checked(level))

    def spacing(self, level: int) -> np.ndarray:
        """Cell widths of a level, (3,) in m."""
        return self.domain.spacing / 2 ** self._checked(level)

    def width_text(self, level: int) -> str:
        """Cell widths of a level with their unit, one if they are equal."""
        spacing = self.spacing(level)
        equal = np.ptp(spacing) < 1e-9 * spacing[0]
        return " x ".join(quantity(float(h), "m") for h in (spacing[:1] if equal else spacing))

    def cells(self, level: int | None = None) -> int:
        """Number of cells of a level, or of all without one, over all ranks."""
        if level is None:
            return sum(self.native.cells(l) for l in range(self.levels))
        return self.native.cells(self._checked(level))

    def local_boxes(self, level: int) -> range:
        """Numbers of this rank's boxes of a level."""
        first, last = self.native.local_boxes(self._checked(level))
        return range(first, last)

    @cached_property
    def own_cells(self) -> int:
        """Number of this rank's cells of all levels."""
        own = ((self.boxes(level), self.local_boxes(level)) for level in range(self.levels))
        return sum(int(cells_of(boxes[local.start : local.stop]).sum()) for boxes, local in own)

    def marked_by(self, level: int, mark: Callable[[np.ndarray, np.ndarray, np.ndarray], np.ndarray]) -> np.ndarray:
        """Return what a function of this rank's boxes (n, 6) of a level, its origin and its spacing in m gives. Local."""
        local = self.local_boxes(level)
        return mark(self.boxes(level)[local.start : local.stop], self.lower, self.spacing(level))

    def same_mesh(self, other: Hierarchy) -> bool:
        """Whether both have the same domain and boxes; owners may differ."""
        return (
            self.domain == other.domain
            and self.levels == other.levels
            and all(self.native.same_boxes(other.native, l) for l in range(self.levels))
        )

    def same_cells(self, other: Hierarchy) -> bool:
        """Whether both have the same cells on each level of one domain, whatever boxes these are in. Local."""
        return (
            (self.domain.lower, self.domain.upper, self.domain.cells)
            == (other.domain.lower, other.domain.upper, other.domain.cells)
            and self.levels == other.levels
            and all(self.cells(level) == other.cells(level) for level in range(self.levels))
            and all(_covers(self.boxes(level), other.boxes(level)) for level in range(self.levels))
        )

    def _checked(self, level: int) -> int:
        if not isinstance(level, int | np.integer) or not 0 <= level < self.levels:
            raise HierarchyError(f"level {level!r} does not exist; the hierarchy has levels 0 to {self.levels - 1}")
        return level

    def __repr__(self) -> str:
        sizes = ", ".join(f"{len(self.boxes(l))} boxes {self.cells(l)} cells" for l in range(self.levels))
        return f"Hierarchy({sizes})"

    def _repr_html_(self) -> str:
        rows = [
            [level, len(self.boxes(level)), self.cells(level), self.width_text(level)] for level in range(self.levels)
        ]
        reach = " × ".join(
            f"{quantity(low, 'm')} to {quantity(high, 'm')}"
            for low, high in zip(self.domain.lower, self.domain.upper, strict=True)
        )
        return tables.html(("level", "boxes", "cells", "cell width"), rows, f"Hierarchy on {reach}")

"""Arms: the stretches between the centres of neighbouring cells, and where they meet metal.

Everything is asked along the lines through cell centres, which are the same lines for any boxes, and counted from the
indices of the mesh: numbers do not depend on boxes or ranks.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from .. import _native
from ..shapes import Shape
from ..shapes.spans import Floats, Ints, Spans
from .conductor import Conductor
from .contacts import Contact, LineSpans, contacts

# A centre that is nearer to metal than this share of an arm, along that arm, lies in the metal.
TOUCH = 1e-9
SIDES = ("x-", "x+", "y-", "y+", "z-", "z+")
FAR = 1 << 30  # beyond all indices of cells


@dataclass(frozen=True, eq=False)
class CutArms:
    """Cells in metal, and cells beside it whose arms are cut, box by box and in the order of the cells of each (x fastest)."""

    solid: Ints  # (m,) number of the cell in its box
    solid_electrode: NDArray[np.int32]  # (m,) number of the electrode
    cell: Ints  # (n,) number of the cell in its box
    theta: Floats  # (n, 6) share of the arm x-, x+, y-, y+, z-, z+ until metal, in (0, 1]; inf where there is none
    electrode: NDArray[np.int32]  # (n, 6) number of the electrode, -1 where there is none
    surface: NDArray[np.int32]  # (n, 6) which of its shape's surfaces; -1 where there is none, or none was found
    first_solid: Ints  # (boxes + 1,) where the solid cells of each box begin
    first_cut: Ints  # (boxes + 1,) where the cut cells of each box begin

    def crossings(
        self, electrodes: Sequence[Conductor], boxes: ArrayLike, origin: ArrayLike, spacing: ArrayLike
    ) -> Walls:
        """Return where all cut arms meet metal; the other arguments are those that `arms_of_boxes` got."""
        cut, side = np.nonzero(self.electrode >= 0)
        index = indices(boxes, self.cell, self.first_cut)[cut]
        lattice = Lattice.of(origin, spacing)
        place = np.stack([lattice.centre(axis, index[:, axis]) for axis in range(3)], axis=1)
        axis, way = side // 2, np.zeros_like(place)
        way[np.arange(len(side)), axis] = np.where(side % 2, 1.0, -1.0)
        place += way * (self.theta[cut, side] * lattice.spacing[axis])[:, None]
        normal = -way  # where rounding hides the surface
        owner, surface = self.electrode[cut, side], self.surface[cut, side]
        for number, electrode in enumerate(electrodes):
            own = np.flatnonzero((owner == number) & (surface >= 0))
            normal[own] = electrode.shape.normals(place[own], surface[own], way[own])
        return Walls(cut, side, index, place, normal)


class Walls(NamedTuple):
    """Where cut arms meet metal."""

    cut: Ints  # (m,) row of the cut cell in `CutArms`
    side: Ints  # (m,) 0 to 5
    cells: Ints  # (m, 3) index of the cell
    place: Floats  # (m, 3) m
    normal: Floats  # (m, 3) unit vector out of the metal


def indices(boxes: ArrayLike, cell: Ints, first: Ints) -> Ints:
    """Return the indices (n, 3) of cells, of which each box has those from `first` on, by their numbers in their boxes."""
    rows = np.reshape(np.asarray(boxes, np.int64), (-1, 6))
    box = np.repeat(np.arange(len(rows)), np.diff(first))
    size = (rows[:, 3:] - rows[:, :3] + 1)[box]
    row, i = np.divmod(cell, size[:, 0])
    k, j = np.divmod(row, size[:, 1])
    return np.asarray(np.stack([i, j, k], axis=1) + rows[box, :3])


def arms_of_boxes(
    electrodes: Sequence[Conductor], boxes: ArrayLike, origin: ArrayLike, spacing: ArrayLike
) -> tuple[CutArms, list[Contact]]:
    """Return the arms that metal cuts in boxes (lower x, y, z, upper x, y, z, inclusive) of a level, and contacts.

    The centre of a cell lies at `origin` + (index + 1/2) · `spacing`, m.
    An electrode comes before later ones where they overlap. Contacts are those on lines through cells of these boxes.
    """
    cells, owner, crossings, lines = traced_boxes(electrodes, boxes, origin, spacing)
    slack = TOUCH * Lattice.of(origin, spacing).spacing
    return assembled(cells, owner, crossings), list(contacts(electrodes, lines, slack))


def traced_boxes(
    electrodes: Sequence[Conductor], boxes: ArrayLike, origin: ArrayLike, spacing: ArrayLike
) -> tuple[GrownBoxes, NDArray[np.int32], list[Crossings], list[list[LineSpans]]]:
    """Return grown boxes, the electrode that owns each of their cells or -1, the arms that metal cuts, and the spans of each
    electrode on lines along x, y and z, none where it is elsewhere."""
    lattice = Lattice.of(origin, spacing)
    cells = GrownBoxes.around(np.reshape(np.asarray(boxes, np.int64), (-1, 6)))
    owner, axes = np.full(cells.total, -1, np.int32), np.zeros(cells.total, np.uint8)
    crossings: list[Crossings] = []
    lines: list[list[LineSpans]] = [[] for _ in electrodes]
    for number in reversed(range(len(electrodes))):  # so that the first ones come last, and stay
        if not reaches(electrodes[number].shape, cells, lattice):
            continue
        for axis, traced in enumerate(trace(electrodes[number].shape, cells, lattice)):
            lines[number].append(traced.lines)
            _native.mark_in_metal(*traced.solid_cells(cells, lattice), number, axis, owner, axes)
            crossings += traced.crossings(cells, lattice, number)
    crossings.append(unseen(cells, owner, axes))
    return cells, owner, crossings, lines


@dataclass(frozen=True, eq=False)
class Lattice:
    """The centres of all cells of a level."""

    origin: Floats  # (3,) m
    spacing: Floats  # (3,) m

    @classmethod
    def of(cls, origin: ArrayLike, spacing: ArrayLike) -> Lattice:
        """Return the lattice; one spacing stands for all axes."""
        start, width = (np.broadcast_to(np.asarray(value, float), 3) for value in (origin, spacing))
        return cls(np.asarray(start), np.asarray(width))

    def centre(self, axis: int, index: Ints) -> Floats:
        """Return coordinates of centres along an axis, m."""
        return np.asarray(self.origin[axis] + (index + 0.5) * self.spacing[axis])

    def index(self, axis: int, coordinate: Floats) -> Floats:
        """Return the index of a cell with this centre, which need not be whole."""
        return np.clip((coordinate - self.origin[axis]) / self.spacing[axis] - 0.5, -FAR, FAR)


@dataclass(frozen=True, eq=False)
class GrownBoxes:
    """Boxes with a layer of cells around each, numbered one box after the other, x fastest."""

    lower: Ints  # (b, 3)
    upper: Ints  # (b, 3)
    stride: Ints  # (b, 3)
    first: Ints  # (b + 1,) number of the first cell

    @classmethod
    def around(cls, boxes: Ints) -> GrownBoxes:
        """Return boxes grown by one cell."""
        lower, upper = boxes[:, :3] - 1, boxes[:, 3:] + 1
        extent = upper - lower + 1
        stride = np.stack([np.ones(len(boxes), np.int64), extent[:, 0], extent[:, 0] * extent[:, 1]], axis=1)
        return cls(lower, upper, stride, np.concatenate([[0], np.cumsum(extent.prod(axis=1))]))

    @property
    def total(self) -> int:
        return int(self.first[-1])

    def inner(self, number: int, values: NDArray[np.int32]) -> NDArray[np.int32]:
        """Return the values of a box without the layer around it."""
        x, y, z = self.upper[number] - self.lower[number] + 1
        box = values[self.first[number] : self.first[number + 1]].reshape(z, y, x)
        return box[1:-1, 1:-1, 1:-1].ravel()

    def decoded(self, cell: Ints) -> tuple[Ints, Ints, NDArray[np.bool_]]:
        """Return the box of each cell, its number there without the layer, and whether it has one."""
        box = np.searchsorted(self.first, cell, side="right") - 1
        extent = self.upper[box] - self.lower[box] + 1
        row, i = np.divmod(cell - self.first[box], extent[:, 0])
        k, j = np.divmod(row, extent[:, 1])
        place = np.stack([i, j, k], axis=1) - 1
        size = extent - 2
        inner: NDArray[np.bool_] = np.all((place >= 0) & (place < size), axis=1)
        return box, place[:, 0] + size[:, 0] * (place[:, 1] + size[:, 1] * place[:, 2]), inner


class Crossings(NamedTuple):
    """Arms of cells that metal cuts."""

    arm: Ints  # (n,) 6 · number of the cell in its grown box + side
    theta: Floats
    electrode: NDArray[np.int32]
    surface: Ints


@dataclass(frozen=True, eq=False)
class Traced:
    """The spans of a shape on lines of the lattice along an axis, and the pieces of these lines in boxes."""

    lines: LineSpans
    span: Ints  # (p,) for each piece of a span in a box: the span,
    box: Ints  # (p,) the box,
    cell: Ints  # (p,) number that the cell of index 0 on the line would have,
    inner: NDArray[np.bool_]  # (p,) and whether the line goes through the box itself

    def ends(self, lattice: Lattice) -> tuple[Ints, Ints]:
        """Return the first and the last cell of each piece in metal; none if metal lies between two centres."""
        first = np.ceil(lattice.index(self.lines.axis, self.lines.spans.enter) - TOUCH).astype(np.int64)
        last = np.floor(lattice.index(self.lines.axis, self.lines.spans.leave) + TOUCH).astype(np.int64)
        return first[self.span], last[self.span]

    def solid_cells(self, cells: GrownBoxes, lattice: Lattice) -> tuple[Ints, Ints, Ints]:
        """Return the first cells of the pieces in metal, by numbers, how many each has, and how far apart they are."""
        first, last = self.ends(lattice)
        first = np.maximum(first, cells.lower[self.box, self.lines.axis])
        count = np.maximum(np.minimum(last, cells.upper[self.box, self.lines.axis]) - first + 1, 0)
        stride = cells.stride[self.box, self.lines.axis]
        return self.cell + first * stride, count, stride

    def crossings(self, cells: GrownBoxes, lattice: Lattice, electrode: int) -> Iterator[Crossings]:
        """Yield the arms that the spans cut, upwards and downwards."""
        first, last = self.ends(lattice)
        low, high = cells.lower[self.box, self.lines.axis], cells.upper[self.box, self.lines.axis]
        for index, upwards in ((first - 1, True), (last + 1, False)):
            piece = np.flatnonzero(self.inner & (low < index) & (index < high))
            span, index = self.span[piece], index[piece]
            met = (self.lines.spans.enter if upwards else self.lines.spans.leave)[span]
            surface = (self.lines.spans.first if upwards else self.lines.spans.last)[span]
            way = (met - lattice.centre(self.lines.axis, index)) / lattice.spacing[self.lines.axis]
            cell = self.cell[piece] + index * cells.stride[self.box[piece], self.lines.axis]
            theta = np.minimum(way if upwards else -way, 1.0)
            yield Crossings(
                6 * cell + 2 * self.lines.axis + upwards, theta, np.full(len(cell), electrode, np.int32), surface
            )


def ramp(count: Ints) -> Ints:
    """Return 0, 1, … up to each count, one after the other."""
    ends = np.cumsum(count)
    return np.arange(ends[-1] if len(ends) else 0) - np.repeat(ends - count, count)


def reaches(shape: Shape, cells: GrownBoxes, lattice: Lattice) -> bool:
    """Whether the box around a shape meets boxes, or is a cell from them."""
    low, high = (
        np.stack([lattice.index(axis, corner[axis]) for axis in range(3)]) for corner in np.array(shape.bounds)
    )
    return bool(((cells.lower <= high + 2) & (cells.upper >= low - 2)).all(axis=1).any())


def trace(shape: Shape, cells: GrownBoxes, lattice: Lattice) -> list[Traced]:
    """Return the spans of a shape on the lines along x, y and z through boxes, where these meet the box around the shape."""
    passages = [Passages.of(shape, cells, lattice, axis) for axis in range(3)]
    count = [len(passage.key) for passage in passages]
    # All three at once: of coarse levels the calls cost more than what they do.
    all_spans = shape.spans(
        np.concatenate([passage.place for passage in passages]), np.repeat(np.eye(3), count, axis=0)
    )
    first = np.cumsum([0, *count])
    ends = np.searchsorted(all_spans.line, first)
    return [
        passage.traced(axis, all_spans.part(ends[axis], ends[axis + 1], first[axis]))
        for axis, passage in enumerate(passages)
    ]


@dataclass(frozen=True, eq=False)
class Passages:
    """Lines of the lattice along an axis, and their ways through boxes."""

    key: Ints  # (n,) of each line, sorted
    place: Floats  # (n, 3) on it, where the coordinate along it is zero, m
    line: Ints  # (p,) for each way through a box: the line,
    box: Ints  # (p,) the box,
    cell: Ints  # (p,) number that the cell of index 0 on the line would have,
    inner: NDArray[np.bool_]  # (p,) and whether the line goes through the box without the layer around it

    @classmethod
    def of(cls, shape: Shape, cells: GrownBoxes, lattice: Lattice, axis: int) -> Passages:
        """Return those that meet the box around a shape."""
        bounds = np.array(shape.bounds)
        low, high = (np.stack([lattice.index(a, corner[a]) for a in range(3)]) for corner in bounds)
        lower = np.maximum(cells.lower, np.floor(low).astype(np.int64))
        upper = np.minimum(cells.upper, np.ceil(high).astype(np.int64))
        u, v = (a for a in range(3) if a != axis)
        # A layer more along the line: a surface just outside the box may be nearer than rounding.
        along = (cells.lower[:, axis] <= np.ceil(high[axis]) + 1) & (cells.upper[:, axis] >= np.floor(low[axis]) - 1)
        size = np.where(along[:, None], np.maximum(upper - lower + 1, 0), 0)
        count = size[:, u] * size[:, v]
        box = np.repeat(np.arange(len(count)), count)
        across, up = np.divmod(ramp(count), np.maximum(size[box, u], 1))
        at_u, at_v = lower[box, u] + up, lower[box, v] + across
        (ku, kv), line = lines_through(at_u, at_v)
        key = key_of(ku, kv)
        place = np.zeros((len(key), 3))
        place[:, u], place[:, v] = lattice.centre(u, ku), lattice.centre(v, kv)
        cell = cells.first[box] - (cells.lower[box] * cells.stride[box]).sum(axis=1)
        cell += at_u * cells.stride[box, u] + at_v * cells.stride[box, v]
        inner = np.ones(len(box), bool)
        for a, index in ((u, at_u), (v, at_v)):
            inner &= (cells.lower[box, a] < index) & (index < cells.upper[box, a])
        return cls(key, place, line, box, cell, inner)

    def traced(self, axis: int, spans: Spans) -> Traced:
        begin = np.searchsorted(spans.line, np.arange(len(self.key) + 1))
        count = (begin[1:] - begin[:-1])[self.line]
        span = np.repeat(begin[:-1][self.line], count) + ramp(count)
        way = np.repeat(np.arange(len(count)), count)
        return Traced(
            LineSpans(axis, self.key, self.place, spans), span, self.box[way], self.cell[way], self.inner[way]
        )


def key_of(u: Ints, v: Ints) -> Ints:
    """Return numbers of lines, one for each pair of indices."""
    return u * (2 * FAR) + v


def indices_of(key: Ints) -> tuple[Ints, Ints]:
    """Return the indices that `key_of` was given."""
    u = (key + FAR) // (2 * FAR)
    return u, key - u * (2 * FAR)


def lines_through(u: Ints, v: Ints) -> tuple[tuple[Ints, Ints], Ints]:
    """Return the different pairs of indices (n,), sorted, and which of them each one is."""
    if len(u) == 0:
        return (u, v), u
    least, width = v.min(), v.max() - v.min() + 1
    number = (u - u.min()) * width + (v - least)
    if number.max() < 8 * len(number):  # by a table of all pairs, which costs less than sorting
        known = np.zeros(number.max() + 1, bool)
        known[number] = True
        pairs, line = np.flatnonzero(known), (np.cumsum(known) - 1)[number]
    else:
        pairs, line = np.unique(number, return_inverse=True)
    return (pairs // width + u.min(), pairs % width + least), line


def assembled(cells: GrownBoxes, owner: NDArray[np.int32], crossings: Sequence[Crossings]) -> CutArms:
    """Return solid and cut cells of boxes, from the electrode that owns each cell of the grown ones and from crossings."""
    cut = cut_cells(cells, owner, crossings)
    owners = [cells.inner(b, owner) for b in range(len(cells.lower))]
    solids = [np.flatnonzero(values >= 0) for values in owners]
    return CutArms(
        np.concatenate([np.empty(0, np.int64), *solids]),
        np.concatenate([np.empty(0, np.int32), *(values[solid] for values, solid in zip(owners, solids, strict=True))]),
        cut.cell,
        cut.theta,
        cut.electrode,
        cut.surface,
        np.concatenate([[0], np.cumsum([len(solid) for solid in solids], dtype=np.int64)]),
        cut.first,
    )


class CutCells(NamedTuple):
    """What `CutArms` has of cut cells."""

    cell: Ints
    theta: Floats
    electrode: NDArray[np.int32]
    surface: NDArray[np.int32]
    first: Ints


def cut_cells(cells: GrownBoxes, owner: NDArray[np.int32], crossings: Sequence[Crossings]) -> CutCells:
    """Return the cells outside metal that have crossings; of several on an arm, the nearest one counts."""
    empty = Crossings(np.empty(0, np.int64), np.empty(0), np.empty(0, np.int32), np.empty(0, np.int64))
    columns = [np.concatenate(column) for column in zip(empty, *crossings, strict=True)]
    fluid = owner[columns[0] // 6] < 0
    arm, theta, electrode, surface = (column[fluid] for column in columns)
    order = np.argsort(arm, kind="stable")
    if (arm[order[1:]] == arm[order[:-1]]).any():
        order = np.lexsort((-surface, electrode, theta, arm))
    nearest = order[begins(arm[order])]
    arm = arm[nearest]
    is_first = begins(arm // 6)
    row = np.cumsum(is_first) - 1
    box, number, inner = cells.decoded(arm[is_first] // 6)
    assert inner.all()
    thetas = np.full((len(number), 6), np.inf)
    electrodes, surfaces = np.full((2, len(number), 6), -1, np.int32)
    for array, values in ((thetas, theta), (electrodes, electrode), (surfaces, surface)):
        array[row, arm % 6] = values[nearest]
    return CutCells(number, thetas, electrodes, surfaces, np.searchsorted(box, np.arange(len(cells.lower) + 1)))


def begins(values: Ints) -> NDArray[np.bool_]:
    """Return which of sorted values are the first of those equal to them."""
    out = np.ones(len(values), bool)
    out[1:] = values[1:] != values[:-1]
    return out


def unseen(cells: GrownBoxes, owner: NDArray[np.int32], axes: NDArray[np.uint8]) -> Crossings:
    """Return arms that end at a centre in metal where rounding hides the surface: cut at their end.

    `axes` has a bit for each axis along which a line found the cell in metal. Where the line along an arm did, it
    also found where it enters.
    """
    metal = np.flatnonzero(axes - np.uint8(1) < 6)  # zero wraps round
    metal, side = np.repeat(metal, 6), np.tile(np.arange(6), len(metal))
    hidden = (axes[metal] >> side // 2) & 1 == 0
    metal, side = metal[hidden], side[hidden]
    box = np.searchsorted(cells.first, metal, side="right") - 1
    # A cell that has the metal on its upper side lies below it.
    neighbour = metal + np.where(side % 2 == 1, -1, 1) * cells.stride[box, side // 2]
    within = (neighbour >= cells.first[box]) & (neighbour < cells.first[box + 1])
    metal, side, neighbour = metal[within], side[within], neighbour[within]
    inner = cells.decoded(neighbour)[2]
    arm = 6 * neighbour[inner] + side[inner]
    return Crossings(arm, np.ones(len(arm)), owner[metal[inner]], np.full(len(arm), -1))

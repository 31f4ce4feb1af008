"""Cells that refinement at conductors asks for: all at a surface, or those at edges and strong curvature."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from functools import cache, partial

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..shapes.spans import Ints
from .arms import Lattice, arms_of_boxes
from .conductor import Conductor
from .edges import edge_cells

Bools = NDArray[np.bool_]
# (electrodes, boxes (n, 6) of a level, its origin and spacing in m) -> a bool per cell, box after box, x fastest
Beside = Callable[[Sequence[Conductor], ArrayLike, ArrayLike, ArrayLike], Bools]


@dataclass
class Remembered:
    """A function that marks cells beside electrodes, which does not trace these again for boxes that it has marked last."""

    mark: Beside
    _known: list[tuple[object, dict[bytes, Bools]]] = field(default_factory=list)  # of the latest questions
    _MOST = 16  # levels of a mesh, for a few sets of electrodes

    def __call__(
        self, electrodes: Sequence[Conductor], boxes: ArrayLike, origin: ArrayLike, spacing: ArrayLike
    ) -> Bools:
        rows = np.reshape(np.asarray(boxes, np.int64), (-1, 6))
        where = [electrode.shape for electrode in electrodes], np.asarray(origin).tolist(), np.asarray(spacing).tolist()
        known = next((marks for asked, marks in self._known if asked == where), {})
        names = [row.tobytes() for row in rows]
        new = [name not in known for name in names]
        sizes = (rows[new, 3:] - rows[new, :3] + 1).prod(axis=1)
        marks_of_new = (
            np.split(self.mark(electrodes, rows[new], origin, spacing), np.cumsum(sizes)[:-1]) if any(new) else []
        )
        of_new = iter(marks_of_new)
        marks = {name: next(of_new) if is_new else known[name] for name, is_new in zip(names, new, strict=True)}
        self._known = [(where, marks), *(one for one in self._known if one[0] != where)][: self._MOST]
        return np.concatenate([np.empty(0, bool), *(marks[name] for name in names)])


@cache
def remembered_edges(angle: float) -> Remembered:
    """Return `beside_edges` of an angle."""
    return Remembered(partial(beside_edges, angle=angle))


def inside(electrodes: Sequence[Conductor], boxes: ArrayLike, origin: ArrayLike, spacing: ArrayLike) -> Bools:
    """Return which cells of boxes have their centre in metal, box after box, x fastest."""
    arms, _ = arms_of_boxes(electrodes, boxes, origin, spacing)
    cells = [arms.solid[begin:end] for begin, end in zip(arms.first_solid[:-1], arms.first_solid[1:], strict=True)]
    return marked(cells, (), boxes, origin, spacing)


def beside_surfaces(electrodes: Sequence[Conductor], boxes: ArrayLike, origin: ArrayLike, spacing: ArrayLike) -> Bools:
    """Return which cells of boxes have an arm that metal cuts, box after box, x fastest; and those that wires hide in."""
    arms, _ = arms_of_boxes(electrodes, boxes, origin, spacing)
    cells = [arms.cell[begin:end] for begin, end in zip(arms.first_cut[:-1], arms.first_cut[1:], strict=True)]
    return marked(cells, electrodes, boxes, origin, spacing)


def beside_edges(
    electrodes: Sequence[Conductor], boxes: ArrayLike, origin: ArrayLike, spacing: ArrayLike, angle: float = 0.35
) -> Bools:
    """Return which cells of boxes lie at edges and strong curvature, as `edge_cells` has them; and those that wires hide in."""
    return marked(edge_cells(electrodes, boxes, origin, spacing, angle), electrodes, boxes, origin, spacing)


def marked(
    cells: Sequence[Ints], electrodes: Sequence[Conductor], boxes: ArrayLike, origin: ArrayLike, spacing: ArrayLike
) -> Bools:
    """Return a bool per cell of boxes: those of these numbers in their boxes, and those that hidden electrodes touch."""
    lattice, out = Lattice.of(origin, spacing), [np.empty(0, bool)]
    hidden = [touched for electrode in electrodes if (touched := hidden_in(electrode, lattice)) is not None]
    for box, numbers in zip(np.reshape(np.asarray(boxes, np.int64), (-1, 6)), cells, strict=True):
        marks = np.zeros((box[3:] - box[:3] + 1)[::-1], bool)
        marks.reshape(-1)[numbers] = True
        for first, last in hidden:
            begin, end = np.maximum(first - box[:3], 0), np.maximum(last - box[:3] + 1, 0)
            marks[begin[2] : end[2], begin[1] : end[1], begin[0] : end[0]] = True
        out.append(marks.ravel())
    return np.concatenate(out)


def hidden_in(electrode: Conductor, lattice: Lattice) -> tuple[Ints, Ints] | None:
    """Return the first and the last cell that an electrode touches, if it is thinner than a cell along two axes or all.

    Lines between centres may miss such a ball, or a wire along an axis.
    """
    lower, upper = (
        np.stack([lattice.index(a, corner[a]) for a in range(3)]) for corner in np.array(electrode.shape.bounds)
    )
    if np.count_nonzero(upper - lower < 1) < 2:
        return None
    return np.floor(lower + 0.5).astype(np.int64), np.floor(upper + 0.5).astype(np.int64)


remembered_surfaces = Remembered(beside_surfaces)
remembered_insides = Remembered(inside)

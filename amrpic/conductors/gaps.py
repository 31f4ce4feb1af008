"""Gaps: stretches of lines between two pieces of metal in which no centre of a cell lies."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..shapes.spans import Floats, Ints
from .arms import TOUCH, Lattice, indices_of
from .contacts import LineSpans

WALL = -1  # in place of the number of an electrode


class Gaps(NamedTuple):
    """Gaps between different electrodes, or one and a wall, each on an arm from the centre of a cell up to that of the next."""

    arms: NDArray[np.int32]  # (n, 6) index of the cell (3), axis, electrodes below and above the gap
    width: Floats  # (n,) over the spacing


NO_GAPS = Gaps(np.empty((0, 6), np.int32), np.empty(0))


def gaps(lines: Sequence[Sequence[LineSpans]], lattice: Lattice, walls: Floats) -> Gaps:
    """Return the gaps on lines that electrodes (n) have along x, y and z, none where they are elsewhere.

    `walls` (2, 3): coordinates of the lower and upper faces of the domain that hold a potential, m; infinite where none does.
    """
    parts = [_along(axis, lines, lattice, walls[:, axis]) for axis in range(3)]
    return Gaps(*(np.concatenate(column) for column in zip(*parts, strict=True)))


def _along(axis: int, lines: Sequence[Sequence[LineSpans]], lattice: Lattice, walls: Floats) -> Gaps:
    traced = [(number, of_axes[axis]) for number, of_axes in enumerate(lines) if of_axes]
    columns = [
        (part.key[part.spans.line], part.spans.enter, part.spans.leave, np.full(len(part.spans), number))
        for number, part in traced
    ]
    if not columns:
        return NO_GAPS
    key, enter, leave, owner = (np.concatenate(column) for column in zip(*columns, strict=True))
    width = lattice.spacing[axis]
    at_walls = [
        (beside, np.full(len(beside), low), np.full(len(beside), high), np.full(len(beside), WALL))
        for beside, low, high in (
            (np.unique(key[enter < walls[0] + width]), -np.inf, walls[0]),
            (np.unique(key[leave > walls[1] - width]), walls[1], np.inf),
        )
        if len(beside)
    ]
    if not at_walls and len(columns) < 2:
        return NO_GAPS
    key, enter, leave, owner = (
        np.concatenate(column) for column in zip((key, enter, leave, owner), *at_walls, strict=True)
    )
    below, above = _in_turn(key, enter, leave)
    apart = (key[below] == key[above]) & (owner[below] != owner[above])
    below, above = below[apart], above[apart]
    cell = np.floor(lattice.index(axis, leave[below]) + TOUCH)  # with the last centre below
    share = (enter[above] - leave[below]) / width
    missed = (share > TOUCH) & (cell + 1 >= lattice.index(axis, enter[above]) - TOUCH)
    below, above = below[missed], above[missed]
    arms = np.empty((len(below), 6), np.int32)
    u, v = (a for a in range(3) if a != axis)
    arms[:, u], arms[:, v] = indices_of(key[below])
    arms[:, axis], arms[:, 3] = cell[missed], axis
    arms[:, 4], arms[:, 5] = owner[below], owner[above]
    return Gaps(arms, share[missed])


def _in_turn(key: Ints, enter: Floats, leave: Floats) -> tuple[Ints, Ints]:
    """Return pairs of intervals, line by line: the one that reaches farthest of those before, and the next one."""
    order, by_end = np.lexsort((enter, key)), np.lexsort((leave, key))
    rank = np.empty_like(by_end)
    rank[by_end] = np.arange(len(by_end))
    return by_end[np.maximum.accumulate(rank[order])][:-1], order[1:]

# mypy: disable-error-code="misc"
"""An independent oracle for gaps without a centre of a cell: line by line, the flux of parallel plates through each."""

from __future__ import annotations

import itertools
from collections.abc import Callable, Iterator, Sequence

import numpy as np
from scipy.constants import epsilon_0

from amrpic import Domain, Electrode

Array = np.ndarray
TOUCH = 1e-9  # of an arm: a surface that is nearer to a centre has it in its metal
WALL = -1


def charges_at_gaps(
    domain: Domain,
    shape: Sequence[int],
    electrodes: Sequence[Electrode],
    values: Callable[..., float],
    stretch: Array,
    exists: Array | None = None,
    covered: Array | None = None,
) -> tuple[Array, Array]:
    """Return the charges on electrodes (n,) at gaps on a level by their voltages, (n, n) F, and by walls, (n,) C.

    The level has the cells (x, y, z) that exist, of as many as `shape` says in the whole domain; all by default.
    """
    exists = np.ones(shape, bool) if exists is None else exists
    covered = np.zeros(shape, bool) if covered is None else covered
    spacing = np.subtract(domain.upper, domain.lower) / shape
    of_metal, of_walls = np.zeros((len(electrodes), len(electrodes))), np.zeros(len(electrodes))
    for axis in range(3):
        size, is_periodic = shape[axis], domain.periodic[axis]
        area = epsilon_0 * np.prod(spacing) / (spacing[axis] * stretch[axis] ** 2)
        for line, cell, width, below, above in gaps_along(domain, shape, electrodes, axis):
            ends = [np.insert(line, axis, (cell + side) % size) for side in range(2)]
            inside = [0 <= cell + side < size for side in range(2)]
            if any((on == WALL) == (is_in or is_periodic) for on, is_in in zip((below, above), inside, strict=True)):
                continue  # behind a wall
            metal = [tuple(end) for end, on in zip(ends, (below, above), strict=True) if on != WALL]
            if any(covered[end] for end in metal):
                continue
            for side, (own, other) in enumerate(((below, above), (above, below))):
                counting = side if exists[tuple(ends[side])] else 1 - side  # finer cells, for both sides
                if own == WALL or not inside[counting] or not exists[tuple(ends[counting])]:
                    continue
                of_metal[own, own] += area / width
                if other != WALL:
                    of_metal[own, other] -= area / width
                    continue
                place = np.asarray(domain.lower) + (ends[side] + 0.5) * spacing
                place[axis] = (domain.lower if side else domain.upper)[axis]
                of_walls[own] -= area / width * values(*place)
    return of_metal, of_walls


def gaps_along(
    domain: Domain, shape: Sequence[int], electrodes: Sequence[Electrode], axis: int
) -> Iterator[tuple[Array, int, float, int, int]]:
    """Yield gaps: indices of the line (2,), the cell whose centre is the last below, width (m), what is below and above."""
    lower, spacing = np.asarray(domain.lower), np.subtract(domain.upper, domain.lower) / shape
    u, v = (a for a in range(3) if a != axis)
    lines = np.array(list(itertools.product(range(shape[u]), range(shape[v]))))
    places = np.zeros((len(lines), 3))
    places[:, u], places[:, v] = (lower[a] + (lines[:, n] + 0.5) * spacing[a] for n, a in enumerate((u, v)))
    pieces: list[list[tuple[float, float, int]]] = [[] for _ in lines]
    for number, electrode in enumerate(electrodes):
        spans = electrode.shape.spans(places, axis)
        for line, enter, leave in zip(spans.line.tolist(), spans.enter.tolist(), spans.leave.tolist(), strict=True):
            pieces[line].append((enter, leave, number))
    walls = []
    if domain.boundary[axis][0] == "dirichlet":
        walls.append((-np.inf, domain.lower[axis], WALL))
    if domain.boundary[axis][1] == "dirichlet":
        walls.append((domain.upper[axis], np.inf, WALL))
    start, h = lower[axis], spacing[axis]
    for line, metal in zip(lines, pieces, strict=True):
        end, below = -np.inf, None
        for enter, leave, above in sorted(metal + walls) if metal else ():
            if below is not None and above != below and enter - end > TOUCH * h:
                cell = int(np.floor((end - start) / h - 0.5 + TOUCH))
                if start + (cell + 1.5 + TOUCH) * h >= enter:
                    yield line, cell, enter - end, below, above
            if leave >= end:
                end, below = leave, above

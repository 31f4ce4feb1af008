"""Regions of a mesh as bool arrays over the whole domain, and what tags must make of them, in plain NumPy."""

from __future__ import annotations

import itertools
from collections.abc import Sequence

import numpy as np

from amrpic import Hierarchy
from amrpic.stages.regrid import Regridding


def mask(hierarchy: Hierarchy, level: int) -> np.ndarray:
    """How many boxes of a level cover each of its cells; none if it does not exist."""
    out = np.zeros(np.array(hierarchy.domain.cells) * 2**level, dtype=int)
    for a, b, c, d, e, f in hierarchy.boxes(level) if level < hierarchy.levels else ():
        out[a : d + 1, b : e + 1, c : f + 1] += 1
    return out


def same_region(a: Hierarchy, b: Hierarchy) -> bool:
    """Whether two hierarchies refine the same cells; on other numbers of ranks boxes may differ."""
    return a.domain == b.domain and all(
        np.array_equal(mask(a, level), mask(b, level)) for level in range(max(a.levels, b.levels))
    )


def blocks_of(hierarchy: Hierarchy, level: int) -> set[tuple[int, ...]]:
    """The blocks that a level's boxes are made of, however they are cut, by their indices."""
    out: set[tuple[int, ...]] = set()
    for box in hierarchy.boxes(level) // hierarchy.blocking_factor:
        out.update(itertools.product(*(range(a, b + 1) for a, b in zip(box[:3], box[3:], strict=True))))
    return out


def grown(marks: np.ndarray, by: int, periodic: tuple[bool, bool, bool]) -> np.ndarray:
    for axis in range(3):
        widths = [(by, by) if d == axis else (0, 0) for d in range(3)]
        padded = np.pad(marks, widths, mode="wrap") if periodic[axis] else np.pad(marks, widths)
        n = marks.shape[axis]
        marks = np.logical_or.reduce([padded.take(range(s, s + n), axis=axis) for s in range(2 * by + 1)])
    return marks


def finer(marks: np.ndarray, factor: int = 2) -> np.ndarray:
    return marks.repeat(factor, 0).repeat(factor, 1).repeat(factor, 2)


def coarser(marks: np.ndarray, factor: int = 2) -> np.ndarray:
    """Cubes of `factor` cells of which any is marked; the last one along an axis may be shorter."""
    filled = np.pad(marks, [(0, -n % factor) for n in marks.shape])
    a, b, c = (n // factor for n in filled.shape)
    return np.asarray(filled.reshape(a, factor, b, factor, c, factor).any(axis=(1, 3, 5)))


def wanted_blocks(
    hierarchy: Hierarchy,
    tags: Sequence[np.ndarray],
    settings: Regridding,
    kept: Sequence[np.ndarray] = (),
    static: Sequence[Sequence[Sequence[int]]] = (),
) -> list[np.ndarray]:
    """Which blocks of levels 1, 2, ... must exist after a regrid: bool over the blocks of the domain.

    `tags[l]`, `kept[l]` are bool over all cells of level l; `static[k]` are index boxes of level k + 1.
    """
    edge, periodic = hierarchy.blocking_factor, hierarchy.domain.periodic
    out: list[np.ndarray] = []
    for level in range(max(len(tags), len(static)), 0, -1):
        cells = np.array(hierarchy.domain.cells) * 2**level
        blocks = np.zeros(-(-cells // edge), dtype=bool)
        exists = mask(hierarchy, level - 1) == 1
        if level <= len(tags):
            blocks |= coarser(finer(grown(tags[level - 1] & exists, settings.buffer, periodic)), edge)
        if level <= len(kept):
            stays = coarser(finer(grown(kept[level - 1] & exists, settings.buffer, periodic)), edge)
            blocks |= stays & coarser(mask(hierarchy, level) == 1, edge)
        for a, b, c, d, e, f in static[level - 1] if level <= len(static) else ():
            blocks[a // edge : d // edge + 1, b // edge : e // edge + 1, c // edge : f // edge + 1] = True
        if out:  # the finer level, with room around it
            nx, ny, nz = 2 * cells
            covered = finer(out[0], edge)[:nx, :ny, :nz]
            blocks |= coarser(grown(coarser(covered), settings.nesting, periodic), edge)
        out.insert(0, blocks)
    return out

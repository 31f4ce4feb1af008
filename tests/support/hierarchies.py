"""Seeded hierarchies of awkward shape, as plain data, properly nested by construction.

A level is a mask of blocks (`blocking_factor` cells wide, the last one along an axis perhaps shorter) within what its
coarser level allows: a block may be refined if its cells and all their neighbours, also the diagonal ones, exist on the
coarser level. Walls need no neighbours beyond them; periodic faces do.
"""

from __future__ import annotations

import itertools
import zlib
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from functools import cache
from typing import Any

import numpy as np
import pytest

Box = tuple[tuple[int, int, int], tuple[int, int, int]]
Mask = np.ndarray  # bool (nx, ny, nz)
Shape = Callable[[np.random.Generator, tuple[int, int, int]], Mask]


@dataclass(frozen=True)
class Case:
    """A hierarchy as plain data; `levels[k]` holds the inclusive boxes of level k + 1 before any cut."""

    name: str
    cells: tuple[int, int, int]
    boundary: dict[str, tuple[str, str]]
    blocking_factor: int
    max_grid_size: int
    levels: tuple[tuple[Box, ...], ...]
    lower: tuple[float, float, float] = (-1.0, 0.5, 0.0)
    upper: tuple[float, float, float] = (1.0, 2.5, 2.0)

    def boxes(self, level: int) -> list[tuple[int, ...]]:
        """Return the boxes of a level (the base included), uncut, each as lower x, y, z and upper x, y, z."""
        if level == 0:
            return [(0, 0, 0, self.cells[0] - 1, self.cells[1] - 1, self.cells[2] - 1)]
        return [(*lower, *upper) for lower, upper in self.levels[level - 1]]

    def all_boxes(self) -> list[list[tuple[int, ...]]]:
        return [self.boxes(level) for level in range(len(self.levels) + 1)]


# --- shapes: masks of blocks on a grid of n blocks per axis -----------------------------------------------------------


def grid(n: tuple[int, int, int]) -> list[np.ndarray]:
    return list(np.meshgrid(*(np.arange(count) for count in n), indexing="ij"))


def everything(rng: np.random.Generator, n: tuple[int, int, int]) -> Mask:
    return np.ones(n, dtype=bool)


def l_shape(rng: np.random.Generator, n: tuple[int, int, int]) -> Mask:
    x, y, _ = grid(n)
    return (2 * x < n[0]) | (2 * y < n[1])


def u_shape(rng: np.random.Generator, n: tuple[int, int, int]) -> Mask:
    x, y, _ = grid(n)
    return np.asarray((3 * x < n[0]) | (3 * (x + 1) > 2 * n[0]) | (3 * y < n[1]))


def checkerboard(rng: np.random.Generator, n: tuple[int, int, int]) -> Mask:
    x, y, z = grid(n)
    return (x + y + z) % 2 == 0


def columns_checkerboard(rng: np.random.Generator, n: tuple[int, int, int]) -> Mask:
    x, y, _ = grid(n)
    return (x + y) % 2 == 0


def gap_of_one_block(rng: np.random.Generator, n: tuple[int, int, int]) -> Mask:
    x, _, _ = grid(n)
    return x != n[0] // 2


def crossed_gaps(rng: np.random.Generator, n: tuple[int, int, int]) -> Mask:
    x, y, z = grid(n)
    return (x != n[0] // 2) & (y != n[1] // 2) & (z != n[2] // 2)


def hole(rng: np.random.Generator, n: tuple[int, int, int]) -> Mask:
    x, y, z = grid(n)
    return (x != n[0] // 2) | (y != n[1] // 2) | (z != n[2] // 2)


def lower_corner(rng: np.random.Generator, n: tuple[int, int, int]) -> Mask:
    x, y, z = grid(n)
    return (2 * x < n[0]) & (2 * y < n[1]) & (2 * z < n[2])


def upper_edge(rng: np.random.Generator, n: tuple[int, int, int]) -> Mask:
    x, y, _ = grid(n)
    return (2 * x >= n[0]) & (2 * y >= n[1])


def upper_corner(rng: np.random.Generator, n: tuple[int, int, int]) -> Mask:
    x, y, z = grid(n)
    return (2 * x >= n[0]) & (2 * y >= n[1]) & (2 * z >= n[2])


def lower_face(rng: np.random.Generator, n: tuple[int, int, int]) -> Mask:
    return grid(n)[2] < max(1, n[2] // 3)


def both_ends(rng: np.random.Generator, n: tuple[int, int, int]) -> Mask:
    """Two slabs at the ends of x; over a periodic x they are one region that wraps."""
    x, _, _ = grid(n)
    return (x == 0) | (x == n[0] - 1)


def all_but_lowest(rng: np.random.Generator, n: tuple[int, int, int]) -> Mask:
    """A patch that leaves the lowest cells along z out: around the axis its ends look at the same ones."""
    x, y, z = grid(n)
    return (x < (n[0] + 1) // 2) & (y < (n[1] + 1) // 2) & (z > 0)


def all_corners(rng: np.random.Generator, n: tuple[int, int, int]) -> Mask:
    """Blocks at the eight corners; over periodic axes they are one block that wraps all of them."""
    ends = [(index == 0) | (index == count - 1) for index, count in zip(grid(n), n, strict=True)]
    return ends[0] & ends[1] & ends[2]


def scattered(density: float, width: int = 1000) -> Shape:
    """Return a shape of single blocks here and there, in a region of at most `width` blocks per axis."""

    def shape(rng: np.random.Generator, n: tuple[int, int, int]) -> Mask:
        mask = np.zeros(n, dtype=bool)
        start = [int(rng.integers(0, max(0, count - width) + 1)) for count in n]
        mask[tuple(slice(first, first + width) for first in start)] = True
        return mask & (rng.random(n) < density)

    return shape


def lower_half(shape: Shape) -> Shape:
    """Return the lower half along z of the shape."""

    def lower(rng: np.random.Generator, n: tuple[int, int, int]) -> Mask:
        return shape(rng, n) & (2 * grid(n)[2] < n[2])

    return lower


# Coarse cells covered around one that holds a ghost, such that of two 3 x 3 blocks that do not overlap much both are free.
CROSSINGS = (
    ((-1, -1), (1, 1)),
    ((-1, 1), (1, -1)),
    ((-2, -1), (1, 1)),
    ((-1, 1), (1, -2)),
    ((1, -1), (-2, 1)),
    ((-1, -1), (2, 1)),
)


def crossings(normal: int) -> Shape:
    """Return single blocks that leave a choice of 3 x 3 blocks around a ghost: pairs of layers along the normal, the one
    with a block in the middle, the other with two blocks off the middle."""

    def shape(rng: np.random.Generator, n: tuple[int, int, int]) -> Mask:
        layers = np.zeros((2 * len(CROSSINGS), 6, 6), dtype=bool)
        for pair, blocks in enumerate(CROSSINGS):
            layers[2 * pair, 3, 3] = True
            for i, j in blocks:
                layers[2 * pair + 1, 3 + i, 3 + j] = True
        mask = np.zeros(n, dtype=bool)
        turned = np.moveaxis(layers, 0, normal)
        mask[tuple(slice(0, count) for count in turned.shape)] = turned
        return mask

    return shape


def enlarged(shape: Shape, factor: int = 2) -> Shape:
    """Return the shape drawn in squares of `factor` blocks."""

    def larger(rng: np.random.Generator, n: tuple[int, int, int]) -> Mask:
        few = shape(rng, (-(-n[0] // factor), -(-n[1] // factor), -(-n[2] // factor)))
        return few.repeat(factor, 0).repeat(factor, 1).repeat(factor, 2)[: n[0], : n[1], : n[2]]

    return larger


def within(shape: Shape, margin: int = 1) -> Shape:
    """Return the shape with an empty margin of blocks around it."""

    def inner(rng: np.random.Generator, n: tuple[int, int, int]) -> Mask:
        mask = np.zeros(n, dtype=bool)
        core = tuple(slice(margin, count - margin) for count in n)
        mask[core] = shape(rng, mask[core].shape)
        return mask

    return inner


# --- from shapes to boxes -------------------------------------------------------------------------------------------


def eroded(mask: Mask, periodic: Sequence[bool]) -> Mask:
    """Return the cells whose 26 neighbours all are in the mask, beyond walls aside."""
    for axis in range(3):
        low, high = np.roll(mask, 1, axis), np.roll(mask, -1, axis)
        if not periodic[axis]:
            first, last = (tuple(end if a == axis else slice(None) for a in range(3)) for end in (0, -1))
            low[first], high[last] = True, True
        mask = low & mask & high
    return mask


def doubled(mask: Mask) -> Mask:
    return mask.repeat(2, axis=0).repeat(2, axis=1).repeat(2, axis=2)


def whole_blocks(mask: Mask, size: int) -> Mask:
    """Return the blocks that lie in the mask of cells as a whole; the last one along an axis may be shorter."""
    filled = np.pad(mask, [(0, -count % size) for count in mask.shape], constant_values=True)
    nx, ny, nz = (count // size for count in filled.shape)
    return np.asarray(filled.reshape(nx, size, ny, size, nz, size).all(axis=(1, 3, 5)))


def cells_of_blocks(blocks: Mask, size: int, cells: tuple[int, ...]) -> Mask:
    """Return the mask of so many cells that the blocks cover."""
    nx, ny, nz = cells
    return blocks.repeat(size, 0).repeat(size, 1).repeat(size, 2)[:nx, :ny, :nz]


def cut_out(allowed: Mask, shape: Shape, rng: np.random.Generator) -> Mask:
    """Return the allowed blocks that the shape takes, the shape fitted to the extent of the allowed blocks."""
    if not allowed.any():
        return allowed
    places = np.nonzero(allowed)
    extent = tuple(slice(int(p.min()), int(p.max()) + 1) for p in places)
    blocks = np.zeros_like(allowed)
    blocks[extent] = shape(rng, blocks[extent].shape) & allowed[extent]
    return blocks


def boxes_of(blocks: Mask, size: int, cells: tuple[int, ...]) -> tuple[Box, ...]:
    """Return disjoint boxes of cells that make up the blocks: the first free block grown along x, then y, then z.

    The level has so many `cells`, where its last blocks end.
    """
    free = blocks.copy()
    boxes = []
    for start in itertools.product(*(range(count) for count in free.shape)):
        if not free[start]:
            continue
        stop = [index + 1 for index in start]
        for axis in range(3):
            while stop[axis] < free.shape[axis] and free[region(start, stop, axis)].all():
                stop[axis] += 1
        free[tuple(slice(a, b) for a, b in zip(start, stop, strict=True))] = False
        x0, y0, z0 = (index * size for index in start)
        x1, y1, z1 = (min(index * size, count) - 1 for index, count in zip(stop, cells, strict=True))
        boxes.append(((x0, y0, z0), (x1, y1, z1)))
    return tuple(boxes)


def region(start: Sequence[int], stop: Sequence[int], axis: int) -> tuple[slice, ...]:
    """Return the slab of blocks just above a box along an axis."""
    slab = [slice(a, b) for a, b in zip(start, stop, strict=True)]
    slab[axis] = slice(stop[axis], stop[axis] + 1)
    return tuple(slab)


def make(
    name: str,
    cells: tuple[int, int, int],
    boundary: str,
    blocking_factor: int,
    shapes: Sequence[Shape],
    max_grid_size: int = 8,
    upper: tuple[float, float, float] = (1.0, 2.5, 2.0),
) -> Case:
    """Return the case with one refined level per shape; `boundary` has one letter per face, in the order x-x+y-y+z-z+."""
    rng = np.random.default_rng(zlib.crc32(name.encode()))
    kinds = {"d": "dirichlet", "n": "neumann", "p": "periodic", "o": "open"}
    faces = {axis: (kinds[boundary[2 * a]], kinds[boundary[2 * a + 1]]) for a, axis in enumerate("xyz")}
    periodic = [faces[axis][0] == "periodic" for axis in "xyz"]
    mask: Mask = np.ones(cells, dtype=bool)
    levels: list[tuple[Box, ...]] = []
    for shape in shapes:
        allowed = doubled(eroded(mask, periodic))
        blocks = cut_out(whole_blocks(allowed, blocking_factor), shape, rng)
        if not blocks.any():
            raise ValueError(f"{name}: level {len(levels) + 1} is empty")
        levels.append(boxes_of(blocks, blocking_factor, allowed.shape))
        mask = cells_of_blocks(blocks, blocking_factor, allowed.shape)
    return Case(name, cells, faces, blocking_factor, max_grid_size, tuple(levels), upper=upper)


STRETCHED = (1.0, 2.0, 3.5)  # upper corner that gives cells of three widths


def named_cases() -> list[Case]:
    """Return the shapes that tests should meet by name."""
    n8, n16 = (8, 8, 8), (16, 16, 8)
    return [
        make("single level", (8, 6, 4), "dnonoo", 2, []),
        make("L, away from walls", (12, 12, 8), "dddddd", 4, [within(l_shape)]),
        make(
            "L at the walls, anisotropic", (8, 12, 8), "dnndnn", 4, [lower_half(l_shape), lower_corner], upper=STRETCHED
        ),
        make("L of large blocks", n16, "dddddd", 8, [lower_half(l_shape)], max_grid_size=16),
        make("U, away from walls", (12, 12, 8), "oooooo", 4, [within(u_shape)], max_grid_size=4),
        make("U of small blocks, three levels", n8, "dddddd", 2, [within(u_shape), u_shape], max_grid_size=6),
        make("U of large blocks in a periodic box", (24, 8, 8), "pppppp", 8, [lower_half(u_shape)], max_grid_size=24),
        make("checkerboard 2", (6, 8, 6), "pppppp", 2, [checkerboard]),
        make("checkerboard 4", n8, "dndndn", 4, [checkerboard], max_grid_size=4, upper=STRETCHED),
        make("checkerboard 8", (8, 8, 16), "nnnnnn", 8, [checkerboard]),
        make("columns of a checkerboard", n8, "ppddnn", 2, [enlarged(columns_checkerboard), scattered(0.9, 12)]),
        make("columns of a checkerboard, large blocks", n16, "dddddd", 8, [lower_half(columns_checkerboard)]),
        make("gap of one small block", n8, "dddddd", 2, [within(gap_of_one_block), scattered(0.95, 6)]),
        make("gap of one block", (12, 8, 8), "nnnnnn", 4, [lower_half(gap_of_one_block)], upper=STRETCHED),
        make("gap of one large block", (24, 8, 8), "oooooo", 8, [lower_half(gap_of_one_block)], max_grid_size=16),
        make("crossed gaps", n8, "pppppp", 2, [crossed_gaps, scattered(1.0, 5)], max_grid_size=4),
        make("crossed gaps of larger blocks", (12, 12, 8), "dddddd", 4, [crossed_gaps], max_grid_size=12),
        make("hole of one block", n8, "nnnnnn", 2, [within(hole)]),
        make("corner", n8, "dnondo", 2, [lower_corner, lower_corner, lower_corner], upper=STRETCHED),
        make("corner of large blocks", n16, "oooooo", 8, [lower_corner, lower_corner], max_grid_size=16),
        make("edge", n8, "dddddd", 4, [upper_edge, upper_edge], max_grid_size=8),
        make("face", (8, 8, 12), "nndddn", 4, [lower_face, lower_half(lower_corner)]),
        make("open face", n8, "oooooo", 2, [lower_face, lower_face, scattered(0.7, 8)]),
        make("region wrapping x", n8, "ppdddd", 2, [both_ends, lower_half(both_ends)], upper=STRETCHED),
        make("region wrapping all axes", (8, 8, 12), "pppppp", 4, [all_corners]),
        make("region wrapping all axes, four levels", n8, "pppppp", 2, [all_corners, everything, everything]),
        make("region wrapping large blocks", (24, 8, 8), "ppnnnn", 8, [both_ends], max_grid_size=8),
        make("narrow periodic axis", (8, 8, 4), "nnddpp", 4, [l_shape, lower_corner], upper=STRETCHED),
        make("two cells around a periodic axis", (8, 8, 2), "nnddpp", 2, [l_shape], upper=(1.0, 2.0, 0.5)),
        make("three cells around a periodic axis", (8, 8, 3), "nnddpp", 2, [all_but_lowest], upper=(1.0, 2.0, 0.7)),
        make("crossings normal to x", (12, 6, 6), "ddnndd", 2, [crossings(0)]),
        make("crossings normal to y", (6, 12, 6), "oooooo", 2, [crossings(1)]),
        make("crossings normal to z", (6, 6, 12), "pppppp", 2, [crossings(2)]),
        make("all refined", n8, "dndndn", 4, [everything, scattered(1.0, 2)], max_grid_size=16),
        make("odd cells, refined at upper walls", (9, 7, 11), "dndnnd", 4, [upper_corner, upper_corner]),
        make("odd cells, refined across periodic faces", (9, 13, 7), "ppppdd", 4, [all_corners], upper=STRETCHED),
        make("fewer cells than a block", (5, 11, 3), "oooooo", 8, [upper_edge]),
        make(
            "a layer beyond the last block, all refined",
            (9, 5, 5),
            "ppnnpp",
            4,
            [everything, both_ends],
            max_grid_size=4,
        ),
    ]


def random_case(seed: int, long_cells: bool = True) -> Case:
    """Return a hierarchy of scattered blocks; boundary, sizes, widths and number of levels are drawn from the seed.

    `long_cells`: cells are of any shape; else none is longer than 1:1.7.
    """
    rng = np.random.default_rng(seed)
    blocking_factor = int(rng.choice([2, 2, 4]))
    cells = tuple(int(n) for n in rng.choice([6, 8, 10] if blocking_factor == 2 else [8, 12], size=3))
    axes = [str(rng.choice(["pp", "dd", "nn", "dn", "nd"])) for _ in range(3)]
    boundary = "oooooo" if rng.random() < 0.25 else "".join(axes)
    wide, narrow = 16 // blocking_factor, 12 // blocking_factor
    deep = [scattered(0.9, wide), scattered(0.9, narrow), scattered(0.9, narrow)]
    alone = [scattered(float(rng.uniform(0.4, 0.8)), wide)]
    shapes = alone if rng.random() < 0.5 else deep[: int(rng.integers(2, 4))]
    upper = tuple(float(x) for x in (-1, 0.5, 0) + 2 * rng.choice([0.5, 1.0, 1.3, 2.0], size=3))
    size = int(rng.choice([blocking_factor, 2 * blocking_factor, 8]))
    if not long_cells:
        upper = tuple(float(x) for x in (-1, 0.5, 0) + 0.1 * np.array(cells) * rng.choice([1.0, 1.3, 1.7], size=3))
    for count in range(len(shapes), 0, -1):  # scattered blocks may leave no room for the deepest level
        try:
            return make(f"scattered {seed}", cells, boundary, blocking_factor, shapes[:count], size, upper)  # type: ignore[arg-type]
        except ValueError:
            continue
    raise ValueError(f"seed {seed} makes no hierarchy")


# Those whose operators take an oracle longest.
LARGE = {"corner of large blocks", "L of large blocks", "U of large blocks in a periodic box", "all refined"}


def for_the_oracle(names: Iterable[str]) -> list[Any]:
    """Return parameters of tests that take an oracle's operators: those of LARGE are long ones."""
    return [pytest.param(name, marks=pytest.mark.long) if name in LARGE else name for name in names]


@cache
def all_cases() -> dict[str, Case]:
    """Return every case by name."""
    cases = named_cases() + [random_case(seed) for seed in range(12)]
    return {case.name: case for case in cases}

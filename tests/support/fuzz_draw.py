"""Random cases, and plainer ones near a given one."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np

from fuzz_case import DEFAULT_BOXES, GAUSSIAN, Box, Case, Faces, noise
from hierarchies import (
    Mask,
    Shape,
    all_corners,
    both_ends,
    boxes_of,
    checkerboard,
    columns_checkerboard,
    crossed_gaps,
    cut_out,
    doubled,
    enlarged,
    eroded,
    everything,
    gap_of_one_block,
    hole,
    l_shape,
    lower_corner,
    lower_face,
    scattered,
    u_shape,
    upper_edge,
    within,
)


@dataclass(frozen=True)
class Size:
    """How large cases may be."""

    fewest: (
        int  # cells on all levels that a case may have are drawn between these two, small ones as often as large ones
    )
    most: int
    rows: int  # the most for compressed rows, which are slow
    open_aspect: float  # the longest cells with open walls, whose tables take long


SMALL = Size(fewest=500, most=40_000, rows=8_000, open_aspect=3)
LARGE = Size(fewest=2_000, most=300_000, rows=30_000, open_aspect=100)


def draw(seed: int, number: int, size: Size) -> Case:
    """Case `number` of a seed; in every fourth little holds the potential, in another one faces are open beside others."""
    rng = np.random.default_rng([seed, number])
    if number % 4 == 3:
        return draw_nearly_free(rng, size)
    boundary = draw_open_beside_others(rng) if number % 4 == 1 else draw_boundary(rng)
    backend = "crs" if rng.random() < 0.2 else "matrix-free"
    most = round(math.exp(rng.uniform(math.log(size.fewest), math.log(size.most))))
    most = min(most, size.rows) if backend == "crs" else most
    blocking = int(rng.choice([2, 2, 4, 8, 8]))
    cells = draw_extents(rng, most)
    has_open = any("open" in pair for pair in boundary)
    edges = draw_edges(rng, size.open_aspect if has_open else 100.0)
    stretch = draw_stretch(rng, edges)
    spacing = tuple(float(f"{e / s:.4g}") for e, s in zip(edges, stretch, strict=True))
    levels = draw_levels(rng, cells, blocking, boundary, most)
    source = draw_source(rng)
    guess = str(rng.choice(["none", "none", "none", "random", "previous"]))
    boxes = max(blocking, int(rng.choice([blocking, 6, 8, 12, 14, 16, 24, 32, 64])))
    ranks = int(rng.integers(1, 5))
    return Case(cells, spacing, boundary, levels, blocking, stretch, source, guess, boxes, ranks, backend)  # type: ignore[arg-type]


def draw_nearly_free(rng: np.random.Generator, size: Size) -> Case:
    """A domain up to 1e5 times as long as its cells are short, by cells of up to 1:1000 or by many of them, and walls or
    screening that hold the smoothest potential as weakly as that, or more weakly."""
    backend = str(rng.choice(["matrix-free", "matrix-free", "kokkos", "crs"]))
    most = round(math.exp(rng.uniform(math.log(size.fewest), math.log(size.most))))
    most = min(most, size.rows) if backend == "crs" else most
    blocking = int(rng.choice([2, 4, 8]))
    kinds = ["dirichlet", "neumann", "neumann", "periodic"]
    pairs = [tuple(str(kind) for kind in rng.choice(kinds, 2)) for _ in range(3)]
    pairs = [("periodic",) * 2 if "periodic" in pair else pair for pair in pairs]
    edges = np.ones(3)
    match str(rng.choice(["cells", "domain", "cube"])):
        case "cells":
            cells = draw_extents(rng, most)
            edges = draw_edges(rng, 1000.0)
        case "domain":
            across = [int(n) for n in rng.integers(2, 9, 2)]
            long = int(rng.integers(0, 3))
            cells = tuple(np.insert(across, long, max(2, min(65536, most // math.prod(across)))))
            edges[long] = min(1000.0, math.exp(rng.uniform(0, math.log(1e5 / cells[long]))))
            free = [str(rng.choice(["neumann", "periodic"])) if d != long else "" for d in range(3)]
            pairs = [(kind, kind) if kind else pair for kind, pair in zip(free, pairs, strict=True)]
        case _:
            cells = draw_extents(rng, most)
            pairs = [(str(rng.choice(["neumann", "periodic"])),) * 2 for _ in range(3)]
    boundary: Faces = tuple(pairs)  # type: ignore[assignment]
    cells = tuple(map(int, cells))  # type: ignore[assignment]
    levels = draw_levels(rng, cells, blocking, boundary, most) if rng.random() < 0.6 else ()
    screening = 0.0
    if rng.random() < 0.5:
        screening = 2 ** len(levels) * math.exp(rng.uniform(math.log(1e-7), math.log(30))) / float(edges.min())
    stretch = draw_stretch(rng, edges)
    x, y, z = (float(f"{e / s:.4g}") for e, s in zip(edges, stretch, strict=True))
    guess = str(rng.choice(["none", "none", "none", "random", "previous"]))
    boxes = max(blocking, int(rng.choice([blocking, 6, 8, 12, 14, 16, 24, 32, 64])), max(cells) // 256)
    ranks, source = int(rng.integers(1, 5)), draw_source(rng)
    return Case(
        cells,
        (x, y, z),
        boundary,
        levels,
        blocking,
        stretch,
        source,
        guess,
        boxes,
        ranks,
        backend,
        "",
        float(f"{screening:.3g}"),
    )


def draw_extents(rng: np.random.Generator, most: int) -> tuple[int, int, int]:
    """2 to 80 cells per axis, short ones as often as long ones; or a cube."""
    while True:
        n = np.exp(rng.uniform(np.log(2), np.log(81), 3))
        if rng.random() < 0.35:
            n[:] = n.max()
        cells = [max(2, round(float(extent))) for extent in n]
        if math.prod(cells) <= most and max(cells) <= 80:
            return cells[0], cells[1], cells[2]


def draw_boundary(rng: np.random.Generator) -> Faces:
    """One kind all around, or any pairs of Dirichlet, Neumann and, of one of these two kinds, open or periodic faces."""
    if rng.random() < 0.6:
        kind = str(rng.choice(["open", "dirichlet", "dirichlet", "neumann", "periodic"]))
        return ((kind, kind),) * 3
    beside = ["dirichlet", "neumann", str(rng.choice(["open", "periodic"]))]
    pairs = []
    for _ in range(3):
        first, second = (str(kind) for kind in rng.choice(beside, 2))
        if "periodic" in (first, second):
            first = second = "periodic"
        pairs.append((first, second))
    return pairs[0], pairs[1], pairs[2]


def draw_open_beside_others(rng: np.random.Generator) -> Faces:
    """Any pairs, of which one face at least is open and not all are; periodic faces come in pairs."""
    kinds = ["open", "open", "dirichlet", "neumann", "periodic"]
    while True:
        pairs = [tuple(str(kind) for kind in rng.choice(kinds, 2)) for _ in range(3)]
        pairs = [("periodic",) * 2 if "periodic" in pair else pair for pair in pairs]
        if 0 < sum(face == "open" for pair in pairs for face in pair) < 6:
            return pairs[0], pairs[1], pairs[2]  # type: ignore[return-value]


def draw_edges(rng: np.random.Generator, longest: float) -> np.ndarray:
    """Edges of a cell as the solver has them, the shortest 1."""
    if rng.random() < 0.4:
        return np.ones(3)
    ratio = math.exp(rng.uniform(0, math.log(longest)))
    kinds = [(1, 1, ratio), (1, 1, ratio), (1, ratio, ratio), (1, ratio ** rng.random(), ratio)]
    return rng.permutation(np.array(kinds[rng.integers(len(kinds))]))


def draw_stretch(rng: np.random.Generator, edges: np.ndarray) -> tuple[float, float, float]:
    """What part of the edges is due to the equation: none, all, or of the longest one alone a part."""
    kind = rng.random()
    if kind < 0.4 or edges.max() == 1:
        return (1.0, 1.0, 1.0)
    share = 1.0 if kind < 0.8 else float(rng.random())
    x, y, z = (float(f"{edge**share:.3g}") for edge in edges)
    return x, y, z


SHAPES: list[Shape] = [
    everything,
    within(everything),
    l_shape,
    within(u_shape),
    u_shape,
    checkerboard,
    columns_checkerboard,
    enlarged(columns_checkerboard),
    gap_of_one_block,
    crossed_gaps,
    hole,
    lower_corner,
    upper_edge,
    lower_face,
    both_ends,
    all_corners,
    scattered(0.5),
    scattered(0.9),
]


def some_cuboids(rng: np.random.Generator, n: tuple[int, int, int]) -> Mask:
    """One to three boxes anywhere."""
    mask = np.zeros(n, dtype=bool)
    for _ in range(int(rng.integers(1, 4))):
        ends = [sorted(rng.integers(0, count + 1, 2)) for count in n]
        mask[tuple(slice(int(a), int(max(b, a + 1))) for a, b in ends)] = True
    return mask


def draw_levels(
    rng: np.random.Generator, cells: tuple[int, int, int], blocking: int, boundary: Faces, most: int
) -> tuple[tuple[Box, ...], ...]:
    """None to three levels, properly nested, fewer if there is no room for more."""
    periodic = [pair[0] == "periodic" for pair in boundary]
    mask: Mask = np.ones(cells, dtype=bool)
    left = most - math.prod(cells)
    levels: list[tuple[Box, ...]] = []
    for _ in range(int(rng.choice([0, 1, 2, 3], p=[0.3, 0.3, 0.25, 0.15]))):
        if math.prod(mask.shape) * 8 > 8_000_000:
            break  # masks of whole levels would take too much memory
        fine = doubled(eroded(mask, periodic))
        allowed = blocks_within(fine, blocking)
        shape = some_cuboids if rng.random() < 0.4 else SHAPES[rng.integers(len(SHAPES))]
        blocks = cut_out(allowed, shape, rng)
        while blocks.any() and int((grown := fully(blocks, blocking, fine.shape)).sum()) > left:
            blocks = some_of(rng, blocks)
        if not blocks.any():
            break
        left -= int(grown.sum())
        levels.append(boxes_of(blocks, blocking, fine.shape))
        mask = grown
    return tuple(levels)


def some_of(rng: np.random.Generator, blocks: Mask) -> Mask:
    """A part of the blocks: those in a smaller cuboid."""
    out = np.zeros_like(blocks)
    ends = []
    for places in np.nonzero(blocks):
        lower, upper = int(places.min()), int(places.max()) + 1
        width = max(1, (3 * (upper - lower)) // 4)
        first = int(rng.integers(lower, upper - width + 1))
        ends.append(slice(first, first + width))
    region = tuple(ends)
    out[region] = blocks[region]
    return out if out.sum() < blocks.sum() else np.zeros_like(blocks)


def blocks_within(cells: Mask, size: int) -> Mask:
    """The blocks of which all cells are marked; the last one along an axis may be shorter."""
    padding = [(0, -count % size) for count in cells.shape]
    cells = np.pad(cells, padding, constant_values=True)
    nx, ny, nz = (count // size for count in cells.shape)
    return np.asarray(cells.reshape(nx, size, ny, size, nz, size).all(axis=(1, 3, 5)))


def fully(blocks: Mask, size: int, shape: tuple[int, ...]) -> Mask:
    """The cells of blocks."""
    return blocks.repeat(size, 0).repeat(size, 1).repeat(size, 2)[: shape[0], : shape[1], : shape[2]]


def draw_source(rng: np.random.Generator) -> str:
    x, y, z = (float(f"{c:.3f}") for c in rng.uniform(0.15, 0.85, 3))
    sigma = float(f"{math.exp(rng.uniform(math.log(0.03), math.log(0.3))):.3f}")
    gaussian = f"np.exp(-((x - {x})**2 + (y - {y})**2 + (z - {z})**2) / (2 * {sigma}**2))"
    match str(rng.choice(["gaussian", "gaussian", "point", "noise", "patches", "two scales"])):
        case "point":
            return f"1.0 * ((abs(x - {x}) < h[0] / 2) & (abs(y - {y}) < h[1] / 2) & (abs(z - {z}) < h[2] / 2))"
        case "noise":
            return noise(int(rng.integers(1, 10)))
        case "patches":
            one = f"(x < {x}) * (y > {y}) * (abs(z - {z}) < {sigma})"
            return f"1.0 * {one} - 0.5 * ((x > {x}) & (abs(y - {y}) < {sigma}) & (z > -1))"
        case "two scales":
            return f"{gaussian} + 1e4 * np.exp(-((x - {y})**2 + (y - {z})**2 + (z - {x})**2) / (2 * 0.01**2))"
    return gaussian


# --- plainer cases --------------------------------------------------------------------------------------------------


def plainer(case: Case) -> Iterator[Case]:
    """Cases that are plainer than a given one in one respect, the boldest steps first. Some may be no legal case."""
    if case.levels:
        yield replace(case, levels=())
        yield replace(case, levels=case.levels[:-1])
    for ranks in range(1, case.ranks):
        yield replace(case, ranks=ranks)
    if case.backend != "matrix-free":
        yield replace(case, backend="matrix-free")
    if case.isa:
        yield replace(case, isa="")
    if case.guess != "none":
        yield replace(case, guess="none")
    if case.source != GAUSSIAN:
        yield replace(case, source=GAUSSIAN)
    if case.screening:
        yield replace(case, screening=0.0)
    yield from plainer_boundary(case)
    yield from plainer_shape(case)
    for number, boxes in enumerate(case.levels):
        yield from fewer_boxes(case, number, boxes)
    for axes in ((0, 1, 2), (0, 1), (0, 2), (1, 2), (0,), (1,), (2,)):
        yield from fewer_cells(case, axes)
    if case.blocking_factor > 2:
        yield replace(case, blocking_factor=case.blocking_factor // 2)
    if case.max_grid_size != DEFAULT_BOXES:
        yield replace(case, max_grid_size=max(DEFAULT_BOXES, case.blocking_factor))
        for size in (16, 32, 8):
            if case.max_grid_size not in (16, 32, 8) and size >= case.blocking_factor:
                yield replace(case, max_grid_size=size)


def plainer_boundary(case: Case) -> Iterator[Case]:
    plain = ("dirichlet", "dirichlet")
    if case.boundary != (plain,) * 3:
        yield replace(case, boundary=(plain,) * 3)
    for axis, pair in enumerate(case.boundary):
        if pair != plain:
            pairs = list(case.boundary)
            pairs[axis] = plain
            yield replace(case, boundary=(pairs[0], pairs[1], pairs[2]))


def plainer_shape(case: Case) -> Iterator[Case]:
    """Cubes, or widths that are whole numbers, without a stretch."""
    ones = (1.0, 1.0, 1.0)
    if case.aspect_ratio > 1:
        yield replace(case, spacing=ones, stretch=ones)
    if case.stretch != ones:
        x, y, z = (float(f"{edge:.4g}") for edge in case.edges)
        yield replace(case, spacing=(x, y, z), stretch=ones)
    edges = case.edges / case.edges.min()
    for plain in (10.0 ** np.round(np.log10(edges)), np.round(edges), np.where(edges < edges.max(), 1, edges)):
        x, y, z = (float(edge) for edge in plain)
        rounder = np.sum(plain != np.round(plain)) < np.sum(case.edges != np.round(case.edges))
        if (x, y, z) != case.spacing and (rounder or np.sum(plain == 1) > np.sum(case.edges == 1)):
            yield replace(case, spacing=(x, y, z), stretch=ones)


def fewer_boxes(case: Case, number: int, boxes: tuple[Box, ...]) -> Iterator[Case]:
    """One box around all of a level, or some of its boxes left out."""

    def with_boxes(some: tuple[Box, ...]) -> Case:
        return replace(case, levels=(*case.levels[:number], some, *case.levels[number + 1 :]))

    if len(boxes) < 2:
        return
    corners = np.array(boxes)
    around = tuple(map(int, corners[:, 0].min(axis=0))), tuple(map(int, corners[:, 1].max(axis=0)))
    yield with_boxes((around,))  # type: ignore[arg-type]
    count = len(boxes)
    width = count // 2
    while width:
        for first in range(0, count, width) if count <= 16 * width else ():
            yield with_boxes(boxes[:first] + boxes[first + width :])
        width //= 2


def fewer_cells(case: Case, axes: tuple[int, ...]) -> Iterator[Case]:
    """Half the cells along some axes, with the boxes of all levels, or a little fewer, where the boxes leave room."""
    half = tuple(max(2, round(n / 2)) if d in axes else n for d, n in enumerate(case.cells))
    if half != case.cells:
        levels = tuple(
            tuple(dict.fromkeys(halved(box, axes, case.blocking_factor, half, 2**level) for box in boxes))
            for level, boxes in enumerate(case.levels, start=1)
        )
        yield replace(case, cells=half, levels=levels)  # type: ignore[arg-type]
    less = tuple(n - 1 if d in axes else n for d, n in enumerate(case.cells))
    if min(less) >= 2:
        yield replace(case, cells=less)  # type: ignore[arg-type]


def halved(box: Box, axes: tuple[int, ...], blocking: int, cells: tuple[int, ...], refinement: int) -> Box:
    """A box of half the size in a domain of half the size, at least a block; the last one may be shorter."""
    lower, upper = list(box[0]), list(box[1])
    for d in axes:
        lower[d] = lower[d] // 2 // blocking * blocking
        end = max((upper[d] + 1) // 2 // blocking * blocking, lower[d] + blocking)
        upper[d] = min(end, cells[d] * refinement) - 1
    return (lower[0], lower[1], lower[2]), (upper[0], upper[1], upper[2])

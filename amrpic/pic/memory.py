"""How much memory a run takes at its peak, counted from the layout of what it holds.

What is counted is what a whole run holds at once; the few numbers that were measured say so.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from ..io.writer_ranks import Writers, buffer_bytes, group_of
from ..mesh.boxes import Array, cells_of, rows_of, table_of
from ..mesh.raster import pixels_of
from ..scene.bunches import LatticeBunch, Train
from ..scene.refinement_rules import CallableRule, FieldStrengthRule, every_rule
from ..scene.scene import Scene

MIB = 2**20
PROCESS = 150 * MIB  # measured: interpreter, NumPy, SciPy, pydantic, HDF5, Open MPI and Trilinos
MESSAGES = 20 * MIB  # measured: buffers of a process that has others to talk to
QUIET = 44 * MIB  # measured: SciPy's quasi-random numbers in a process
DRAWING = 55 * MIB  # measured: matplotlib and a picture, on rank 0

ROW, ENTRY, NUMBER = 8, 12, 8  # bytes: start of a row, its column and value, a number of a field
IDLE = 0.25  # of the fields, measured: what the solver and a regrid hold for a while, and ends of large pages
NEIGHBOURS, CHILDREN, AXES = 7, 8, 3
BOTTOM = 64  # cells of a multigrid level that is not coarsened further
LAPLACIAN = ROW + NEIGHBOURS * ENTRY
PARTICLE = 7 * NUMBER  # position, momentum, id
PLACING = 1.75  # measured: what a rank holds of particles while they are placed, in its own ones

# The matrix-free backend: a correction and a right-hand side in single precision, with rows padded to whole vectors, the
# ghosts around boxes, and the coarser values around each box, those of an eighth of the cells and of those beside them; on
# each fine face at the edge of a level the lists of fits.
SWEPT, FACE_LISTS = 2 * 4 + 0.4 + 0.6, 16

# Entries that a fine face at the edge of a level adds to the Laplacian: nine coarse cells for its ghost, and a
# quarter of what its coarse cell takes instead of one neighbour, eight fine cells and as many coarse ones.
INTERFACE = 9 + (8 + 8) // 4


@dataclass(frozen=True)
class Share:
    """What one rank holds."""

    rank: int
    cells: int
    particles: int


def run_memory(scene: Scene, boxes: Sequence[Array], particles: int, ranks: int) -> dict[str, int]:
    """Return the bytes that a run takes over all ranks at its fullest, by what takes them.

    `boxes` are those of each level, coarse to fine; a mesh that follows the particles may need more later.
    """
    quiet = any(isinstance(bunch, Train) and bunch.sampling != "random" for bunch in scene.bunches)
    return {
        "processes": ranks * (PROCESS + (MESSAGES if ranks > 1 else 0) + (QUIET if quiet else 0)),
        **(_compressed_rows if scene.solver.backend == "crs" else _matrix_free)(scene, boxes),
        "fields": int((1 + IDLE) * NUMBER * _fields(scene, boxes)),
        "particles": int(particles * _particle(scene)),
        "files": _files(scene, boxes, particles, ranks),
        "pictures": DRAWING + ranks * _rasters(scene) if "pictures" in scene.output.write else 0,
    }


def rank_memory(scene: Scene, boxes: Sequence[Array], particles: int, ranks: int, held: Share) -> float:
    """Return the bytes of `run_memory` that one rank takes which holds a share of cells and particles.

    Rank 0 draws, from what each rank rasters; writers hold what is on its way into files.
    """
    parts = run_memory(scene, boxes, particles, ranks)
    group = group_of(_groups(scene, boxes, particles, ranks), held.rank)
    parts["files"] = _buffers(scene, particles, group) if held.rank == group.start else 0
    if parts["pictures"] > 0:
        parts["pictures"] = _rasters(scene) + (DRAWING if held.rank == 0 else 0)
    of_all = {"processes": 1 / ranks, "particles": held.particles / max(particles, 1), "files": 1, "pictures": 1}
    cells = held.cells / max(sum(int(cells_of(level).sum()) for level in boxes), 1)
    return sum(size * of_all.get(what, cells) for what, size in parts.items())


def placing_bytes(scene: Scene) -> float:
    """Return the bytes that a rank takes for each of its particles while they are made and brought to their servers."""
    return PLACING * (PARTICLE + (0 if _equal_weights(scene) else NUMBER))


def _files(scene: Scene, boxes: Sequence[Array], particles: int, ranks: int) -> int:
    """Return the bytes of what is on its way into files."""
    return sum(_buffers(scene, particles, group) for group in _groups(scene, boxes, particles, ranks))


def _groups(scene: Scene, boxes: Sequence[Array], particles: int, ranks: int) -> list[range]:
    """Return the groups of ranks that write the largest file together; the first of each writes."""
    largest = NUMBER * max((2 + AXES) * sum(int(cells_of(level).sum()) for level in boxes), 9 * particles)
    return Writers(scene.output.writers, scene.output.part_bytes).groups(ranks, largest)


def _buffers(scene: Scene, particles: int, group: range) -> int:
    """Return the bytes that the writer of a group holds of what is on its way."""
    merges = bool({"particles", "losses"} & set(scene.output.write)) and particles > 0
    return buffer_bytes(len(group), merges)


def _rasters(scene: Scene) -> int:
    """Return the bytes of a picture on each rank: its share of it, and the sum of all."""
    cells = np.array(scene.domain.cells) * 2**scene.refinement.levels
    return 2 * NUMBER * max(math.prod(pixels_of(np.delete(cells, axis))) for axis in range(AXES))


def _compressed_rows(scene: Scene, boxes: Sequence[Array]) -> dict[str, int]:
    """Return the bytes of the backend of compressed rows, which has lists and vectors of the matrix-free one as well."""
    cells = [int(cells_of(level).sum()) for level in boxes]
    copied, weights, copies = _all_copies(scene, boxes)
    operators = sum(_operators(scene, *level) for level in _cycle(scene, cells))
    operators += copies * (LAPLACIAN + ROW) + copied * ENTRY  # with restriction
    total = sum(cells)
    vectors = (total + sum(cells_below(scene))) * (3 * NUMBER + 1 + _smoother(scene)) + total * NUMBER
    of_copies = copies * (3 * NUMBER + _smoother(scene)) + copied * (NUMBER + ROW) + weights * ENTRY
    return {
        "operators": operators + INTERFACE * ENTRY * _faces(scene, boxes),
        "multigrid": vectors + of_copies,
        **_matrix_free(scene, boxes),
    }


def _matrix_free(scene: Scene, boxes: Sequence[Array]) -> dict[str, int]:
    """Return the bytes of the matrix-free backend."""
    swept = sum(int(cells_of(level).sum()) for level in boxes) + sum(cells_below(scene)) + _all_copies(scene, boxes)[2]
    return {"solver": int(SWEPT * swept + FACE_LISTS * _faces(scene, boxes))}


def _faces(scene: Scene, boxes: Sequence[Array]) -> int:
    """Return the number of faces at the edges of refinement levels."""
    return sum(table_of(level).outer_faces for level in boxes[1:])


def _all_copies(scene: Scene, boxes: Sequence[Array]) -> tuple[int, int, int]:
    """Return the sums over all levels of what `_copies` returns of one."""
    copied, weights, copies = zip(*(_copies(scene, n, level) for n, level in enumerate(boxes)), strict=True)
    return sum(copied), sum(weights), sum(copies)


def _cycle(scene: Scene, cells: Sequence[int]) -> Iterator[tuple[int, int, int, int]]:
    """Yield of each level of the cycle its cells, the parents of each, how many of them the next finer level covers, and the
    cells of that level. `cells` are those of the base and the refinement levels.
    """
    below = cells_below(scene)
    parents = [fine // coarse for fine, coarse in itertools.pairwise([cells[0], *below])] + [0]
    for level, finer in enumerate([*cells[1:], 0]):
        yield cells[level], CHILDREN if level > 0 else parents[0], finer // CHILDREN, finer
    for n, above, finer in zip(below, parents[1:], [cells[0], *below[:-1]], strict=True):
        yield n, above, n, finer


def _operators(scene: Scene, cells: int, parents: int, covered: int, children: int) -> int:
    """Return the bytes of the operators of a level but that of E, away from its edges; see `_cycle` for the numbers."""
    if scene.solver.prolongation != "trilinear":
        parents = min(parents, 1)
    coarser = cells * (2 * ROW + parents * ENTRY)  # coarse_boundary, prolongation
    if covered == 0:
        return cells * LAPLACIAN + coarser
    composite = cells * ROW + (cells - covered) * NEIGHBOURS * ENTRY
    finer = cells * 2 * ROW + children * ENTRY  # fine_boundary, restriction
    return cells * LAPLACIAN + coarser + composite + finer


def _widths(scene: Scene, level: int) -> Array:
    """Return the cell widths of a level in the coordinates of the solver, (3,)."""
    return scene.domain.value.spacing * np.array(scene.solver.stretch) / 2**level


def cells_below(scene: Scene) -> list[int]:
    """Return the cells of the multigrid levels under the base, fine to coarse: half as many along axes of small spacing."""
    cells, h = np.array(scene.domain.cells), _widths(scene, 0)
    most = np.inf if scene.solver.coarse_levels is None else scene.solver.coarse_levels
    out: list[int] = []
    while len(out) < most and cells.prod() > BOTTOM:
        short = (cells > 2) & (h <= 1.5 * h[cells > 2].min())
        cells, h = np.where(short, (cells + 1) // 2, cells), np.where(short, 2 * h, h)
        out.append(int(cells.prod()))
    return out


def _copies(scene: Scene, level: int, boxes: Array) -> tuple[int, int, int]:
    """Return the cells of a level that is coarsened by itself and of its copies but the last, the weights with which they
    take the corrections of the next, and the cells of all copies; zeros where cells are near cubes.
    """
    copied = weights = copies = 0
    h, period = _widths(scene, level), np.array(scene.domain.cells) * 2**level
    while level > 0 and h.max() > 2.01 * (least := h[period > 2].min(initial=np.inf)):
        ratio = np.where((h <= 1.5 * least) & (period > 2), 2, 1)
        here = int(cells_of(boxes).sum())
        copied += here
        weights += here * int(ratio.prod())
        boxes = boxes // np.tile(ratio, 2)
        copies += int(cells_of(boxes).sum())
        h, period = h * ratio, (period + ratio - 1) // ratio
    return copied, weights, copies


def _smoother(scene: Scene) -> int:
    """Bytes per cell of the smoother: colours, or what Ifpack2 holds, vectors of its own."""
    return 4 if scene.solver.smoother == "red-black" else 6 * NUMBER


def _fields(scene: Scene, boxes: Sequence[Array]) -> int:
    """Numbers in the fields that live at the same time."""
    total = sum(int(cells_of(level).sum()) for level in boxes)
    components = AXES * total
    state = 2 * total + AXES * _boundary_cells(
        scene, boxes
    )  # charge density and potential; field in the boundary cells of boxes
    if scene.schedule.last_step == 0:
        return state + max(components, total)  # to be written; what stands for all of them before the first solve
    if scene.extrapolates_potential:
        state += total  # the potential before, and once more what both lead to
    if not scene.refinement.follows:
        return max(2 * state, state + components)  # the step before; what is written
    field_decides = any(
        isinstance(rule, FieldStrengthRule) or (isinstance(rule, CallableRule) and "efield" in rule.arguments)
        for _, rule in every_rule(scene.refinement.rule)
    )
    carried = total + (2 * components if field_decides else 0)  # potential; field, as it was and as it is carried over
    return max(2 * state + carried, state + components)


def _boundary_cells(scene: Scene, boxes: Sequence[Array]) -> int:
    """Boundary cells of boxes, as they are cut for the run, and all cells of boxes that a finer level covers a part of."""
    total = 0
    for level, finer in itertools.zip_longest(boxes, boxes[1:]):
        sizes = level[:, 3:] - level[:, :3] + 1
        parts = -(-sizes // scene.refinement.max_grid_size)
        inside = np.prod(np.maximum(sizes / parts - 2, 0) * parts, axis=1)
        if finer is not None:
            inside[table_of(finer // 2).meets(rows_of(level)) != 0] = 0
        total += int((cells_of(level) - inside).sum())
    return total


def _particle(scene: Scene) -> float:
    """Bytes per particle in the arrays that live at the same time."""
    each = PARTICLE + (0 if _equal_weights(scene) else NUMBER)
    if scene.schedule.last_step == 0:
        return placing_bytes(scene)
    if scene.motion.follows_fields:
        # before and after a step; where they are next, before and after
        return 2 * each + 4 * 3 * NUMBER
    # walked, sorted anew, and the memory that this leaves to the next arrays
    return 5 * each


def _equal_weights(scene: Scene) -> bool:
    """Whether all particles are known to stand for equally many real ones, which takes no memory."""
    made = [bunch for bunch in scene.bunches if isinstance(bunch, Train | LatticeBunch) and bunch.number > 0]
    weights = {bunch.species.weight(bunch.bunch_charge, bunch.number) for bunch in made}
    return len(made) == len(scene.bunches) and len(weights) <= 1


def base_boxes(scene: Scene) -> list[Array]:
    """Return the base level alone, as one box."""
    return [np.array([[0, 0, 0, *(n - 1 for n in scene.domain.cells)]])]

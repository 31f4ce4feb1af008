"""How much memory a run takes: the bytes of what it holds at its fullest, as its structures are laid out.

What is counted is what a whole run holds at once; the few numbers that were measured say so.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from .boxes import Array, cells_of, outer_faces
from .bunches import Train
from .scene import Leapfrog, Scene

MIB = 2**20
PROCESS = 134 * MIB  # measured: interpreter, NumPy, SciPy, pydantic, HDF5, Open MPI and Trilinos
MESSAGES = 20 * MIB  # measured: buffers of a process that has others to talk to
QUIET = 44 * MIB  # measured: SciPy's quasi-random numbers in a process
DRAWING = 55 * MIB  # measured: matplotlib and a picture, on rank 0

ROW, ENTRY, NUMBER = 8, 12, 8  # bytes: start of a row, its column and value, a number of a field
NEIGHBOURS, CHILDREN, AXES = 7, 8, 3
PARTICLE = 8 * NUMBER  # position, momentum, weight, id

# The matrix-free backend: a correction and a right-hand side in single precision, with rows padded to whole vectors, the
# ghosts around boxes, and the coarser values around each box; on each fine face at the edge of a level the lists of fits.
VECTORS, FACE_LISTS = 2 * 4 + 0.4, 16

# Entries that a fine face at the edge of a level adds: nine coarse cells for its ghost, in the Laplacian and in E; and a
# quarter of what its coarse cell takes instead of one neighbour, eight fine cells and as many coarse ones, likewise twice.
INTERFACE = 2 * 9 + 2 * (8 + 8) // 4


def run_memory(scene: Scene, boxes: Sequence[Array], particles: int, ranks: int) -> dict[str, int]:
    """Return the bytes that a run takes over all ranks at its fullest, by what takes them.

    `boxes` are those of each level, coarse to fine; a mesh that follows the particles may need more later.
    """
    cells = [int(cells_of(level).sum()) for level in boxes]
    covered = [n // CHILDREN for n in cells[1:]] + [0]
    faces = sum(outer_faces(level, scene.refinement.blocking_factor) for level in boxes[1:])
    total = sum(cells)
    below = cells[0] // (CHILDREN - 1)  # multigrid levels under the base, each covered by the next: 1/8 + 1/64 + …
    quiet = any(isinstance(bunch, Train) and bunch.sampling != "random" for bunch in scene.bunches)
    return {
        "processes": ranks * (PROCESS + (MESSAGES if ranks > 1 else 0) + (QUIET if quiet else 0)),
        **(_compressed_rows if scene.solver.backend == "crs" else _matrix_free)(scene, cells, covered, below, faces),
        "fields": total * NUMBER * _fields(scene),
        "particles": particles * _particle(scene),
        "pictures": DRAWING if "pictures" in scene.output.write else 0,
    }


def _matrix_free(scene: Scene, cells: list[int], covered: list[int], below: int, faces: int) -> dict[str, int]:
    """Bytes of the matrix-free backend."""
    around_parents = 0.6 * (sum(cells) + below)  # an eighth of the cells, and those beside them, in single precision
    return {"solver": int(VECTORS * (sum(cells) + below) + around_parents + FACE_LISTS * faces)}


def _compressed_rows(scene: Scene, cells: list[int], covered: list[int], below: int, faces: int) -> dict[str, int]:
    """Bytes of the backend of compressed rows."""
    total, uncovered = sum(cells), sum(cells) - sum(covered)
    operators = _operators(scene, below, below) + sum(
        _operators(scene, *one) for one in zip(cells, covered, strict=True)
    )
    return {
        "operators": operators + INTERFACE * ENTRY * faces,
        "operators of E": AXES * (3 * ROW * total + 2 * ENTRY * uncovered + _of_covered(scene, cells, covered)),
        "multigrid": (total + below) * (3 * NUMBER + 1 + _smoother(scene)) + total * 2 * NUMBER,
    }


def _operators(scene: Scene, cells: int, covered: int) -> int:
    """Bytes of the operators of a level but that of E, away from its edges."""
    coarse = CHILDREN if scene.solver.prolongation == "trilinear" else 1
    laplacian = cells * (ROW + NEIGHBOURS * ENTRY)
    from_coarser = cells * (2 * ROW + coarse * ENTRY)  # coarse_boundary, prolongation
    if covered == 0:
        return laplacian + from_coarser
    composite = cells * ROW + (cells - covered) * NEIGHBOURS * ENTRY
    from_finer = cells * 2 * ROW + covered * CHILDREN * ENTRY  # fine_boundary, restriction
    return laplacian + from_coarser + composite + from_finer


def _of_covered(scene: Scene, cells: Sequence[int], covered: Sequence[int]) -> int:
    """Bytes of one axis of E in covered cells and of their list, for matched clouds; none before "auto" is settled."""
    return ROW * sum(cells[:-1]) + (2 * ENTRY + 4) * sum(covered) if scene.particles.interface == "matched" else 0


def _smoother(scene: Scene) -> int:
    """Bytes per cell of the smoother: colours, or what Ifpack2 holds, a matrix and vectors and index lists of its own."""
    return 4 if scene.solver.smoother == "red-black" else ROW + NEIGHBOURS * ENTRY + 6 * NUMBER


def _fields(scene: Scene) -> int:
    """Numbers per cell in the fields that live at the same time."""
    state = 5  # charge density, potential, field
    if scene.schedule.last_step == 0:
        return state + 2  # what energies are summed up from
    return 2 * state + (1 if scene.refinement.follows else 0)  # the step before, and its potential carried over


def _particle(scene: Scene) -> int:
    """Bytes per particle in the arrays that live at the same time."""
    if scene.schedule.last_step > 0 and isinstance(scene.motion, Leapfrog):
        # before and after a step; position and momentum on the way, the force before and after, the last momentum
        return 2 * PARTICLE + 5 * 3 * NUMBER
    return 3 * PARTICLE  # at the start: bunches, all of them together, and sorted


def base_boxes(scene: Scene) -> list[Array]:
    """Return the base level alone, as one box."""
    return [np.array([[0, 0, 0, *(n - 1 for n in scene.domain.cells)]])]

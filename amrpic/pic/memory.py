"""How much memory a run takes at its fullest: bytes for each cell, particle and process, measured on the examples.

Runs take that within a quarter; what counts is whether a machine can hold them.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ..io.writer_ranks import buffer_bytes, group_of, writers_of
from ..mesh.boxes import Array, all_cells
from ..run.machine import MIB
from ..scene.bunches import Train
from ..scene.scene import Scene

PROCESS = 150 * MIB  # interpreter, NumPy, SciPy, pydantic, HDF5, Open MPI and Trilinos
MESSAGES = 20 * MIB  # buffers of a process that has others to talk to
QUIET = 44 * MIB  # SciPy's quasi-random numbers in a process
DRAWING, RASTER = 55 * MIB, 4 * MIB  # matplotlib on rank 0, and a picture on each rank
TRACING, OUTLINES = 20 * MIB, 30 * MIB  # electrodes: their surfaces on each rank, and in pictures
SOLVER = {"matrix-free": 12, "kokkos": 12, "crs": 340}  # of a cell: operators and vectors of all multigrid levels
# Of a cell beside metal, on all levels of the cycle, and while a solver is set up.
CUT_CELL = {"matrix-free": 400, "kokkos": 700, "crs": 1200}
UNIT_SOLUTION = 8  # of a cell, for each electrode where one floats
VARYING = 32  # of a cell, for each electrode whose voltage varies: potential and field
# Of a cell and of a particle, by how these move: as they are before and after a step, and on their way.
ONE_SOLVE = 68, 100
MOVING = {"none": (80, 100), "leapfrog": (92, 215), "random-walk": (76, 280)}
WRITTEN = 40, 72  # of a cell, and a particle, in the largest file


@dataclass(frozen=True)
class Share:
    """What one rank holds."""

    rank: int
    cells: int
    particles: int


def run_memory(
    scene: Scene, boxes: Sequence[Array], particles: int, ranks: int, cut_cells: int = 0
) -> dict[str, float]:
    """Return the bytes that a run takes over all ranks at its fullest, by what takes them.

    `boxes` are those of each level, coarse to fine; a mesh that follows the particles may need more later. `cut_cells`: how
    many of them lie beside metal.
    """
    quiet = any(isinstance(bunch, Train) and bunch.sampling != "random" for bunch in scene.bunches)
    of_cell, of_particle = ONE_SOLVE if scene.schedule.last_step == 0 else MOVING[scene.motion.kind]
    cells = all_cells(boxes)
    groups = _groups(scene, cells, particles, ranks)
    floats = any(electrode.charge is not None for electrode in scene.electrodes)
    varying = sum(isinstance(electrode.voltage, str) for electrode in scene.electrodes)
    of_cell_of_metal = (UNIT_SOLUTION * len(scene.electrodes) if floats else 0) + VARYING * varying
    electrodes = ranks * TRACING + CUT_CELL[scene.solver.backend] * cut_cells + of_cell_of_metal * cells
    return {
        "processes": ranks * (PROCESS + (MESSAGES if ranks > 1 else 0) + (QUIET if quiet else 0)),
        "solver": SOLVER[scene.solver.backend] * cells,
        "fields": of_cell * cells,
        "particles": of_particle * particles,
        "files": sum(_buffers(scene, particles, group) for group in groups),
        "pictures": _drawing(scene) + ranks * RASTER if _drawing(scene) else 0,
        **({"electrodes": electrodes} if scene.electrodes else {}),
    }


def rank_memory(scene: Scene, boxes: Sequence[Array], particles: int, ranks: int, own_share: Share) -> float:
    """Return the bytes of `run_memory` that one rank takes which holds a share of cells and particles.

    Rank 0 draws, from what each rank rasters; writers hold what is on its way into files.
    """
    parts, cells = run_memory(scene, boxes, particles, ranks), all_cells(boxes)
    group = group_of(_groups(scene, cells, particles, ranks), own_share.rank)
    of_files = _buffers(scene, particles, group) if own_share.rank == group.start else 0
    of_pictures = RASTER + (_drawing(scene) if own_share.rank == 0 else 0) if parts["pictures"] else 0
    of_cells = (parts["solver"] + parts["fields"]) * own_share.cells / max(cells, 1)
    of_electrodes = parts.get("electrodes", 0) / ranks
    of_particles = parts["particles"] * own_share.particles / max(particles, 1)
    return parts["processes"] / ranks + of_cells + of_electrodes + of_particles + of_files + of_pictures


def base_boxes(scene: Scene) -> list[Array]:
    """Return the base level alone, as one box."""
    return [np.array([[0, 0, 0, *(n - 1 for n in scene.domain.cells)]])]


def _drawing(scene: Scene) -> int:
    """Return the bytes that rank 0 draws with."""
    draws = {"pictures", "report"} & set(scene.output.write)
    return DRAWING + (OUTLINES if scene.electrodes else 0) if draws else 0


def _groups(scene: Scene, cells: int, particles: int, ranks: int) -> list[range]:
    """Return the groups of ranks that write the largest file together; the first of each writes."""
    return writers_of(scene).groups(ranks, max(WRITTEN[0] * cells, WRITTEN[1] * particles))


def _buffers(scene: Scene, particles: int, group: range) -> int:
    """Return the bytes that the writer of a group holds of what is on its way."""
    merges = bool({"particles", "losses"} & set(scene.output.write)) and particles > 0
    return buffer_bytes(len(group), merges)

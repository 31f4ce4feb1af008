"""What a run of material points needs and what the machine has, compared before anything is allocated."""

from __future__ import annotations

import math

from ..errors import SceneError
from ..mpi import MPI
from ..parallel import from_rank_0
from ..run.machine import available_memory, machine_memory
from .scene import Scene

POINT_COLUMNS = 17  # of eight bytes, that a point has
PLACE_COLUMNS = 6  # its element, place in that, weight and volume
MOVED_COLUMNS = 24  # while it moves and migrates: those of the next step beside those of the last
TANGENT_COLUMNS = {"neo-hookean": 18, "ogden": 36}  # while a system is solved
OUTPUT_COLUMNS = 36  # while stresses are written
NODE_COLUMNS = 3 * 16  # vectors of Newton, conjugate gradients and the cycle, three components each
ROWS_OF_BLOCKS = 27 * 9 * 1.2  # of degree 1 and the levels below it
UNEVEN = 0.15  # part of the elements that the smoother of a higher degree solves for, where there are several materials


def memory(scene: Scene) -> dict[str, float]:
    """Return about how many bytes a run takes at its fullest, all ranks together, by what takes them."""
    degree, cells = scene.domain.degree, scene.domain.cells
    most = max(MOVED_COLUMNS, *(TANGENT_COLUMNS[section.law] for section in scene.materials.values()))
    if scene.output.write:
        most = max(most, OUTPUT_COLUMNS)
    nodes, corners = (math.prod(n * p + 1 for n in cells) for p in (degree, 1))
    uneven = UNEVEN * math.prod(cells) if degree > 1 and len(scene.materials) > 1 else 0.0
    motions = 3 * (degree + 1) ** 3
    return {
        "points": 8.0 * scene.point_count() * (POINT_COLUMNS + PLACE_COLUMNS + most),
        "vectors of nodes": 8.0 * nodes * NODE_COLUMNS,
        "multigrid": 8.0 * corners * ROWS_OF_BLOCKS + 4.0 * uneven * motions * (motions + 1) / 2,
    }


def check_scene(scene: Scene, available: float | None = None) -> None:
    """Raise SceneError if a scene's files are missing or wrong, or the machine has not enough memory. Local."""
    scene.structure.check()
    need, free = sum(memory(scene).values()), available_memory() if available is None else available
    if need > free:
        raise SceneError(
            f"{scene.name}: {scene.point_count()} points take about {need / 2**30:.3g} GiB of memory, and "
            f"{free / 2**30:.3g} GiB are free; use fewer elements or points, or more machines"
        )


def require_room(comm: MPI.Comm, scene: Scene) -> None:
    """Do the same for all ranks. Collective; SceneError on all ranks."""
    free = machine_memory(comm)
    from_rank_0(comm, lambda: check_scene(scene, free), SceneError)

"""What a run needs and what the machine has, compared before anything is allocated."""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path

from ..errors import SceneError
from ..external import ExternalFields
from ..mesh.boxes import Array, all_cells
from ..mpi import MPI
from ..parallel import global_max, global_sum, node_of, raise_together
from ..run.machine import available_memory, resident
from ..scene.domain_section import LARGEST_INDEX
from ..scene.scene import Scene
from .cut_metal import describe_scene
from .driven_electrodes import make_solids
from .memory import Share, base_boxes, rank_memory, run_memory


def memory_error(
    scene: Scene, boxes: Sequence[Array], particles: int, ranks: int, available: int, where: str = "the hierarchy"
) -> str | None:
    """Return why a run with these boxes per level does not fit into memory, None if it does."""
    need = sum(run_memory(scene, boxes, particles, ranks).values())
    if need <= available:
        return None
    return (
        f"{where}: {all_cells(boxes)} cells and {particles} particles on {ranks} ranks take about {need / 2**30:.3g} GiB of "
        f"memory, and {available / 2**30:.3g} GiB are free; use fewer cells or particles, or more machines"
    )


def rank_cells_error(cells: int, ranks: int, where: str = "domain.cells") -> str | None:
    """Return why so many cells cannot be counted in 32 bits on each rank, None if they can."""
    if cells / ranks <= LARGEST_INDEX:
        return None
    return (
        f"{where}: {cells} cells on {ranks} ranks are more per rank than the {LARGEST_INDEX} that 32 bits count; "
        f"use fewer cells, or at least {math.ceil(cells / LARGEST_INDEX)} ranks"
    )


def check_scene(scene: Scene, ranks: int, available: int | None = None) -> list[str]:
    """Return what the base level cuts of the electrodes of a scene, a line for each, and remarks on them.

    Raises SceneError if files of a scene are missing, or its base level and particles cannot be held by so many ranks, and
    InputError if the field of an element cannot be made, or electrodes touch. Refined levels are not known yet; a run looks at
    them when they are.
    """
    for number, bunch in enumerate(scene.bunches):
        if bunch.source is not None and not Path(bunch.source).exists():
            raise SceneError(
                f"{scene.name}: bunches.{number}.file ({bunch.source}) does not exist; correct the path (relative ones start "
                "at the scene file)"
            )
    ExternalFields.of_scene(scene)
    make_solids(scene)
    boxes, free = base_boxes(scene), available_memory() if available is None else available
    problem = rank_cells_error(all_cells(boxes), ranks)
    problem = problem or memory_error(scene, boxes, scene.particle_count(), ranks, free, "domain.cells")
    if problem is not None:
        raise SceneError(f"{scene.name}: {problem}")
    return describe_scene(scene)


def require_room(
    comm: MPI.Comm, scene: Scene, boxes: Sequence[Array], particles: int, where: str, own_share: Share | None = None
) -> None:
    """Raise SceneError on all ranks if a rank's machine cannot hold what its ranks will. Collective.

    `boxes` are those of each level, `particles` those of all ranks; `own_share` is this rank's part of them, an equal share
    if nothing is known. The message names the rank that needs most where memory falls short.
    """
    if own_share is None:
        own_share = Share(comm.rank, math.ceil(all_cells(boxes) / comm.size), math.ceil(particles / comm.size))
    node, need = node_of(comm), rank_memory(scene, boxes, particles, comm.size, own_share)
    free = available_memory() if node.rank == 0 else 0
    needs, room = (global_sum(node, value) for value in (need, free + resident()))
    problem = rank_cells_error(all_cells(boxes), comm.size, where)
    if problem is None and needs > room and need == global_max(node, need):
        problem = (
            f"{where}: rank {comm.rank} takes about {need / 2**30:.3g} GiB of memory for {own_share.cells} cells and "
            f"{own_share.particles} particles; the {node.size} ranks of its machine take {needs / 2**30:.3g} GiB, of which "
            f"{room / 2**30:.3g} GiB are free; use more machines, or fewer cells or particles"
        )
    raise_together(comm, None if problem is None else f"{scene.name}: {problem}", SceneError)

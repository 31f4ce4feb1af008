"""What a scene of material points is made of, before it is run: structure, points per element, memory, pictures."""

from __future__ import annotations

import math

import numpy as np

from ..io import vtkhdf_writer
from ..io.field_reader import LiveDump
from ..io.provenance import about
from ..io.writer_ranks import writers_of
from ..mpi import MPI
from ..parallel import global_max
from ..run.folder import prepare
from ..run.machine import MIB, machine_memory
from ..scene.any_scene import AnyScene
from ..units import quantity
from ..view.draw import draw
from ..view.views import View
from .means import element_means
from .room import memory, require_room
from .rows import loose_weights
from .scene import Scene
from .state import LoadState, Plan
from .step import begin

FILE = "preview.vtkhdf"


def preview(comm: MPI.Comm, scene: AnyScene) -> str:
    """Return the text of a preview; pictures go into the folder of the scene's run. Nothing is solved. Collective.

    Raises what making points may raise, and OutputError.
    """
    assert isinstance(scene, Scene)
    prepare(comm, scene)
    require_room(comm, scene)
    plan = Plan(comm, scene)
    state = begin(plan)
    paragraphs = [
        [scene.summary()],
        _structure(plan, state),
        _elements(plan, state),
        _memory(plan),
        [f"note: {remark}" for remark in [*scene.remarks(), *loose_weights(state.placed)]],
        _pictures(plan, state),
    ]
    return "\n\n".join("\n".join(lines) for lines in paragraphs if lines)


def _structure(plan: Plan, state: LoadState) -> list[str]:
    """Return what there is of each material."""
    points, names = state.placed.points, list(plan.scene.materials)
    count = np.bincount(points.material, minlength=len(names))
    volume = np.bincount(points.material, points.initial_volume, len(names))
    sums = plan.comm.allreduce(np.stack([count, volume, volume * plan.densities]))
    lower, upper = plan.scene.extent(0.0)
    whole = math.prod(upper - lower)
    return [
        f"{name}: {int(n)} points, {100 * v / whole:.3g} % of the domain, {quantity(1e3 * m, 'g')}"
        for name, n, v, m in zip(names, *sums, strict=True)
    ]


def _elements(plan: Plan, state: LoadState) -> list[str]:
    """Return how many points elements have, and to what degree their weights are exact."""
    placed, comm, counts = state.placed, plan.comm, state.placed.weighed.held
    least, most = comm.allreduce(int(counts.min(initial=2**31)), MPI.MIN), int(global_max(comm, counts.max(initial=0)))
    exact = ", ".join(
        f"{count} to degree {m}" if m >= 0 else f"{count} not at all" for m, count in placed.weighed.exactness().items()
    )
    floor = comm.allreduce(len(placed.solid.points) - len(placed.points))
    of_floor = [f"the floor stiffness adds {floor} points where these are too few"] if floor else []
    return [f"points of an element: {least} to {most}; elements whose weights are exact: {exact}", *of_floor]


def _memory(plan: Plan) -> list[str]:
    parts = memory(plan.scene)
    return [
        f"memory of a run: about {sum(parts.values()) / MIB:.0f} MiB at its fullest; {machine_memory(plan.comm) / MIB:.0f} MiB "
        "are free here",
        *(f"  {name}: {size / MIB:.0f} MiB" for name, size in parts.items()),
    ]


def _pictures(plan: Plan, state: LoadState) -> list[str]:
    """Write the structure as a field file, draw it, and return the paths. Collective."""
    scene, hierarchy = plan.scene, state.placed.mesh.hierarchy
    path, means = scene.directory / FILE, element_means(state, scene)
    vtkhdf_writer.write(path, hierarchy, means, state.moment, about(scene), writers_of(scene))
    dump = LiveDump(path, hierarchy, means, state.moment, about(scene).scene_text)
    return list(map(str, [path, *draw(dump, path.parent, [View("material", axis=axis) for axis in range(3)])]))

"""A state of material points into a checkpoint, and back out of it on any number of ranks."""

from __future__ import annotations

from pathlib import Path

from ..errors import InputError
from ..io.checkpoint import Header, Snapshot, read, read_contents
from ..io.provenance import about
from ..mpi import MPI
from ..scene.differences import differences, require_same
from .scene import Scene
from .state import LoadState, Plan
from .step import put

FIXED = ("domain", "faces", "materials")  # parts of a scene that a restart must keep; of materials the names


def snapshot(state: LoadState, plan: Plan) -> Snapshot:
    """Return the whole state as a checkpoint takes it: arrays shared, not copied."""
    hierarchy, scene = state.placed.mesh.hierarchy, plan.scene
    header = Header(
        step=state.step,
        time=state.load,
        domain=scene.domain.model_dump(mode="json"),
        boxes=[hierarchy.boxes(0)],
        owners=[hierarchy.owners(0)],
        about=about(scene),
        extra={
            "begin": state.loads.begin,
            "length": state.loads.length,
            "measured": dict(state.measured),
        },
    )
    return Snapshot(header, tables={"points": state.placed.points.columns()})


def load(comm: MPI.Comm, path: Path, scene: Scene | None = None) -> tuple[LoadState, Plan]:
    """Return the state that a checkpoint holds, and what its steps need. Collective; InputError on all ranks.

    `scene` may take the place of the checkpoint's if its domain, faces and names of materials are the same. On as many ranks
    as wrote it, steps go on bit by bit as they would have.
    """
    contents = read_contents(comm, path)
    header, made_by = contents.header, contents.header.about.scene
    if made_by.get("method") != "mpm":
        raise InputError(
            f"checkpoint {path} is of a particle-in-cell run; go on from it by such a scene, or start afresh"
        )
    scene = scene if scene is not None else Scene.from_dict(made_by, source=f"the scene in {path}")
    now, before = ({**data, "materials": list(data["materials"])} for data in (scene.to_dict(), made_by))
    require_same(scene.name, path, (change for part in FIXED for change in differences(now[part], before[part], part)))
    plan = Plan(comm, scene)
    stored, extra = read(comm, path, contents=contents), header.extra
    loads = scene.schedule.loads(extra["begin"], extra["length"])
    points, _ = put(dict(stored.tables["points"]), plan, loads.begin)
    return LoadState(header.step, loads, points, extra["measured"]), plan

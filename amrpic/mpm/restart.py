"""A state of material points into a checkpoint, and back out of it on any number of ranks."""

from __future__ import annotations

from pathlib import Path

from mpi4py import MPI

from ..errors import InputError
from ..io.checkpoint_manifest import Header
from ..io.checkpoint_reader import read, read_manifest
from ..io.checkpoint_writer import Snapshot
from ..io.provenance import about
from ..scene.differences import differences, require_same
from .scene import Scene
from .state import Plan, State
from .step import put

FIXED = ("domain", "faces", "materials")  # parts of a scene that a restart must keep; of materials the names


def snapshot(state: State, plan: Plan) -> Snapshot:
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
            "materials": list(scene.materials),  # in their order, which the scene in a manifest has lost
            "begin": state.loads.begin,
            "length": state.loads.length,
            "measured": dict(state.measured),
        },
    )
    return Snapshot(header, tables={"points": state.placed.points.columns()})


def load(comm: MPI.Comm, path: Path, scene: Scene | None = None) -> tuple[State, Plan]:
    """Return the state that a checkpoint holds, and what its steps need. Collective; InputError on all ranks.

    `scene` may take the place of the checkpoint's if its domain, faces and names of materials are the same. On as many ranks
    as wrote it, steps go on bit by bit as they would have.
    """
    manifest = read_manifest(comm, path)
    header, made_by = manifest.header, manifest.header.about.scene
    if made_by.get("method") != "mpm":
        raise InputError(
            f"checkpoint {path} is of a particle-in-cell run; go on from it by such a scene, or start afresh"
        )
    materials = header.extra["materials"]
    made_by = {**made_by, "materials": {name: made_by["materials"][name] for name in materials}}
    scene = scene if scene is not None else Scene.from_dict(made_by, source=f"the scene in {path}")
    now = {**scene.to_dict(), "materials": list(scene.materials)}
    before = {**made_by, "materials": materials}
    require_same(scene.name, path, (one for part in FIXED for one in differences(now[part], before[part], part)))
    plan = Plan(comm, scene)
    held, extra = read(comm, path, manifest=manifest), header.extra
    loads = scene.schedule.loads(extra["begin"], extra["length"])
    there, _ = put(dict(held.tables["points"]), plan, loads.begin)
    measured = extra["measured"] if "measured" in extra else extra["totals"]  # of earlier versions: work alone
    return State(header.step, loads, there, measured), plan

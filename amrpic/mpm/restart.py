"""A state of material points into a checkpoint, and back out of it on any number of ranks."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from mpi4py import MPI

from ..errors import InputError
from ..io.checkpoint_manifest import Header
from ..io.checkpoint_reader import read, read_manifest
from ..io.checkpoint_writer import Snapshot
from ..run.restart import about
from ..scene.differences import differences
from .scene import Scene
from .state import Plan, State
from .step import put

FIXED = ("domain", "faces")  # parts of a scene that a restart must keep


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
            "totals": dict(state.totals),
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
    made_by = {**made_by, "materials": {name: made_by["materials"][name] for name in header.extra["materials"]}}
    scene = scene if scene is not None else Scene.from_dict(made_by, source=f"the scene in {path}")
    _require_same(scene, made_by, path)
    plan = Plan(comm, scene)
    held, extra = read(comm, path, manifest=manifest), header.extra
    loads = scene.schedule.loads(extra["begin"], extra["length"])
    there, _ = put(dict(held.tables["points"]), plan, loads.begin)
    return State(header.step, loads, there, extra["totals"]), plan


def _require_same(scene: Scene, made_by: Mapping[str, Any], path: Path) -> None:
    """Raise InputError unless a scene has the domain, faces and materials of a checkpoint."""
    now, before = scene.to_dict(), made_by
    changed = [one for part in FIXED for one in differences(now[part], before[part], part)]
    names = list(now["materials"]), list(before["materials"])
    if names[0] != names[1]:
        changed.append(("the list of materials", *names))
    if changed:
        key, value, was = changed[0]
        raise InputError(
            f"{scene.name} cannot go on from checkpoint {path}: {key} is {value} instead of {was}; restore that, or start "
            "afresh in another folder"
        )

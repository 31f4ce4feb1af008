"""The methods that scenes are run by. Only what a scene asks for is imported."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from ..errors import SceneError
from ..mpi import MPI
from ..pic import limits
from ..pic.cut_metal import describe_scene
from ..pic.simulation import Simulation
from ..run.life import Run
from ..scene.any_scene import AnyScene
from ..scene.scene import Scene

MPM = "mpm"


def scene_from(data: dict[str, Any], path: str | Path) -> AnyScene:
    """Return the scene of what a file holds, of its method: particle-in-cell if it names none. Raises SceneError."""
    if "method" not in data:
        return Scene.from_data(data, path)
    if data["method"] != MPM:
        raise SceneError(
            f'{path}: method ({data["method"]!r}) is not one of the choices; use "{MPM}", or leave it out for particle-in-cell'
        )
    from ..mpm.scene import Scene as OfPoints

    return OfPoints.from_data(data, path)


def simulation_of(comm: MPI.Comm, scene: AnyScene, checkpoint: str | Path | None = None) -> Run[Any]:
    """Return the run of a scene at its start, or at a checkpoint. Collective; raises what these raise."""
    if isinstance(scene, Scene):
        return Simulation(comm, scene) if checkpoint is None else Simulation.restart(comm, checkpoint, scene)
    from ..mpm.scene import Scene as PointsScene
    from ..mpm.simulation import Simulation as OfPoints

    assert isinstance(scene, PointsScene)
    return OfPoints(comm, scene) if checkpoint is None else OfPoints.restart(comm, checkpoint, scene)


def check_scene(scene: AnyScene, ranks: int) -> None:
    """Raise SceneError if files of a scene are missing, or the machine cannot hold it."""
    if isinstance(scene, Scene):
        return limits.check_scene(scene, ranks)
    from ..mpm.room import check_scene as check_points
    from ..mpm.scene import Scene as PointsScene

    assert isinstance(scene, PointsScene)
    check_points(scene)


def metal_of(scene: AnyScene) -> list[str]:
    """Return what the base level cuts of the electrodes of a scene, a line for each. Raises InputError."""
    return describe_scene(scene) if isinstance(scene, Scene) else []


def scene_of_method(method: str | None) -> tuple[type[AnyScene], str]:
    """Return what scenes of a method are made of, particle-in-cell for None, and the title of their reference."""
    if method is None:
        return Scene, "Scene reference"
    from ..mpm.scene import Scene as PointsScene

    return PointsScene, "Scene reference of material points"


def preview_points(comm: MPI.Comm, scene: AnyScene) -> str:
    """Return the text of a preview of material points; pictures go into the folder of the scene's run. Collective."""
    from ..mpm.point_preview import preview
    from ..mpm.scene import Scene as PointsScene

    assert isinstance(scene, PointsScene)
    return preview(comm, scene)

"""The methods that scenes are run by. Only what a scene asks for is imported."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from ..errors import SceneError
from ..mpi import MPI
from ..pic import limits
from ..pic.simulation import Simulation
from ..run.life import Run
from ..scene.any_scene import AnyScene
from ..scene.scene import Scene

MPM = "mpm"


@dataclass(frozen=True)
class Method:
    """What commands need of a method."""

    scene: type[AnyScene]
    title: str  # of the reference of its keys
    simulation: Any
    check: Callable[[Any, int], list[str]]  # `check_scene`


def method_named(name: str | None) -> Method:
    """Return a method by its name in scenes: particle-in-cell for None."""
    if name is None:
        return Method(Scene, "Scene reference", Simulation, limits.check_scene)
    from ..mpm import Scene as SceneOfPoints
    from ..mpm import Simulation as OfPoints
    from ..mpm.room import check_scene

    def check(scene: SceneOfPoints, _: int) -> list[str]:
        check_scene(scene)
        return []

    return Method(SceneOfPoints, "Scene reference of material points", OfPoints, check)


def method_of(scene: AnyScene) -> Method:
    """Return the method of a scene."""
    return method_named(None if isinstance(scene, Scene) else MPM)


def scene_from(data: dict[str, Any], path: str | Path) -> AnyScene:
    """Return the scene of what a file holds, of its method: particle-in-cell if it names none. Raises SceneError."""
    if data.get("method", MPM) != MPM:
        raise SceneError(
            f'{path}: method ({data["method"]!r}) is not one of the choices; use "{MPM}", or leave it out for particle-in-cell'
        )
    return method_named(data.get("method")).scene.from_data(data, path)


def simulation_of(comm: MPI.Comm, scene: AnyScene, checkpoint: str | Path | None = None) -> Run[Any]:
    """Return the run of a scene at its start, or at a checkpoint. Collective; raises what these raise."""
    simulation = method_of(scene).simulation
    return simulation(comm, scene) if checkpoint is None else simulation.restart(comm, checkpoint, scene)

"""What every output says about the run that made it, and of which moment of it it is."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass, field
from importlib.metadata import version
from typing import Any

from ..mesh.window import AT_REST, Window
from ..scene.any_scene import AnyScene


@dataclass(frozen=True)
class Moment:
    """The moment of a run that a file shows."""

    step: int
    time: float  # s, or the part of the load
    window: Window = AT_REST  # where the mesh is


@dataclass(frozen=True)
class Provenance:
    """The resolved scene, the version of the package and the seed: enough to make the output again."""

    scene: Mapping[str, Any] = field(default_factory=dict)
    version: str = ""
    seed: int = 0

    @property
    def scene_text(self) -> str:
        """The scene as JSON in one line, in its order: that of materials is the order of their numbers."""
        return json.dumps(self.scene)


def about(scene: AnyScene) -> Provenance:
    """Return what every output says about the run of a scene."""
    return Provenance(scene.to_dict(), version("amrpic"), scene.seed)

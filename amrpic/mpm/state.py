"""What a run of material points hands from step to step, and what its steps take."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from ..io.provenance import Moment
from ..mpi import MPI
from ..parallel import own
from ..run.clock import Clock
from .loads import Loads
from .material_points import PlacedPoints
from .materials import Material
from .scene import Scene


class Plan:
    """What steps need that does not change with them. Collective to make."""

    def __init__(self, comm: MPI.Comm, scene: Scene) -> None:
        self.comm, self.scene = own(comm), scene
        self.materials: list[Material] = [section.value for section in scene.materials.values()]
        self.densities = [section.density for section in scene.materials.values()]
        self.clock = Clock()


@dataclass(frozen=True, eq=False)
class LoadState:
    """Points in a mesh without displacement, after some load steps."""

    step: int
    loads: Loads  # how far the load is, and what follows
    placed: PlacedPoints
    measured: Mapping[str, float]  # what the series says of the step that led here

    @property
    def moment(self) -> Moment:
        """Step and load, as files have them."""
        return Moment(self.step, self.load)

    @property
    def load(self) -> float:
        """The part of the load that is on."""
        return self.loads.begin

"""The walls of a scene that emit: the field at them, of all that makes one."""

from __future__ import annotations

from ..mesh.columns import Columns
from ..mesh.hierarchy import Hierarchy
from ..particles.frame import LABORATORY
from ..particles.particles import Particles
from ..particles.wall_response import WallResponse
from ..scene.scene import Scene
from ..stages.wall_layer import NormalField, WallLayer, of_component, of_potential
from .solution import Solution

LEFT = 0.25  # of a cell by which a wall may be off the face of the mesh: the window has not left it behind


class EmittingWalls:
    """The Dirichlet faces of a scene with sources; keeps the columns of cells at them as long as their mesh."""

    def __init__(self, scene: Scene) -> None:
        boundary = [kind for pair in scene.domain.value.boundary for kind in pair]
        faces = {source.face_number for source in scene.sources}
        self.faces = sorted(face for face in faces if face is not None and boundary[face] == "dirichlet")
        self._potential = scene.domain.wall_functions()[0]
        self._rimmed = {source.face_number for source in scene.sources if getattr(source, "spot", None) is not None}
        self._shape = scene.particles.clouds.shape
        self._columns: dict[int, Columns] = {}
        self._responses: dict[int, WallResponse] = {}

    def layers(self, solution: Solution, particles: Particles) -> dict[int, WallLayer]:
        """Return the layers at the faces, by their numbers, with what was solved for and its particles in them. Collective."""
        return {
            face: WallLayer.of(columns, self._field(columns, solution), particles, self._responses.get(face))
            for face in self.faces
            if (columns := self._on(solution.rho.hierarchy, face)) and not _is_left(columns, solution)
        }

    def _on(self, hierarchy: Hierarchy, face: int) -> Columns:
        columns = self._columns.get(face)
        if columns is None or columns.hierarchy is not hierarchy:
            self._columns[face] = columns = Columns(hierarchy, face)
            if face in self._rimmed:
                self._responses[face] = WallResponse(columns, self._shape)
        return columns

    def _field(self, columns: Columns, solution: Solution) -> NormalField:
        """Return the normal field of all. Collective.

        At the wall it is exact for what is solved for with the wall as a face of the mesh: charge at rest in the laboratory,
        and what walls hold. The field of fast charge and of its images is extrapolated to the wall.
        """
        frames, parts = solution.frames, solution.parts or (solution.phi,)
        alone = frames.only == LABORATORY and frames.mirror_of(LABORATORY) is None
        if alone:
            return of_potential(columns, solution.phi, self._potential)
        at_rest = [
            n for n, frame in enumerate(frames.members) if frame == LABORATORY and frames.mirror_of(frame) is None
        ]
        exact = [of_potential(columns, parts[n], None) for n in at_rest]
        if solution.walls is not None:
            exact.append(of_potential(columns, solution.walls[0], self._potential))
        out = of_component(columns, solution.electric.components[columns.axis])
        for field in exact:
            out = out.with_exact(field)
        return out


def _is_left(columns: Columns, solution: Solution) -> bool:
    """Whether the window has left a wall behind, so that it is no face of the mesh any more."""
    mirror, axis = solution.frames.mirror, columns.axis
    if not solution.frames.leaves or mirror is None or mirror.axis != axis:
        return False
    plane = mirror.planes[columns.side]
    domain = columns.hierarchy.domain
    face = (domain.lower, domain.upper)[columns.side][axis]
    return plane is None or abs(plane.place - face) > LEFT * domain.spacing[axis]

"""The walls of a scene that emit: the field at them, of all that makes one."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ..conductors.patches import Patches
from ..errors import InputError
from ..mesh.columns import Columns
from ..mesh.domain import Domain
from ..mesh.hierarchy import Hierarchy
from ..particles.frame import LABORATORY
from ..particles.particles import Particles
from ..particles.wall_response import WallResponse
from ..scene.electrodes import Electrode
from ..scene.scene import Scene
from ..shapes import Shape
from ..shapes.scatter import Scatter, scattered
from .metal_layer import MetalLayer
from .solution import Solution
from .wall_layer import NormalField, WallLayer, along_wall, of_component, of_potential

PER_WIDTH = 6  # lines across a cell by which surfaces of electrodes are found
LEFT = 0.25  # of a cell by which a wall may be off the face of the mesh: the window has not left it behind


class EmittingWalls:
    """The Dirichlet faces and electrodes of a scene with sources; keeps the columns at them as long as their mesh."""

    def __init__(self, scene: Scene, electrodes: Sequence[Electrode] = ()) -> None:
        boundary = [kind for pair in scene.domain.value.boundary for kind in pair]
        faces = {source.face_number for source in scene.sources}
        self.faces = sorted(face for face in faces if face is not None and boundary[face] == "dirichlet")
        self._potential = scene.domain.wall_functions()[0]
        self._rimmed = {source.face_number for source in scene.sources if getattr(source, "spot", None) is not None}
        self._shape = scene.particles.clouds.shape
        self._columns: dict[int, Columns] = {}
        self._responses: dict[int, WallResponse] = {}
        names = {source.surface for source in scene.sources}
        self._metal = {electrode.name: electrode.shape for electrode in electrodes if electrode.name in names}
        self._scatters: dict[tuple[str, int], Scatter] = {}
        self._patches: dict[str, Patches] = {}
        self._mesh: Hierarchy | None = None  # of the patches

    def __bool__(self) -> bool:
        return bool(self.faces or self._metal)

    def layers(self, solution: Solution, particles: Particles) -> dict[int | str, WallLayer | MetalLayer]:
        """Return the layers at the faces, by their numbers, and at electrodes, by their names, with what was solved for and its
        particles in them. Collective.
        """
        hierarchy = solution.rho.hierarchy
        potential = solution.potential if solution.frames.only == LABORATORY else None
        of_metal = {
            name: MetalLayer.of(self._in_front(hierarchy, name), potential, solution.electric, particles)
            for name in self._metal
        }
        return of_metal | {
            face: WallLayer.of(
                columns,
                self._field(columns, solution),
                along_wall(columns, self._potential),
                solution.electric,
                particles,
                self._responses.get(face),
            )
            for face in self.faces
            if (columns := self._on(hierarchy, face)) and not _is_left(columns, solution)
        }

    def _in_front(self, hierarchy: Hierarchy, name: str) -> Patches:
        """Return the patches of an electrode, as wide as the finest cells that are all around it. Raises InputError."""
        if self._mesh is not hierarchy:
            self._mesh, self._patches = hierarchy, {}
        if name not in self._patches:
            level, points = 0, self._points(hierarchy, name, 0)
            while level + 1 < hierarchy.levels and _covers(hierarchy, level + 1, points.place):
                level, points = level + 1, self._points(hierarchy, name, level + 1)
            self._patches[name] = Patches(self._metal[name], points, float(hierarchy.spacing(level).max()))
        return self._patches[name]

    def _points(self, hierarchy: Hierarchy, name: str, level: int) -> Scatter:
        """Return points of an electrode's surface for cells of a level: the same whatever the mesh was before."""
        if (name, level) not in self._scatters:
            width = float(hierarchy.spacing(level).min())
            self._scatters[name, level] = of_electrode(name, self._metal[name], hierarchy.domain, width)
        return self._scatters[name, level]

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
        if alone:  # with what electrodes hold whose voltage varies
            return of_potential(columns, solution.potential, self._potential)
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


def of_electrode(name: str, shape: Shape, domain: Domain, width: float) -> Scatter:
    """Return points of an electrode's surface in a domain, enough for parts `width` m wide. Raises InputError."""
    points = scattered(shape, domain.lower, domain.upper, width / PER_WIDTH)
    if len(points.place) == 0:
        raise InputError(f"electrode {name} emits, and none of its surface is in the domain; move it, or the domain")
    return points


def _covers(hierarchy: Hierarchy, level: int, places: np.ndarray) -> bool:
    """Whether all places (n, 3) lie in cells of a level."""
    index = np.floor((places - hierarchy.lower) / hierarchy.spacing(level)).astype(np.int64)
    covered = np.zeros(len(places), dtype=bool)
    for box in hierarchy.boxes(level):
        covered |= ((index >= box[:3]) & (index <= box[3:])).all(axis=1)
    return bool(covered.all())


def _is_left(columns: Columns, solution: Solution) -> bool:
    """Whether the window has left a wall behind, so that it is no face of the mesh any more."""
    mirror, axis = solution.frames.mirror, columns.axis
    if not solution.frames.leaves or mirror is None or mirror.axis != axis:
        return False
    plane = mirror.planes[columns.side]
    domain = columns.hierarchy.domain
    face = (domain.lower, domain.upper)[columns.side][axis]
    return plane is None or abs(plane.place - face) > LEFT * domain.spacing[axis]

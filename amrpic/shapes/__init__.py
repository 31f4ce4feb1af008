"""Shapes of bodies, such as electrodes: where lines enter and leave them."""

from .level_set import LevelSet
from .mesh import Mesh
from .revolved import Revolved
from .shape import Hits, Shape
from .solids import Box, Cone, Cylinder, Disk, Plane, Sphere
from .spans import Spans
from .torus import Torus

__all__ = [
    "Box",
    "Cone",
    "Cylinder",
    "Disk",
    "Hits",
    "LevelSet",
    "Mesh",
    "Plane",
    "Revolved",
    "Shape",
    "Spans",
    "Sphere",
    "Torus",
]

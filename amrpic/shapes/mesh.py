"""A body of triangles, from an STL file."""

from __future__ import annotations

import hashlib
import os
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any, cast

import numpy as np
from numpy.typing import NDArray

from .. import _native
from ..errors import InputError
from ..units import UNITS
from .checks import Point
from .shape import ROUNDING, Columns, Shape
from .solids import set_fields
from .spans import Floats, Ints, Spans, swept_ends
from .triangles import Report, TriangleSurface, as_foil, closed, read_stl


@dataclass(frozen=True)
class Mesh(Shape):
    """What a surface of triangles encloses: an STL file, binary or text, with lengths in `unit`; or corners (n, 3, 3).

    Triangles that are given twice are dropped, flipped ones turned, holes filled; `report` says what was found. Holes of
    more than 5 % of the surface are refused. With `foil` the triangles themselves are metal, of no thickness.
    """

    path: str | os.PathLike[str] | Floats = field(compare=False)
    unit: str = field(default="m", compare=False)
    foil: bool = False
    digest: str = field(init=False, repr=False)
    corners: Floats = field(init=False, repr=False, compare=False)  # (n, 3, 3) m
    weight: NDArray[np.int32] = field(init=False, repr=False, compare=False)
    report: Report = field(init=False, repr=False, compare=False)

    def __post_init__(self) -> None:
        if self.unit not in UNITS["length"]:
            raise InputError(f'Mesh: its unit is "{self.unit}"; use one of {", ".join(UNITS["length"])}')
        where, triangles = f"Mesh: {self.path}", cast(Any, self.path)
        if isinstance(triangles, (str, os.PathLike)):
            corners = read_stl(triangles)
            path = os.fspath(triangles)
        else:
            where, path = "Mesh", "triangles"
            corners = np.array(triangles, float)
            if corners.ndim != 3 or corners.shape[1:] != (3, 3):
                raise InputError(f"Mesh: its triangles have shape {corners.shape}; give corners as (n, 3, 3), m")
        surface: TriangleSurface = (as_foil if self.foil else closed)(where, corners * UNITS["length"][self.unit])
        digest = hashlib.sha256(surface.corners.tobytes() + surface.weight.tobytes()).hexdigest()
        set_fields(
            self, path=path, digest=digest, corners=surface.corners, weight=surface.weight, report=surface.report
        )

    @cached_property
    def _triangles(self) -> _native.Triangles:
        return _native.Triangles(np.ascontiguousarray(self.corners.reshape(-1, 9)), self.weight)

    def __getstate__(self) -> dict[str, Any]:
        return {name: value for name, value in self.__dict__.items() if name != "_triangles"}

    @property
    def surfaces(self) -> int:
        return len(self.corners)

    @cached_property
    def bounds(self) -> tuple[Point, Point]:
        points = self.corners.reshape(-1, 3)
        return cast(Point, tuple(points.min(axis=0).tolist())), cast(Point, tuple(points.max(axis=0).tolist()))

    def _spans(self, start: Columns, direction: Columns) -> Spans:
        starts, ways = np.ascontiguousarray(start.T), np.ascontiguousarray(direction.T)
        *crossings, grazing = self._triangles.crossings(starts, ways)
        if self.foil:
            line, parameter, _, triangle = crossings
            order = np.lexsort((triangle, parameter, line))
            line, parameter, triangle = line[order], parameter[order], triangle[order]
            return Spans(line, parameter, parameter, triangle, triangle)
        passes = [crossings]
        if len(grazing):
            # Lines that pass an edge within rounding are taken four times more, on all sides of it: the body is closed,
            # and no part of it hangs on rounding.
            across = np.argsort(-abs(ways[grazing]), axis=1, kind="stable")[:, 1:]
            size = 2 * ROUNDING * float(np.abs(self.bounds).max())
            for signs in ((1, 1), (1, -1), (-1, 1), (-1, -1)):
                shift = np.zeros((len(grazing), 3))
                np.put_along_axis(shift, across, size * np.array([signs], float), axis=1)
                line, *columns, _ = self._triangles.crossings(starts[grazing] + shift, ways[grazing])
                passes.append([grazing[line], *columns])
        line, parameter, depth, triangle = (np.concatenate(column) for column in zip(*passes, strict=True))
        return swept_ends(line, parameter, triangle, depth)

    def _normals(self, points: Columns, surface: Ints) -> Columns:
        a, b, c = np.swapaxes(self.corners[surface], 0, 1)
        return np.ascontiguousarray(np.cross(b - a, c - a).T)

"""Shape: a body in space, known by the stretches of lines that lie in it; bodies combined, moved, turned, scaled."""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Callable
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any, Literal, NamedTuple, cast

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..errors import InputError
from . import checks
from .checks import Point
from .spans import Floats, Ints, Spans, combined

Columns = Floats  # (3, n): x, y and z of points or vectors
# Of coordinates, in shares of the largest one of a body.
ROUNDING = 1e-12
# Rounding of a turn by a right angle.
OF_TURNS = 4e-16


def dot(a: Columns, b: Columns) -> Floats:
    """Return scalar products, each by the same three products and two sums wherever it stands in the array."""
    return np.asarray(a[0] * b[0] + a[1] * b[1] + a[2] * b[2])


class Hits(NamedTuple):
    """Where segments first meet a body."""

    segment: Ints  # (m,), ascending
    share: Floats  # (m,) of the segment until there, 0 to 1
    normal: Floats  # (m, 3) of the surface, out of the body


class Shape(ABC):
    """A closed body. Lengths are in m.

    One primitive is behind all questions, `spans`: where lines enter and leave the body, to rounding. A value does not
    depend on what else is asked in the same call.
    """

    @property
    def surfaces(self) -> int:
        """How many surfaces it has that `spans` tells apart."""
        return 1

    @property
    @abstractmethod
    def bounds(self) -> tuple[Point, Point]:
        """Lower and upper corner of a box around it, which may lie at infinity."""

    @abstractmethod
    def _spans(self, start: Columns, direction: Columns) -> Spans: ...

    @abstractmethod
    def _normals(self, points: Columns, surface: Ints) -> Columns:
        """Return vectors, of any length and either sign, normal at points to the surface that each lies on."""

    def spans(self, start: ArrayLike, direction: ArrayLike | int) -> Spans:
        """Return where lines are in the body: `start` (n, 3) + parameter · `direction` (n, 3) or (3,).

        A number of an axis as `direction` stands for lines along it whose parameter is the coordinate.
        """
        points = columns("start", start)
        if isinstance(direction, (int, np.integer)):
            points[direction] = 0.0
            vectors = np.zeros_like(points)
            vectors[direction] = 1.0
        else:
            vectors = np.array(np.broadcast_to(columns("direction", direction), points.shape))
        with np.errstate(all="ignore"):
            return self._spans(points, vectors)

    def inside(self, points: ArrayLike) -> NDArray[np.bool_]:
        """Return which points (n, 3) lie in the body or on its surface."""
        places = columns("points", points).T
        near = self._near(places, places)
        spans = self.spans(places[near], 0)
        x = places[near[spans.line], 0]
        inside = np.zeros(len(places), bool)
        inside[near[spans.line[(spans.enter <= x) & (x <= spans.leave)]]] = True
        return inside

    def first_hits(self, start: ArrayLike, end: ArrayLike) -> Hits:
        """Return where segments between points (n, 3) first meet the body; at once, if they start in it."""
        begins, ends = columns("start", start).T, columns("end", end).T
        near = self._near(begins, ends)
        begins, ways = begins[near], ends[near] - begins[near]
        rests = ~ways.any(axis=1)
        ways[rests, 0] = 1.0
        spans = self.spans(begins, ways)
        spans = spans.select((spans.leave >= 0) & (spans.enter <= np.where(rests, 0.0, 1.0)[spans.line]))
        segment, place = np.unique(spans.line, return_index=True)
        enter, share = spans.enter[place], np.maximum(spans.enter[place], 0.0)
        met = np.where(enter >= 0, enter, spans.leave[place])  # whichever end of the span is nearer, for a start inside
        points = begins[segment] + met[:, None] * ways[segment]
        surface = np.where(enter >= 0, spans.first[place], spans.last[place])
        towards = np.where(enter >= 0, 1.0, -1.0)[:, None] * ways[segment]
        return Hits(near[segment], share, self.normals(points, surface, towards))

    def _near(self, start: Floats, end: Floats) -> Ints:
        """Return which segments between points (n, 3) may meet the box around it."""
        lower, upper = (np.array(corner) for corner in self.bounds)
        margin = ROUNDING * np.abs([lower, upper]).max(initial=0.0, where=np.isfinite([lower, upper]))
        clear = (np.minimum(start, end) > upper + margin) | (np.maximum(start, end) < lower - margin)
        return np.flatnonzero(~clear.any(axis=1))

    def _encloses(self, start: Columns, end: Columns) -> NDArray[np.bool_]:
        """Return which segments surely lie inside and do not touch the surface."""
        return np.zeros(start.shape[1], bool)

    def normals(self, points: ArrayLike, surface: ArrayLike, direction: ArrayLike) -> Floats:
        """Return unit normals (n, 3) at points on the body's surfaces, against the directions by which these are met."""
        places, vectors = columns("points", points), columns("direction", direction)
        numbers = np.broadcast_to(np.asarray(surface, np.int64), places.shape[1])
        with np.errstate(all="ignore"):
            normals = self._normals(places, numbers)
            normals = normals / np.sqrt(dot(normals, normals))
            normals[:, ~np.isfinite(normals[0])] = 0.0  # the tip of a cone, the centre of a sphere
            return np.ascontiguousarray((normals * np.where(dot(normals, vectors) > 0, -1.0, 1.0)).T)

    def __or__(self, other: Shape) -> Shape:
        return _combination("union", self, other)

    def __and__(self, other: Shape) -> Shape:
        return _combination("intersection", self, other)

    def __sub__(self, other: Shape) -> Shape:
        return _combination("difference", self, other)

    def moved(self, by: ArrayLike) -> Shape:
        """Return it moved by a vector, m."""
        return placed(self, np.eye(3), checks.point("moved: by", by))

    def turned(self, axis: Any, angle: float, about: ArrayLike = (0, 0, 0)) -> Shape:
        """Return it turned by an angle in rad, counter-clockwise about an axis ("x", "y", "z" or a vector) through a point."""
        matrix = rotation(checks.direction("turned: axis", axis), checks.number("turned: angle", angle))
        return _about(self, matrix, checks.point("turned: about", about))

    def scaled(self, factor: Any, about: ArrayLike = (0, 0, 0)) -> Shape:
        """Return it scaled by a factor, or by one along each axis, about a point."""
        try:
            factors = np.array([checks.positive("scaled: factor", part) for part in np.broadcast_to(factor, 3)])
        except ValueError:
            raise InputError(f"scaled: factor is {factor!r}; give a number above zero, or three") from None
        return _about(self, np.diag(factors), checks.point("scaled: about", about))


def columns(where: str, points: ArrayLike) -> Columns:
    """Return x, y and z (3, n) of points (n, 3), as a copy. Raises InputError."""
    array = np.asarray(points, float)
    if array.shape[-1:] != (3,) or array.ndim > 2:
        raise InputError(f"{where} has shape {array.shape}; give points as an array of shape (n, 3), m")
    if not np.isfinite(array).all():
        row = int(np.argmin(np.isfinite(array.reshape(-1, 3)).all(axis=1)))
        raise InputError(f"{where} has a value that is not finite in row {row}; give finite numbers, m")
    return np.array(array.reshape(-1, 3).T, order="C")


def rotation(axis: Point, angle: float) -> Floats:
    """Return the matrix of a turn about a unit vector; right angles have no rounding."""
    x, y, z = axis
    cross = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    matrix = np.eye(3) + math.sin(angle) * cross + (1 - math.cos(angle)) * (cross @ cross)
    nearest = np.round(matrix)
    return np.where(abs(matrix - nearest) < OF_TURNS, nearest, matrix) + 0.0


Kind = Literal["union", "intersection", "difference"]


@dataclass(frozen=True)
class Combination(Shape):
    """Several bodies as one: in any of them, in all of them, or in the first and in no other."""

    kind: Kind
    parts: tuple[Shape, ...]

    @property
    def surfaces(self) -> int:
        return sum(part.surfaces for part in self.parts)

    @cached_property
    def bounds(self) -> tuple[Point, Point]:
        if self.kind == "difference":
            return self.parts[0].bounds
        lower, upper = np.swapaxes([part.bounds for part in self.parts], 0, 1)
        if self.kind == "union":
            return _corners(lower.min(axis=0), upper.max(axis=0))
        return _corners(lower.max(axis=0), upper.min(axis=0))

    def _spans(self, start: Columns, direction: Columns) -> Spans:
        needed = len(self.parts) if self.kind == "intersection" else 1
        holes = len(self.parts) - 1 if self.kind == "difference" else 0
        bodies = [_of_part(part, start, direction) for part in self.parts]
        # A foil has no inside that could be taken away.
        bodies[len(bodies) - holes :] = [body.select(body.enter < body.leave) for body in bodies[len(bodies) - holes :]]
        return combined(bodies, [part.surfaces for part in self.parts], needed, holes)

    def _near(self, start: Floats, end: Floats) -> Ints:
        near = super()._near(start, end)
        for hole in self.parts[1:] if self.kind == "difference" else ():  # as of a pipe: most particles are in it
            near = near[~hole._encloses(start[near].T, end[near].T)]
        return near

    def _normals(self, points: Columns, surface: Ints) -> Columns:
        normals, first = np.zeros_like(points), 0
        for part in self.parts:
            own = np.flatnonzero((first <= surface) & (surface < first + part.surfaces))
            normals[:, own] = part._normals(points[:, own], surface[own] - first)
            first += part.surfaces
        return normals


def _of_part(part: Shape, start: Columns, direction: Columns) -> Spans:
    """Return the spans of one of several bodies, asked for the lines alone that meet the box around it."""
    near = np.flatnonzero(_meets(part.bounds, start, direction))
    if len(near) == start.shape[1]:
        return part._spans(start, direction)
    spans = part._spans(np.ascontiguousarray(start[:, near]), np.ascontiguousarray(direction[:, near]))
    return Spans(near[spans.line], spans.enter, spans.leave, spans.first, spans.last)


def _meets(bounds: tuple[Point, Point], start: Columns, direction: Columns) -> NDArray[np.bool_]:
    across = [axis for axis in range(3) if not direction[axis].any()]
    if len(across) == 2:  # lines along an axis
        within = [(start[a] >= bounds[0][a]) & (start[a] <= bounds[1][a]) for a in across]
        return np.asarray(within[0] & within[1])
    enter, leave = slabs(bounds, start, direction)
    margin = 1e-9 * (abs(enter) + abs(leave))
    return ~(enter > leave + np.where(np.isfinite(margin), margin, 0.0))


def slabs(bounds: tuple[Point, Point], start: Columns, direction: Columns, slack: float = 0.0) -> tuple[Floats, Floats]:
    """Return where lines enter and leave a box; of those that miss it, `enter` is above `leave`.

    Lines along faces are in the box up to a distance `slack` from it.
    """
    enter, leave = np.full(start.shape[1], -np.inf), np.full(start.shape[1], np.inf)
    for lower, upper, p, d in zip(*bounds, start, direction, strict=True):
        to_lower, to_upper = (lower - p) / d, (upper - p) / d
        across = d == 0
        outside = (p < lower - slack) | (p > upper + slack)
        low = np.where(across, np.where(outside, np.inf, -np.inf), np.minimum(to_lower, to_upper))
        high = np.where(across, np.where(outside, -np.inf, np.inf), np.maximum(to_lower, to_upper))
        enter, leave = np.maximum(enter, low), np.minimum(leave, high)
    return enter, leave


@dataclass(frozen=True)
class Placed(Shape):
    """A body whose points x are at `matrix` x + `offset`."""

    shape: Shape
    matrix: tuple[Point, Point, Point]
    offset: Point
    inverse: Floats = field(init=False, repr=False, compare=False)

    def __post_init__(self) -> None:
        inverse = np.linalg.inv(np.array(self.matrix))
        nearest = np.round(inverse)
        object.__setattr__(self, "inverse", np.where(abs(inverse - nearest) < OF_TURNS, nearest, inverse) + 0.0)

    @property
    def surfaces(self) -> int:
        return self.shape.surfaces

    @property
    def bounds(self) -> tuple[Point, Point]:
        corners = np.array(self.shape.bounds)
        matrix = np.array(self.matrix)
        with np.errstate(invalid="ignore"):
            reach = np.where(matrix == 0, 0.0, matrix * corners[:, None, :])  # (2, 3, 3)
        lower, upper = reach.min(axis=0).sum(axis=1), reach.max(axis=0).sum(axis=1)
        return _corners(lower + self.offset, upper + self.offset)

    def _inwards(self, points: Columns) -> Columns:
        return np.stack([sum(w * p for w, p in zip(row, points, strict=True)) for row in self.inverse])

    def _encloses(self, start: Columns, end: Columns) -> NDArray[np.bool_]:
        offset = np.array(self.offset)[:, None]
        return self.shape._encloses(self._inwards(start - offset), self._inwards(end - offset))

    def _spans(self, start: Columns, direction: Columns) -> Spans:
        return self.shape._spans(
            self._inwards(start - np.array(self.offset)[:, None]),
            self._inwards(direction),
        )

    def _normals(self, points: Columns, surface: Ints) -> Columns:
        normals = self.shape._normals(self._inwards(points - np.array(self.offset)[:, None]), surface)
        return np.stack([sum(w * n for w, n in zip(row, normals, strict=True)) for row in self.inverse.T])


def placed(shape: Shape, matrix: Floats, offset: ArrayLike) -> Shape:
    """Return a body with its points x at `matrix` x + `offset`."""
    move = np.asarray(offset, float)
    if isinstance(shape, Placed):
        return placed(shape.shape, matrix @ np.array(shape.matrix), matrix @ np.array(shape.offset) + move)
    rows = cast(tuple[Point, Point, Point], tuple(tuple(map(float, row)) for row in matrix))
    return Placed(shape, rows, cast(Point, tuple(map(float, move + 0.0))))


def _about(shape: Shape, matrix: Floats, about: Point) -> Shape:
    return placed(shape, matrix, np.array(about) - matrix @ np.array(about))


def _corners(lower: Floats, upper: Floats) -> tuple[Point, Point]:
    return cast(Point, tuple(map(float, lower))), cast(Point, tuple(map(float, upper)))


def _combination(kind: Kind, first: Shape, second: object) -> Shape:
    if not isinstance(second, Shape):
        return NotImplemented
    parts = first.parts if isinstance(first, Combination) and first.kind == kind else (first,)
    nested = isinstance(second, Combination) and second.kind == kind and kind != "difference"
    return Combination(kind, (*parts, *(cast(Combination, second).parts if nested else (second,))))


Function = Callable[[Floats, Floats, Floats], Floats]

"""The simple bodies: what a line meets once at most."""

from __future__ import annotations

import math
from abc import abstractmethod
from dataclasses import dataclass
from functools import cached_property
from typing import cast

import numpy as np
from numpy.typing import NDArray

from ..errors import InputError
from . import checks
from .checks import Point
from .shape import ROUNDING, Columns, Shape, dot, slabs
from .spans import Floats, Ints, Spans

INFINITE: tuple[Point, Point] = ((-math.inf,) * 3, (math.inf,) * 3)
# Lines within this angle of a foil's plane, or of a cylinder's axis, count as parallel to it.
PARALLEL = 1e-12
# Points within this part of a body's size are inside whatever rounding does.
DEEP = 1 - 1e-6


class Convex(Shape):
    """A body that a line meets once at most."""

    @abstractmethod
    def _ends(self, start: Columns, direction: Columns) -> tuple[Floats, Floats]:
        """Return where lines enter and leave; `enter` not below `leave` for those that miss."""

    def _spans(self, start: Columns, direction: Columns) -> Spans:
        return Spans.of_convex(*self._ends(start, direction))

    def _deep(self, points: Columns) -> NDArray[np.bool_]:
        """Return which points lie inside by more than rounding; none, if a body does not say it for less than a line costs."""
        return np.zeros(points.shape[1], bool)

    def _encloses(self, start: Columns, end: Columns) -> NDArray[np.bool_]:
        return self._deep(start) & self._deep(end)


def set_fields(shape: Shape, **values: object) -> None:
    """Set fields of a frozen value while it is made."""
    for name, value in values.items():
        object.__setattr__(shape, name, value)


def column(point: Point) -> Columns:
    """Return a point as a column."""
    return np.array(point)[:, None]


@dataclass(frozen=True)
class Sphere(Convex):
    """A ball."""

    centre: Point
    radius: float

    def __post_init__(self) -> None:
        centre = checks.point("Sphere: centre", self.centre)
        set_fields(self, centre=centre, radius=checks.positive("Sphere: radius", self.radius))

    @property
    def bounds(self) -> tuple[Point, Point]:
        return around(self.centre, (self.radius,) * 3)

    def _ends(self, start: Columns, direction: Columns) -> tuple[Floats, Floats]:
        middle, nearest = towards(start - column(self.centre), direction)
        half = np.sqrt((self.radius**2 - dot(nearest, nearest)) / dot(direction, direction))
        return middle - half, middle + half

    def _deep(self, points: Columns) -> NDArray[np.bool_]:
        offset = points - column(self.centre)
        return np.asarray(dot(offset, offset) < (DEEP * self.radius) ** 2)

    def _normals(self, points: Columns, surface: Ints) -> Columns:
        return points - column(self.centre)


def around(centre: Point, reach: Point) -> tuple[Point, Point]:
    """Return the corners of a box around a point."""
    lower, upper = (tuple(c + sign * r for c, r in zip(centre, reach, strict=True)) for sign in (-1, 1))
    return cast(Point, lower), cast(Point, upper)


def towards(start: Columns, direction: Columns) -> tuple[Floats, Columns]:
    """Return the parameters at which lines are nearest to the origin, and the points there: small numbers do not cancel."""
    middle = -dot(start, direction) / dot(direction, direction)
    return middle, start + middle * direction


@dataclass(frozen=True)
class Box(Convex):
    """A box along the axes."""

    lower: Point
    upper: Point

    def __post_init__(self) -> None:
        lower, upper = checks.point("Box: lower", self.lower), checks.point("Box: upper", self.upper)
        checks.ascending("Box", lower, upper)
        set_fields(self, lower=lower, upper=upper)

    @property
    def bounds(self) -> tuple[Point, Point]:
        return self.lower, self.upper

    def _ends(self, start: Columns, direction: Columns) -> tuple[Floats, Floats]:
        # Faces on planes of cell centres are common, and edges there may not hang on rounding.
        return slabs(self.bounds, start, direction, ROUNDING * float(np.abs(self.bounds).max()))

    def _deep(self, points: Columns) -> NDArray[np.bool_]:
        half = (column(self.upper) - column(self.lower)) / 2
        return np.asarray((abs(points - column(self.lower) - half) < DEEP * half).all(axis=0))

    def _normals(self, points: Columns, surface: Ints) -> Columns:
        lower, upper = column(self.lower), column(self.upper)
        place = (points - lower) / (upper - lower) - 0.5
        # The face that a point is nearest to, in shares of the box.
        out = abs(abs(place) - 0.5) * (upper - lower)
        axis = out.argmin(axis=0)
        return np.where(np.arange(3)[:, None] == axis, np.sign(place), 0.0)


@dataclass(frozen=True)
class Plane(Convex):
    """All that lies behind a plane, against its normal."""

    point: Point
    normal: Point

    def __post_init__(self) -> None:
        point, normal = checks.point("Plane: point", self.point), checks.direction("Plane: normal", self.normal)
        set_fields(self, point=point, normal=normal)

    @property
    def bounds(self) -> tuple[Point, Point]:
        bounds = np.array(INFINITE)
        for axis, part in enumerate(self.normal):
            if abs(part) == 1:
                bounds[int(part > 0), axis] = self.point[axis]
        return cast(tuple[Point, Point], tuple(map(tuple, bounds.tolist())))

    def _ends(self, start: Columns, direction: Columns) -> tuple[Floats, Floats]:
        height = dot(column(self.normal), start - column(self.point))
        rise = dot(column(self.normal), direction)
        meets = -height / rise
        within = np.where(height <= 0, np.inf, -np.inf)
        enter = np.where(rise < 0, meets, np.where(rise > 0, -np.inf, -within))
        leave = np.where(rise > 0, meets, np.where(rise < 0, np.inf, within))
        return enter, leave

    def _normals(self, points: Columns, surface: Ints) -> Columns:
        return np.broadcast_to(column(self.normal), points.shape)


@dataclass(frozen=True)
class Disk(Shape):
    """A round foil of no thickness."""

    centre: Point
    normal: Point
    radius: float

    def __post_init__(self) -> None:
        centre, normal = checks.point("Disk: centre", self.centre), checks.direction("Disk: normal", self.normal)
        set_fields(self, centre=centre, normal=normal, radius=checks.positive("Disk: radius", self.radius))

    @property
    def bounds(self) -> tuple[Point, Point]:
        return around(self.centre, of_circle(self.normal, self.radius))

    def _spans(self, start: Columns, direction: Columns) -> Spans:
        offset, normal = start - column(self.centre), column(self.normal)
        rise, height = dot(normal, direction), dot(normal, offset)
        meets = np.where(abs(rise) > PARALLEL * np.sqrt(dot(direction, direction)), -height / rise, np.nan)
        place = offset + meets * direction
        meets = np.where(dot(place, place) <= self.radius**2, meets, np.nan)
        return Spans.of_convex(meets, meets, foil=True)

    def _normals(self, points: Columns, surface: Ints) -> Columns:
        return np.broadcast_to(column(self.normal), points.shape)


def of_circle(normal: Point, radius: float) -> Point:
    """Return how far a circle reaches along the axes from its centre."""
    return cast(Point, tuple(radius * math.sqrt(max(0.0, 1 - part**2)) for part in normal))


@dataclass(frozen=True)
class Cone(Convex):
    """A cone or a part of one, between two flat ends; a radius may be zero."""

    start: Point
    end: Point
    radius_start: float
    radius_end: float

    def __post_init__(self) -> None:
        start, end = checks.point("Cone: start", self.start), checks.point("Cone: end", self.end)
        checks.differ("Cone: start and end", start, end)
        radii = (
            checks.number("Cone: radius_start", self.radius_start),
            checks.number("Cone: radius_end", self.radius_end),
        )
        if min(radii) < 0 or max(radii) == 0:
            raise InputError(
                f"Cone: its radii are {radii[0]:g} and {radii[1]:g} m; give none below zero, and one above zero"
            )
        set_fields(self, start=start, end=end, radius_start=radii[0], radius_end=radii[1])

    @cached_property
    def bounds(self) -> tuple[Point, Point]:
        axis = checks.direction("Cone", np.subtract(self.end, self.start))
        ends = [
            around(self.start, of_circle(axis, self.radius_start)),
            around(self.end, of_circle(axis, self.radius_end)),
        ]
        lower, upper = np.swapaxes(ends, 0, 1)
        return cast(Point, tuple(lower.min(axis=0).tolist())), cast(Point, tuple(upper.max(axis=0).tolist()))

    def _ends(self, start: Columns, direction: Columns) -> tuple[Floats, Floats]:
        axis = checks.direction("Cone", np.subtract(self.end, self.start))
        lines = AxialLines.of(self.start, axis, start, direction)
        return lines.in_frustum(0.0, math.dist(self.start, self.end), self.radius_start, self.radius_end)

    def _deep(self, points: Columns) -> NDArray[np.bool_]:
        axis, length = checks.direction("Cone", np.subtract(self.end, self.start)), math.dist(self.start, self.end)
        offset = points - column(self.start)
        height = dot(column(axis), offset)
        radius = DEEP * (self.radius_start + (self.radius_end - self.radius_start) * height / length)
        across = dot(offset, offset) - height**2
        return np.asarray((abs(height - length / 2) < DEEP * length / 2) & (radius > 0) & (across < radius**2))

    def _normals(self, points: Columns, surface: Ints) -> Columns:
        axis = checks.direction("Cone", np.subtract(self.end, self.start))
        length = math.dist(self.start, self.end)
        return frustum_normals(self.start, axis, points, 0.0, length, self.radius_start, self.radius_end)


@dataclass(frozen=True)
class Cylinder(Convex):
    """A round rod with flat ends."""

    start: Point
    end: Point
    radius: float

    def __post_init__(self) -> None:
        start, end = checks.point("Cylinder: start", self.start), checks.point("Cylinder: end", self.end)
        checks.differ("Cylinder: start and end", start, end)
        set_fields(self, start=start, end=end, radius=checks.positive("Cylinder: radius", self.radius))

    @cached_property
    def _cone(self) -> Cone:
        return Cone(self.start, self.end, self.radius, self.radius)

    @property
    def bounds(self) -> tuple[Point, Point]:
        return self._cone.bounds

    def _ends(self, start: Columns, direction: Columns) -> tuple[Floats, Floats]:
        return self._cone._ends(start, direction)

    def _deep(self, points: Columns) -> NDArray[np.bool_]:
        return self._cone._deep(points)

    def _normals(self, points: Columns, surface: Ints) -> Columns:
        return self._cone._normals(points, surface)


@dataclass(frozen=True, eq=False)
class AxialLines:
    """Lines as heights along an axis and distances from it, (n,): height(s) = z + s·dz, distance²(s) = rr + 2s·rd + s²·dd."""

    z: Floats
    dz: Floats
    rr: Floats
    rd: Floats
    dd: Floats
    middle: Floats  # parameter that s counts from

    @classmethod
    def of(cls, base: Point, axis: Point, start: Columns, direction: Columns) -> AxialLines:
        """Return lines beside the axis through `base` along the unit vector `axis`."""
        along, unit = column(axis), column(axis)
        middle, nearest = towards(start - column(base), direction)
        z, dz = dot(along, nearest), dot(along, direction)
        across, turn = nearest - z * unit, direction - dz * unit
        dd = dot(turn, turn)
        dd = np.where(dd > PARALLEL**2 * dot(direction, direction), dd, 0.0)
        rd = np.where(dd > 0, dot(across, turn), 0.0)
        return cls(z, dz, dot(across, across), rd, dd, middle)

    def select(self, chosen: np.ndarray) -> AxialLines:
        """Return those that an index array names."""
        return AxialLines(*(getattr(self, name)[chosen] for name in ("z", "dz", "rr", "rd", "dd", "middle")))

    def at_height(self, height: float) -> Floats:
        """Return s where lines are at a height; infinite for those across the axis."""
        return np.asarray((height - self.z) / self.dz)

    def between(self, low: float, high: float) -> tuple[Floats, Floats]:
        """Return s where lines enter and leave the layer between two heights."""
        at_low, at_high = self.at_height(low), self.at_height(high)
        outside = (self.z < low) | (self.z > high)
        across = self.dz == 0
        enter = np.where(across, np.where(outside, np.inf, -np.inf), np.minimum(at_low, at_high))
        leave = np.where(across, np.where(outside, -np.inf, np.inf), np.maximum(at_low, at_high))
        return enter, leave

    def in_frustum(self, low: float, high: float, radius_low: float, radius_high: float) -> tuple[Floats, Floats]:
        """Return the parameters where lines enter and leave a cone with ends at two heights along the axis."""
        slope = (radius_high - radius_low) / (high - low)
        radius = radius_low + slope * (self.z - low)
        # a s² + 2 b s + c <= 0: no further from the axis than the cone is wide there.
        a, b, c = self.dd - (slope * self.dz) ** 2, self.rd - slope * self.dz * radius, self.rr - radius**2
        enter, leave = self.between(low, high)
        root = np.sqrt(b * b - a * c)  # nan where there is none
        large = -(b + np.where(b < 0, -root, root))
        outer, inner = large / a, c / large
        flat = a == 0
        outer = np.where(flat, np.nan, outer)
        inner = np.where(flat, -c / (2 * b), inner)
        first, last = np.fmin(outer, inner), np.fmax(outer, inner)
        starts, stops = self._excess(a, b, c, enter), self._excess(a, b, c, leave)
        # The layer holds no more than one interval. It begins at the layer's face, or else at the first root in it.
        begin = np.where(starts <= 0, enter, np.where(first >= enter, first, last))
        end = np.where(stops <= 0, leave, np.where(last <= leave, last, first))
        misses = (enter >= leave) | ((starts > 0) & (stops > 0) & ~((a > 0) & (first >= enter) & (last <= leave)))
        begin = np.where(misses | ~(begin <= end) | (begin > leave) | (end < enter), np.nan, begin)
        return begin + self.middle, end + self.middle

    @staticmethod
    def _excess(a: Floats, b: Floats, c: Floats, s: Floats) -> Floats:
        value = (a * s + 2 * b) * s + c
        far = np.where(a != 0, a, np.where(b != 0, b * np.sign(s), c))
        return np.where(np.isfinite(s), value, far)


def frustum_normals(
    base: Point, axis: Point, points: Columns, low: float, high: float, radius_low: float, radius_high: float
) -> Columns:
    """Return normals of the part of a cone that points lie next to: its mantle or one of its ends."""
    offset, unit = points - column(base), column(axis)
    height = dot(unit, offset)
    across = offset - height * unit
    distance = np.sqrt(dot(across, across))
    slope = (radius_high - radius_low) / (high - low)
    cosine = 1 / math.hypot(1, slope)
    to_mantle = abs(distance - radius_low - slope * (height - low)) * cosine
    to_end = np.minimum(abs(height - low), abs(height - high))
    mantle = across / distance - slope * unit
    return np.where(to_mantle < to_end, mantle, np.where(2 * height < low + high, -unit, unit))

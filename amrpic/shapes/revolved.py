"""A polygon turned about an axis."""

from __future__ import annotations

import os
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any, cast

import numpy as np

from ..errors import InputError
from . import checks
from .checks import Point
from .shape import Columns, Shape, dot
from .solids import DEEP, AxialLines, around, column, of_circle, set_fields
from .spans import Floats, Ints, Spans, swept

Profile = tuple[tuple[float, float], ...]


@dataclass(frozen=True)
class Revolved(Shape):
    """A polygon of points (z, r), z along `axis` from `origin`, turned about the axis; its last point joins its first.

    `points` may name a CSV file of two columns, z and r in m.
    """

    points: Sequence[tuple[float, float]] | str | os.PathLike[str]
    axis: Point = (0.0, 0.0, 1.0)
    origin: Point = (0.0, 0.0, 0.0)

    def __post_init__(self) -> None:
        where, points = "Revolved", cast(Any, self.points)
        if isinstance(points, (str, os.PathLike)):
            where, points = f"Revolved: {points}", read_profile(points)
        axis, origin = checks.direction("Revolved: axis", self.axis), checks.point("Revolved: origin", self.origin)
        set_fields(self, points=polygon(where, points), axis=axis, origin=origin)

    @property
    def surfaces(self) -> int:
        return len(self.profile)

    @property
    def profile(self) -> Profile:
        """The points of the polygon (z, r), m."""
        return cast(Profile, self.points)

    @cached_property
    def bounds(self) -> tuple[Point, Point]:
        corners = []
        for z, r in self.profile:
            centre = tuple(o + z * a for o, a in zip(self.origin, self.axis, strict=True))
            corners.append(around(cast(Point, centre), of_circle(self.axis, r)))
        lower, upper = np.swapaxes(corners, 0, 1)
        return cast(Point, tuple(lower.min(axis=0).tolist())), cast(Point, tuple(upper.max(axis=0).tolist()))

    def _near(self, start: Floats, end: Floats) -> Ints:
        near = super()._near(start, end)
        bore = (DEEP * min(r for _, r in self.profile)) ** 2  # round it all metal is: most particles are in it
        if bore == 0:
            return near
        clear = np.ones(len(near), bool)
        for places in (start, end):
            offset = places[near].T - column(self.origin)
            clear &= dot(offset, offset) - dot(column(self.axis), offset) ** 2 < bore
        return near[~clear]

    def _edges(self) -> Iterator[tuple[int, float, float, float, float, int]]:
        """Yield number, heights and radii (lower end first) of edges that are mantles, and +1 if the body is below, else -1."""
        turn = 1 if area(np.array(self.profile)) > 0 else -1
        for number, ((z, r), (z_next, r_next)) in enumerate(
            zip(self.profile, (*self.profile[1:], self.profile[0]), strict=True)
        ):
            if z < z_next:
                yield number, z, z_next, r, r_next, -turn
            elif z > z_next:
                yield number, z_next, z, r_next, r, turn

    def _spans(self, start: Columns, direction: Columns) -> Spans:
        lines = AxialLines.of(self.origin, self.axis, start, direction)
        parts: list[tuple[Ints, Floats, Floats, int, int]] = []
        # The polygon is the sum of strips between the axis and its edges, each of which is a part of a cone.
        for number, low, high, radius_low, radius_high, sign in self._edges():
            largest = max(radius_low, radius_high)
            enter, leave = lines.between(low, high)
            middle = np.where(lines.dd > 0, np.clip(-lines.rd / lines.dd, enter, leave), 0.0)
            nearest = lines.rr + (2 * lines.rd + lines.dd * middle) * middle
            near = np.flatnonzero((enter <= leave) & ~(nearest > largest**2 * (1 + 1e-9)))
            enter, leave = lines.select(near).in_frustum(low, high, radius_low, radius_high)
            meets = np.flatnonzero(enter < leave)
            parts.append((near[meets], enter[meets], leave[meets], number, sign))
        count = [len(part[0]) for part in parts]
        line, enter, leave = (np.concatenate([part[column] for part in parts]) for column in range(3))
        surface, signs = (np.repeat([part[column] for part in parts], count) for column in (3, 4))
        return swept(line, enter, leave, (surface, surface), signs, np.zeros_like(signs))

    def _normals(self, points: Columns, surface: Ints) -> Columns:
        """Return those of the edge that is nearest: an end of a strip may be an edge across the axis."""
        offset, unit = points - column(self.origin), column(self.axis)
        height = dot(unit, offset)
        across = offset - height * unit
        distance = np.sqrt(dot(across, across))
        best, normals = np.full(points.shape[1], np.inf), np.zeros_like(points)
        for (z, r), (z_next, r_next) in zip(self.profile, (*self.profile[1:], self.profile[0]), strict=True):
            dz, dr = z_next - z, r_next - r
            share = np.clip(((height - z) * dz + (distance - r) * dr) / (dz**2 + dr**2), 0, 1)
            gap = np.hypot(height - z - share * dz, distance - r - share * dr)
            nearer = (gap < best) & ((r > 0) | (r_next > 0))
            best = np.where(nearer, gap, best)
            normals = np.where(nearer, dz * across / distance - dr * unit, normals)
        return normals


def area(points: Floats) -> float:
    """Return the area of a polygon, positive if it is walked counter-clockwise."""
    x, y = points.T
    return float((x * np.roll(y, -1) - np.roll(x, -1) * y).sum() / 2)


def polygon(where: str, points: Any) -> Profile:
    """Return the points of a polygon that does not meet itself. Raises InputError."""
    try:
        profile = [(float(z) + 0.0, float(r) + 0.0) for z, r in points]
    except (TypeError, ValueError):
        raise InputError(f"{where}: its points are no pairs of numbers; give them as [(z, r), …], m") from None
    array = np.array(profile).reshape(-1, 2)
    if not np.isfinite(array).all():
        raise InputError(f"{where}: point {first_row(~np.isfinite(array))} is not finite; give finite numbers, m")
    if (array[:, 1] < 0).any():
        row = first_row(array[:, 1:] < 0)
        raise InputError(f"{where}: point {row} has the radius {array[row, 1]:g} m; give none below zero")
    corners = (
        [p for p, before in zip(profile, [profile[-1], *profile[:-1]], strict=True) if p != before] if profile else []
    )
    if len(corners) < 3 or not area(np.array(corners)):
        raise InputError(
            f"{where}: its {len(corners)} different points enclose no area; give three or more of a polygon"
        )
    crossing = first_crossing(np.array(corners))
    if crossing:
        raise InputError(
            f"{where}: the edges after points {crossing[0]} and {crossing[1]} meet; order the points along the outline"
        )
    return tuple(corners)


def first_row(wrong: np.ndarray) -> int:
    """Return the first row in which something is wrong."""
    return int(np.argmax(wrong.any(axis=1)))


def first_crossing(points: Floats) -> tuple[int, int] | None:
    """Return the numbers of two edges of a polygon that meet and do not follow each other."""
    a, b = points, np.roll(points, -1, axis=0)

    def side(p: Floats, q: Floats, r: Floats) -> Floats:
        return np.sign(
            (q[..., 0] - p[..., 0]) * (r[..., 1] - p[..., 1]) - (q[..., 1] - p[..., 1]) * (r[..., 0] - p[..., 0])
        )

    n = len(points)
    for i in range(n - 2):
        later = np.arange(i + 2, n - (i == 0))
        across = side(a[i], b[i], a[later]) * side(a[i], b[i], b[later])
        back = side(a[later], b[later], a[i]) * side(a[later], b[later], b[i])
        low, high = np.minimum(a, b), np.maximum(a, b)
        clear = (low[later] > high[i]).any(axis=1) | (high[later] < low[i]).any(axis=1)
        on_axis = (high[later, 1] == 0) & (high[i, 1] == 0)
        meet = (across <= 0) & (back <= 0) & ~clear & ~on_axis
        if meet.any():
            return i, int(later[np.argmax(meet)])
    return None


def read_profile(path: str | os.PathLike[str]) -> Any:
    """Return the rows of a CSV file of two columns; lines that begin with # or letters are titles. Raises InputError."""
    try:
        text = Path(path).read_text(encoding="utf-8-sig")
    except OSError as reason:
        raise InputError(f"Revolved: {path} cannot be read ({reason.strerror}); check the path") from None
    except UnicodeDecodeError:
        raise InputError(f"Revolved: {path} is no text; give a CSV file of two columns, z and r in m") from None
    rows: list[tuple[float, float]] = []
    for number, line in enumerate(text.splitlines(), 1):
        cells = [cell.strip() for cell in line.replace(";", ",").split(",")]
        if not line.strip() or line.lstrip().startswith("#") or (not rows and line.strip()[0].isalpha()):
            continue
        try:
            z, r = map(float, cells)
        except ValueError:
            raise InputError(
                f'Revolved: {path} has "{line.strip()[:60]}" in line {number}; write two numbers, z and r in m'
            ) from None
        rows.append((z, r))
    return rows

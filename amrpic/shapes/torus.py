"""The torus: a line meets it twice at most, at roots of a quartic."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..errors import InputError
from . import checks
from .checks import Point
from .roots import roots_between
from .shape import Columns, Shape, dot
from .solids import around, column, of_circle, set_fields, towards
from .spans import Floats, Ints, Spans


@dataclass(frozen=True)
class Torus(Shape):
    """A ring: all that is within `tube` of a circle of `radius` about an axis."""

    centre: Point
    axis: Point
    radius: float
    tube: float

    def __post_init__(self) -> None:
        centre, axis = checks.point("Torus: centre", self.centre), checks.direction("Torus: axis", self.axis)
        radius, tube = checks.positive("Torus: radius", self.radius), checks.positive("Torus: tube", self.tube)
        if tube >= radius:
            raise InputError(
                f"Torus: its tube, {tube:g} m, is not below its radius, {radius:g} m; give a thinner tube, or a Sphere"
            )
        set_fields(self, centre=centre, axis=axis, radius=radius, tube=tube)

    @property
    def bounds(self) -> tuple[Point, Point]:
        x, y, z = (reach + self.tube for reach in of_circle(self.axis, self.radius))
        return around(self.centre, (x, y, z))

    def _excess(self, square: Floats, height: Floats) -> Floats:
        """Return (distance from the circle)² - tube², of points at distances² from the centre and heights along the axis."""
        return (np.sqrt(np.maximum(square - height**2, 0.0)) - self.radius) ** 2 + height**2 - self.tube**2

    def _spans(self, start: Columns, direction: Columns) -> Spans:
        scale = np.sqrt(dot(direction, direction))
        middle, nearest = towards(start - column(self.centre), direction)
        square = dot(nearest, nearest)
        line = np.flatnonzero(square < (self.radius + self.tube) ** 2)
        scale, middle, square = scale[line], middle[line], square[line]
        height, rise = dot(column(self.axis), nearest[:, line]), dot(column(self.axis), direction[:, line]) / scale
        places = self._splits(square, height, rise)

        def excess(t: Floats, number: Ints) -> Floats:
            return self._excess(square[number] + t**2, height[number] + rise[number] * t)

        everyone = np.arange(len(line))
        outside = np.stack([excess(t, everyone) for t in places]) > 0
        outside[0] = outside[-1] = True  # on the sphere around it
        part, number = np.nonzero((outside[1:] != outside[:-1]).T)[::-1]
        low, high = places[part, number], places[part + 1, number]
        # The value at the far end is that of the sphere around it where rounding might give it the other sign.
        root = roots_between(lambda t, n: excess(t, number[n]), low, high, np.where(outside[part, number], 1.0, -1.0))
        root = root / scale[number] + middle[number]
        surface = np.zeros(len(root) // 2, np.int64)
        return Spans(line[number[::2]], root[::2], root[1::2], surface, surface)

    def _splits(self, square: Floats, height: Floats, rise: Floats) -> Floats:
        """Return places (5, n) along lines, ascending, between which the quartic t⁴ + a t² + b t + c is monotone."""
        a = 2 * (square + self.radius**2 - self.tube**2) - 4 * self.radius**2 * (1 - rise**2)
        b = 8 * self.radius**2 * height * rise
        reach = np.sqrt((self.radius + self.tube) ** 2 - square)
        # Extrema: t³ + p t + q = 0.
        p, q = a / 2, b / 4
        inner = (q / 2) ** 2 + (p / 3) ** 3
        large = np.cbrt(-(q / 2 + np.copysign(np.sqrt(np.maximum(inner, 0.0)), q)))
        only = np.where(large == 0, 0.0, large - p / (3 * large))
        size = 2 * np.sqrt(np.maximum(-p / 3, 0.0))
        angle = np.arccos(np.clip(np.where(size > 0, 3 * q / (p * size), 0.0), -1, 1)) / 3
        three = [size * np.cos(angle - 2 * np.pi * k / 3) for k in (2, 1, 0)]
        extrema = np.sort([np.where(inner > 0, only, t) for t in three], axis=0)
        return np.stack([-reach, *np.clip(extrema, -reach, reach), reach])

    def _normals(self, points: Columns, surface: Ints) -> Columns:
        offset, unit = points - column(self.centre), column(self.axis)
        across = offset - dot(unit, offset) * unit
        return offset - self.radius * across / np.sqrt(dot(across, across))

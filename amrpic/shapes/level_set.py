"""A body where a function of Python is below zero."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..errors import InputError
from . import checks
from .checks import Point
from .roots import roots_between
from .shape import Columns, Function, Shape, slabs
from .solids import set_fields
from .spans import Floats, Ints, Spans

LINES_AT_ONCE = 1024  # a few MB of points and values
TINY = 1e-300
STEP = 1e-6  # of differences for normals, in diagonals of the box


@dataclass(frozen=True)
class LevelSet(Shape):
    """Where `function(x, y, z)`, of arrays in m, is at most zero, in a box.

    Along each line it is looked at in `samples` steps through the box, so what is thinner than such a step may be missed; where
    its sign changes, its root is found to rounding. The function has to be continuous, and its value at a point the same
    whatever other points are asked.
    """

    function: Function
    lower: Point
    upper: Point
    samples: int = 128

    def __post_init__(self) -> None:
        lower, upper = checks.point("LevelSet: lower", self.lower), checks.point("LevelSet: upper", self.upper)
        checks.ascending("LevelSet", lower, upper)
        if not callable(self.function):
            raise InputError(f"LevelSet: function is {self.function!r}; give a function of x, y and z")
        if not isinstance(self.samples, int) or self.samples < 2:
            raise InputError(f"LevelSet: samples is {self.samples!r}; give a whole number of at least 2")
        set_fields(self, lower=lower, upper=upper)
        self._value(np.array([lower, upper]).T)

    @property
    def bounds(self) -> tuple[Point, Point]:
        return self.lower, self.upper

    def _value(self, points: Columns) -> Floats:
        value = np.broadcast_to(np.asarray(self.function(*points), float), points.shape[1:])
        if np.isnan(value).any():
            x, y, z = (part[np.isnan(value)][0] for part in points)
            raise InputError(
                f"LevelSet: its function is not a number at ({x:g}, {y:g}, {z:g}) m; make it finite in the whole box"
            )
        return np.where(value == 0, -TINY, value)  # where it is zero over a stretch, the body ends where that does

    def _spans(self, start: Columns, direction: Columns) -> Spans:
        enter, leave = slabs(self.bounds, start, direction)
        lines = np.flatnonzero(enter < leave)
        parts = [
            self._of_lines(block, start, direction, enter, leave)
            for block in np.array_split(lines, len(lines) // LINES_AT_ONCE + 1)
        ]
        line, first, last = (np.concatenate(column) for column in zip(*parts, strict=True))
        surface = np.zeros(len(line), np.int64)
        return Spans(line, first, last, surface, surface).select(first < last)

    def _of_lines(
        self, lines: Ints, start: Columns, direction: Columns, enter: Floats, leave: Floats
    ) -> tuple[Ints, Floats, Floats]:
        p, d = start[:, lines], direction[:, lines]
        share = np.linspace(0.0, 1.0, self.samples + 1)[:, None]
        places = enter[lines] * (1 - share) + leave[lines] * share  # (samples + 1, n)
        value = self._value(p[:, None] + d[:, None] * places)
        within = np.pad(value <= 0, ((1, 1), (0, 0)))  # the box ends the body
        number, part = np.nonzero((within[1:] != within[:-1]).T)
        low, high = np.maximum(part - 1, 0), np.minimum(part, self.samples)
        root = np.array(places[high, number])
        inner = np.flatnonzero(low < high)
        at = number[inner]

        def along(s: Floats, chosen: Ints) -> Floats:
            return self._value(p[:, at[chosen]] + d[:, at[chosen]] * s)

        ends = places[low[inner], at], places[high[inner], at]
        root[inner] = roots_between(along, *ends, value[low[inner], at])
        return lines[number[::2]], root[::2], root[1::2]

    def _normals(self, points: Columns, surface: Ints) -> Columns:
        size = np.subtract(self.upper, self.lower)
        lower, upper = (np.array(corner)[:, None] for corner in self.bounds)
        step = STEP * float(np.sqrt((size**2).sum()))
        low, high = np.maximum(points - step, lower), np.minimum(points + step, upper)
        slopes = np.empty_like(points)
        for axis in range(3):
            before, behind = points.copy(), points.copy()
            before[axis], behind[axis] = low[axis], high[axis]
            slopes[axis] = (self._value(behind) - self._value(before)) / (high[axis] - low[axis])
        return self._or_of_box(points, slopes)

    def _or_of_box(self, points: Columns, slopes: Columns) -> Columns:
        """Return slopes, or where the box cuts the body off the normals of the box."""
        from .solids import Box

        lower, upper = (np.array(corner)[:, None] for corner in self.bounds)
        gap = np.minimum(points - lower, upper - points) / (upper - lower)
        cut = (gap.min(axis=0) < 1e-12) & (self._value(points) < 0)
        return np.where(cut, Box(self.lower, self.upper)._normals(points, np.zeros(1, np.int64)), slopes)

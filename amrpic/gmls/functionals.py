"""Linear functionals of polynomials: sums of derivatives at places, and of their means over boxes."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike

from ..errors import InputError


@dataclass(frozen=True, eq=False)
class Part:
    """A derivative of a component, averaged over boxes around places, times coefficients; `count` of them or one for all."""

    place: np.ndarray  # (count or 1, dimension)
    half: np.ndarray | None  # half widths of the boxes, the same shape; none: at the places
    derivative: tuple[int, ...]  # per axis
    component: int
    coefficient: np.ndarray  # (count or 1,)


@dataclass(frozen=True, eq=False)
class Functional:
    """A sum of parts, one functional per sample or target. Functionals add up and take numbers, or arrays of one per row."""

    parts: tuple[Part, ...] = ()

    def __add__(self, other: Functional | int) -> Functional:
        return Functional(self.parts + other.parts) if isinstance(other, Functional) else self  # sum() starts from 0

    __radd__ = __add__

    def __mul__(self, by: ArrayLike) -> Functional:
        factor = np.atleast_1d(np.asarray(by, dtype=float))
        return Functional(tuple(replace(part, coefficient=part.coefficient * factor) for part in self.parts))

    __rmul__ = __mul__

    def __sub__(self, other: Functional) -> Functional:
        return self + -1.0 * other

    def of_component(self, component: int) -> Functional:
        """What acts on one component, as a functional of scalars."""
        return Functional(tuple(replace(part, component=0) for part in self.parts if part.component == component))


@dataclass(frozen=True)
class Basis:
    """What a functional is made of: `basis(place)` is the value there of any polynomial of the space."""

    dimension: int
    components: int = 1

    def __call__(
        self,
        place: np.ndarray,
        derivative: Sequence[int] | None = None,
        component: int = 0,
        half: np.ndarray | None = None,
    ) -> Functional:
        """Return derivatives (of so much per axis) of a component at places (n, dimension), or their means over boxes.

        `half`: half widths of these boxes, (n, dimension), zero along axes without extent.
        """
        powers = tuple(derivative) if derivative is not None else (0,) * self.dimension
        if len(powers) != self.dimension or min(powers) < 0:
            raise InputError(
                f"the derivative {powers} does not fit {self.dimension} dimensions; give a number per axis"
            )
        if not 0 <= component < self.components:
            raise InputError(f"component {component} does not exist in a space of {self.components}; use 0 and up")
        return Functional((Part(place, half, powers, component, np.ones(1)),))

    def slope(self, place: np.ndarray, axis: int, component: int = 0, half: np.ndarray | None = None) -> Functional:
        """Return the first derivative along an axis."""
        return self(place, _unit(self.dimension, axis), component, half)

    def second(self, place: np.ndarray, a: int, b: int, component: int = 0) -> Functional:
        """Return the second derivative along two axes, or one twice."""
        along = np.add(_unit(self.dimension, a), _unit(self.dimension, b))
        return self(place, tuple(int(n) for n in along), component)

    def laplacian(self, place: np.ndarray, component: int = 0) -> Functional:
        """Return the sum of the second derivatives."""
        return sum((self.second(place, a, a, component) for a in range(self.dimension)), Functional())


def _unit(dimension: int, axis: int) -> tuple[int, ...]:
    return tuple(int(d == axis) for d in range(dimension))


Native = tuple[int, np.ndarray, np.ndarray, "np.ndarray | None", np.ndarray]


def stacked(rows: Sequence[Functional], dimension: int, origin: np.ndarray | None = None) -> Native:
    """Return rows of functionals as the native solver takes them: rows, terms, places, half widths, coefficients.

    Places are taken from `origin` (n, dimension) on, if that is given.
    """
    boxes: dict[tuple[int, int], tuple[np.ndarray, np.ndarray | None]] = {}
    parts = [(row, part) for row, functional in enumerate(rows) for part in functional.parts]
    for _, part in parts:
        boxes.setdefault((id(part.place), id(part.half)), (part.place, part.half))
    number = {key: n for n, key in enumerate(boxes)}
    parts.sort(key=lambda item: number[id(item[1].place), id(item[1].half)])
    arrays = [array for place, half in boxes.values() for array in (place, half) if array is not None]
    count = max([1, *(len(array) for array in arrays), *(len(part.coefficient) for _, part in parts)])
    if origin is not None and count > 1:
        count = len(origin)
    terms = np.zeros((len(parts), 6), dtype=np.int32)
    coefficients = np.empty((count, len(parts)))
    for n, (row, part) in enumerate(parts):
        terms[n, :3] = row, number[id(part.place), id(part.half)], part.component
        terms[n, 3 : 3 + dimension] = part.derivative
        coefficients[:, n] = part.coefficient
    places = np.empty((count, len(boxes), dimension))
    halves = np.zeros((count, len(boxes), dimension)) if any(half is not None for _, half in boxes.values()) else None
    for n, (place, half) in enumerate(boxes.values()):
        places[:, n] = place
        if half is not None and halves is not None:
            halves[:, n] = half
    return len(rows), terms, places, halves, coefficients

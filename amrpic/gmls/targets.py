"""Targets: what is wanted of the field, one or several numbers per target."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from ..errors import InputError
from .functionals import Basis, Functional
from .inputs import finite
from .shapes import Shapes
from .spaces import exponents

Rows = Callable[
    [Basis, np.ndarray, np.ndarray, int], Any
]  # (basis, place, targets, order) -> nested lists of functionals


@dataclass(frozen=True, eq=False)
class Wanted:
    """A quantity by name; at the targets, or at further places of each."""

    name: str
    rows: Rows
    of: str = "any"  # or "scalar", "vector": spaces that have it
    dimensions: tuple[int, ...] = (1, 2, 3)
    further: np.ndarray | None = None  # (n, k, dimension)
    shapes: Shapes | None = None  # one for each target

    def at(self, places: ArrayLike, name: str | None = None) -> Wanted:
        """Return the same at places (n, k, dimension), k for each target."""
        positions = finite(places, f"the places of {self.name}", 3)
        return replace(self, further=positions, name=name or self.name)

    def called(self, name: str) -> Wanted:
        """Return the same under another name."""
        return replace(self, name=name)

    @property
    def varies(self) -> bool:
        """Whether it is another functional for each target."""
        return self.further is not None or self.shapes is not None

    def functionals(self, basis: Basis, targets: np.ndarray, order: int) -> tuple[list[Functional], tuple[int, ...]]:
        """Return its rows, with places relative to the targets, and the shape of its value at one target."""
        kind = "vector" if basis.components > 1 else "scalar"
        if self.of not in ("any", kind):
            raise InputError(f"{self.name} of a {kind} was asked for; it exists for a {self.of} alone")
        if basis.dimension not in self.dimensions:
            raise InputError(f"{self.name} was asked for in {basis.dimension} dimensions; it needs {self.dimensions}")
        if self.further is None:
            nested: Any = self.rows(basis, np.zeros((1, basis.dimension)), targets, order)
        else:
            expected = (len(targets), self.further.shape[1], basis.dimension)
            if self.further.shape != expected:
                raise InputError(f"{self.name} is wanted at places of shape {self.further.shape}; give {expected}")
            offsets = self.further - targets[:, None]
            places = [np.ascontiguousarray(offsets[:, k]) for k in range(expected[1])]
            nested = [self.rows(basis, place, targets, order) for place in places]
        return _flat(nested), _shape(nested)


def _flat(nested: Any) -> list[Functional]:
    return [f for part in nested for f in _flat(part)] if isinstance(nested, list) else [nested]


def _shape(nested: Any) -> tuple[int, ...]:
    return (len(nested), *(_shape(nested[0]) if nested else ())) if isinstance(nested, list) else ()


def _each(basis: Basis, of_component: Callable[[int], Any]) -> Any:
    """What a scalar has, or a list of it for each component of a vector."""
    return [of_component(c) for c in range(basis.components)] if basis.components > 1 else of_component(0)


def _curl(basis: Basis, place: np.ndarray, *_: Any) -> Any:
    def part(a: int, b: int) -> Functional:
        return basis.slope(place, a, b) - basis.slope(place, b, a)

    return part(0, 1) if basis.dimension == 2 else [part(1, 2), part(2, 0), part(0, 1)]


def _curl_curl(basis: Basis, place: np.ndarray, *_: Any) -> Any:
    axes = range(basis.dimension)
    return [sum((basis.second(place, a, b, b) for b in axes), Functional()) - basis.laplacian(place, a) for a in axes]


def _divergence(basis: Basis, place: np.ndarray, *_: Any) -> Functional:
    return sum((basis.slope(place, a, a) for a in range(basis.dimension)), Functional())


def _coefficients(basis: Basis, place: np.ndarray, targets: np.ndarray, order: int) -> Any:
    def coefficient(e: np.ndarray, c: int) -> Functional:
        return basis(place, [int(n) for n in e], c) * (1 / math.prod(math.factorial(int(n)) for n in e))

    return _each(basis, lambda c: [coefficient(e, c) for e in exponents(basis.dimension, order)])


VALUE = Wanted("value", lambda basis, x, *_: _each(basis, lambda c: basis(x, component=c)))
GRADIENT = Wanted("gradient", lambda basis, x, *_: [basis.slope(x, a) for a in range(basis.dimension)], "scalar")
JACOBIAN = Wanted(
    "jacobian",
    lambda basis, x, *_: _each(basis, lambda c: [basis.slope(x, a, c) for a in range(basis.dimension)]),
    "vector",
)
HESSIAN = Wanted(
    "hessian",
    lambda basis, x, *_: [[basis.second(x, a, b) for b in range(basis.dimension)] for a in range(basis.dimension)],
    "scalar",
)
LAPLACIAN = Wanted("laplacian", lambda basis, x, *_: _each(basis, lambda c: basis.laplacian(x, c)))
DIVERGENCE = Wanted("divergence", _divergence, "vector")
CURL = Wanted("curl", _curl, "vector", (2, 3))
CURL_CURL = Wanted("curl_curl", _curl_curl, "vector", (2, 3))
COEFFICIENTS = Wanted("coefficients", _coefficients)


def Derivative(*powers: int) -> Wanted:
    """Return the derivative of a scalar, so many times along each axis: Derivative(1, 0, 1) is ∂²/∂x∂z."""
    name = "derivative_" + "".join(str(n) for n in powers)
    return Wanted(name, lambda basis, x, *_: basis(x, powers), "scalar", (len(powers),))


def Mean(shapes: Shapes) -> Wanted:
    """Return the mean over a shape for each target: of a scalar, or of each component of a vector."""
    return Wanted("mean", lambda basis, x, t, _: _each(basis, lambda c: (shapes - t).mean(basis, c)), shapes=shapes)


def Integral(shapes: Shapes) -> Wanted:
    """Return the integral over a shape for each target."""
    return Wanted(
        "integral",
        lambda basis, x, t, _: _each(basis, lambda c: (shapes - t).mean(basis, c) * shapes.measure),
        shapes=shapes,
    )


def MeanAlong(shapes: Shapes) -> Wanted:
    """Return the mean of a vector over a face along its normal, or over an edge along its tangent, for each target."""
    return Wanted("mean_along", lambda basis, x, t, _: (shapes - t).along(basis), "vector", shapes=shapes)


def MeanSlope(shapes: Shapes) -> Wanted:
    """Return the mean of a scalar's gradient over a face along its normal, or an edge's tangent, for each target."""
    return Wanted("mean_slope", lambda basis, x, t, _: (shapes - t).slope(basis), "scalar", shapes=shapes)


def Function(name: str, functional: Callable[[Basis, np.ndarray], Functional]) -> Wanted:
    """Return a target of one's own: `functional(basis, place)`, a sum of values `basis(place, derivative, component)`.

    `place` is relative to the target: (1, dimension) of zeros, or (n, dimension) with `at`.
    """
    return Wanted(name, lambda basis, x, *_: functional(basis, x))


# ---- data that are met exactly ----


@dataclass(frozen=True, eq=False)
class Exact:
    """A functional that holds exactly, with a datum for each target where `present`."""

    name: str
    row: Callable[[Basis, np.ndarray], Functional]  # of a basis and targets
    present: np.ndarray | None = None  # (n,) bool; none: everywhere


def ExactMean(shapes: Shapes) -> Exact:
    """Return that the mean over each target's shape, such as its own cell, is the datum."""
    return Exact("mean", lambda basis, t: (shapes - t).mean(basis))


def Dirichlet(places: ArrayLike) -> Exact:
    """Return that the value at a place for each target, (n, dimension), is the datum; rows of NaN: not there."""
    array = np.asarray(places, dtype=float)
    present = np.isfinite(array).all(axis=1)
    return Exact("dirichlet", lambda basis, t: basis(np.where(present[:, None], array, t) - t), present)


def Neumann(normals: ArrayLike, places: ArrayLike | None = None) -> Exact:
    """Return that the slope along normals (n, dimension) is the datum, at the targets or places; rows of NaN: not there."""
    array = np.asarray(normals, dtype=float)
    present = np.isfinite(array).all(axis=1)
    lengths = np.linalg.norm(np.where(present[:, None], array, 1.0), axis=1)
    if not (lengths > 0).all():
        raise InputError(f"normal {int(np.argmin(lengths))} is zero; give a direction, or NaN where there is none")
    units = np.where(present[:, None], array, 1.0) / lengths[:, None]

    def row(basis: Basis, targets: np.ndarray) -> Functional:
        at = np.zeros_like(targets) if places is None else finite(places, "the places", 2) - targets
        return sum((basis.slope(at, a) * units[:, a] for a in range(basis.dimension)), Functional())

    return Exact("neumann", row, present)


def names(wanted: Sequence[Wanted]) -> None:
    """InputError if two of the quantities have one name."""
    known_names: set[str] = set()
    for quantity in wanted:
        if quantity.name in known_names:
            raise InputError(f'two quantities are called "{quantity.name}"; give one another name with called("…")')
        known_names.add(quantity.name)

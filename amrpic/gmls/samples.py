"""Samples: what is known of a field near the targets, one number each, or one vector per site."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from ..errors import InputError
from .functionals import Basis, Functional
from .inputs import finite, points
from .shapes import Shapes


@dataclass(frozen=True, eq=False)
class Samples:
    """m samples; `functional` makes them of a polynomial, none: its values at the sites."""

    sites: np.ndarray  # (m, dimension): where they lie for weights and neighbours
    functional: Callable[[Basis], Functional] | None = None
    of: str = "scalar"  # or "vector": what they are samples of
    whole: bool = False  # all components at each site

    def __len__(self) -> int:
        return len(self.sites)


def Points(sites: ArrayLike) -> Samples:
    """Return values of a scalar at sites (m, dimension)."""
    return Samples(points(sites, "the sites"))


def Vectors(sites: ArrayLike) -> Samples:
    """Return vectors at sites (m, dimension): of `dimension` numbers each."""
    return Samples(points(sites, "the sites"), None, "vector", True)


def Components(sites: ArrayLike, directions: ArrayLike) -> Samples:
    """Return the components of a vector along directions (m, dimension), of any length but zero, at sites."""
    places, along = points(sites, "the sites"), finite(directions, "the directions", 2)
    if along.shape != places.shape:
        raise InputError(f"there are {places.shape} sites and {along.shape} directions; give one for each site")
    if not along.any(axis=1).all():
        raise InputError(
            f"direction {int(np.argmin(along.any(axis=1)))} is zero; give a direction or leave out its site"
        )
    return Samples(
        places,
        lambda basis: sum(
            (basis(places, component=c) * along[:, c] for c in range(basis.components)),
            Functional(),
        ),
        "vector",
    )


def WithLaplacian(sites: ArrayLike, widths: ArrayLike, kappa: float) -> Samples:
    """Return values plus kappa times the sum of widths² times second derivatives along the axes: p + κ h² Δp in cubes.

    So a solution of the mesh stands for a potential: 1/30 for charge deposited by cloud-in-cell, -1/120 for cell means.
    widths: (m, dimension), (m, 1) or one number, in m.
    """
    places = points(sites, "the sites")
    factors = np.broadcast_to(kappa * finite(widths, "the widths") ** 2, places.shape)
    return Samples(
        places,
        lambda basis: sum(
            (basis.second(places, a, a) * factors[:, a] for a in range(basis.dimension)),
            basis(places),
        ),
    )


def Differences(first: ArrayLike, second: ArrayLike) -> Samples:
    """Return differences of a scalar, second minus first, between points (m, dimension); they lie half-way.

    They do not see constants: only derivatives can be wanted of them. The staggered Laplacian is the divergence of a
    vector fitted to the same numbers: samples `Integrals(edges(first, second))`.
    """
    a, b = points(first, "the first points"), points(second, "the second points")
    if a.shape != b.shape:
        raise InputError(f"differences have {a.shape} first and {b.shape} second points; give as many of both")
    return Samples((a + b) / 2, lambda basis: basis(b) - basis(a))


def Means(shapes: Shapes) -> Samples:
    """Return means of a scalar over shapes."""
    return Samples(shapes.centre, lambda basis: shapes.mean(basis))


def Integrals(shapes: Shapes) -> Samples:
    """Return integrals over shapes: of a scalar, or of a vector along them where they are faces or edges."""
    if shapes.direction is None:
        return Samples(shapes.centre, lambda basis: shapes.mean(basis) * shapes.measure)
    return Samples(shapes.centre, lambda basis: shapes.along(basis) * shapes.measure, "vector")


def Along(shapes: Shapes) -> Samples:
    """Return means of a vector over faces along their normals, or over edges along their tangents."""
    shapes.directions()
    return Samples(shapes.centre, lambda basis: shapes.along(basis), "vector")


def Custom(sites: ArrayLike, functional: Callable[[Basis], Functional], of: str = "scalar") -> Samples:
    """Return samples of one's own: `functional(basis)` is a sum of values `basis(place, derivative, component, half)`.

    Places are (m, dimension), as the sites. `of`: "scalar" or "vector".
    """
    if of not in ("scalar", "vector"):
        raise InputError(f'samples of one\'s own are of "{of}"; use "scalar" or "vector"')
    return Samples(points(sites, "the sites"), functional, of)

"""Boxes, simplices and polygons over which polynomials are averaged: exactly, or by quadrature exact to order 4."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from ..errors import InputError
from .functionals import Basis, Functional
from .inputs import finite


@dataclass(frozen=True, eq=False)
class Shapes:
    """Cells, faces or edges, n of them: places, or small boxes, whose weighted values add up to the mean."""

    centre: np.ndarray  # (n, dimension)
    measure: np.ndarray  # (n,): length, area or volume
    direction: np.ndarray | None  # (n, dimension): unit normals of faces, unit tangents of edges
    places: tuple[np.ndarray, ...]  # (n, dimension) each
    weights: tuple[np.ndarray, ...]  # (n,) or (1,) each; their sum is 1
    half: np.ndarray | None = None  # half widths of boxes around the places

    def mean(self, basis: Basis, component: int = 0) -> Functional:
        """Return the mean of a component."""
        return self._sum(lambda place: basis(place, None, component, self.half))

    def along(self, basis: Basis) -> Functional:
        """Return the mean of a vector along the direction of each shape."""
        n = self.directions()
        return sum((self.mean(basis, c) * n[:, c] for c in range(basis.components)), Functional())

    def slope(self, basis: Basis) -> Functional:
        """Return the mean of a scalar's gradient along the direction of each shape."""
        n = self.directions()
        parts = [
            self._sum(lambda place, axis=axis: basis.slope(place, axis, 0, self.half)) * n[:, axis]
            for axis in range(basis.dimension)
        ]
        return sum(parts, Functional())

    def directions(self) -> np.ndarray:
        """Return the normals or tangents. InputError for shapes that have none."""
        if self.direction is None:
            raise InputError("these shapes have neither normals nor tangents; use faces or edges")
        return self.direction

    def _sum(self, functional) -> Functional:  # type: ignore[no-untyped-def]
        return sum((functional(place) * w for place, w in zip(self.places, self.weights, strict=True)), Functional())

    def __sub__(self, origin: np.ndarray) -> Shapes:
        """The shapes, seen from origins (n, dimension)."""
        if len(origin) != len(self.centre):
            raise InputError(f"there are {len(self.centre)} shapes for {len(origin)} targets; give one for each target")
        return Shapes(
            self.centre - origin,
            self.measure,
            self.direction,
            tuple(place - origin for place in self.places),
            self.weights,
            self.half,
        )


def boxes(centres: ArrayLike, widths: ArrayLike) -> Shapes:
    """Return boxes of widths (n, dimension), (dimension,) or one number around centres (n, dimension)."""
    places, wide = _centres_and_widths(centres, widths)
    if not (wide > 0).all():
        row = int(np.argmax(~(wide > 0).all(axis=1)))
        raise InputError(f"box {row} has widths {wide[row]}; all must be positive")
    return Shapes(places, wide.prod(axis=1), None, (places,), (np.ones(1),), wide / 2)


def box_faces(centres: ArrayLike, widths: ArrayLike, axis: int | ArrayLike) -> Shapes:
    """Return faces of boxes across an axis (one for all, or one each), by their own centres; widths along it are ignored."""
    places, wide = _centres_and_widths(centres, widths)
    across = np.broadcast_to(np.asarray(axis), len(places))
    if len(across) and not ((across >= 0) & (across < places.shape[1])).all():
        raise InputError(f"axis {across.min()} to {across.max()} of a face; use 0 to {places.shape[1] - 1}")
    normal = np.eye(places.shape[1])[across]
    return Shapes(
        places, np.where(normal > 0, 1.0, wide).prod(axis=1), normal, (places,), (np.ones(1),), wide / 2 * (1 - normal)
    )


def edges(start: ArrayLike, end: ArrayLike) -> Shapes:
    """Return straight edges between points (n, dimension), their tangents from start to end."""
    a, b = finite(start, "the starts of edges", 2), finite(end, "the ends of edges", 2)
    if a.shape != b.shape:
        raise InputError(f"edges have {a.shape} starts and {b.shape} ends; give as many of both")
    return _simplices(np.stack([a, b], axis=1), _unit_rows(b - a, "edge"))


def triangles(vertices: ArrayLike) -> Shapes:
    """Return triangles of vertices (n, 3, dimension), in three dimensions with normals by the right-hand rule."""
    return polygons(_vertices(vertices, 3))


def tetrahedra(vertices: ArrayLike) -> Shapes:
    """Return tetrahedra of vertices (n, 4, 3)."""
    return _simplices(_vertices(vertices, 4, 3), None)


def polygons(vertices: ArrayLike) -> Shapes:
    """Return plane polygons of vertices (n, k, dimension) in their order, convex or not, cut into triangles."""
    corners = finite(vertices, "the vertices of polygons", 3)
    n, k, dimension = corners.shape
    if dimension not in (2, 3) or k < 3:
        raise InputError(f"polygons have vertices of shape {corners.shape}; give (n, at least 3, 2 or 3)")
    fans = [_simplices(corners[:, [0, i, i + 1]], None) for i in range(1, k - 1)]
    legs = [(corners[:, i] - corners[:, 0], corners[:, i + 1] - corners[:, 0]) for i in range(1, k - 1)]
    if dimension == 2:  # with signs, so that parts outside of a polygon that is not convex cancel
        signed = np.array([a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0] for a, b in legs]) / 2
        normal, area = None, signed.sum(axis=0)
    else:
        vectors = np.array([np.cross(a, b) for a, b in legs]) / 2
        normal = _unit_rows(vectors.sum(axis=0), "polygon")
        signed = (vectors * normal).sum(axis=2)
        area = signed.sum(axis=0)
    if n and not (area != 0).all():
        raise InputError(f"polygon {int(np.argmax(area == 0))} has no area; leave it out")
    shares = signed / area
    return Shapes(
        sum((share[:, None] * fan.centre for share, fan in zip(shares, fans, strict=True)), np.zeros((n, dimension))),
        np.abs(area),
        normal,
        tuple(place for fan in fans for place in fan.places),
        tuple(share * w for share, fan in zip(shares, fans, strict=True) for w in fan.weights),
    )


def _simplices(vertices: np.ndarray, direction: np.ndarray | None) -> Shapes:
    """Edges, triangles or tetrahedra by Gauss points of the cube, collapsed to a corner; exact to order 4."""
    size = vertices.shape[1] - 1
    legs = vertices[:, 1:] - vertices[:, :1]
    # the cube's rule along axis d also meets the Jacobian, (1 - u)^(size - 1 - d)
    rules = [np.polynomial.legendre.leggauss((4 + size - 1 - d) // 2 + 1) for d in range(size)]
    places, weights = [], []
    for point in np.ndindex(*(len(nodes) for nodes, _ in rules)):
        left, weight, place = 1.0, 1.0, vertices[:, 0]
        for d, n in enumerate(point):
            u, w = (rules[d][0][n] + 1) / 2, rules[d][1][n] / 2
            weight *= w * (1 - u) ** (size - 1 - d) * (size - d)
            place = place + left * u * legs[:, d]
            left *= 1 - u
        places.append(place)
        weights.append(np.array([weight]))
    gram = np.linalg.det(legs @ legs.transpose(0, 2, 1)) if len(legs) else np.empty(0)
    factorial = (1, 1, 2, 6)[size]
    return Shapes(
        vertices.mean(axis=1), np.sqrt(np.maximum(gram, 0)) / factorial, direction, tuple(places), tuple(weights)
    )


def _centres_and_widths(centres: ArrayLike, widths: ArrayLike) -> tuple[np.ndarray, np.ndarray]:
    places = finite(centres, "the centres of boxes", 2)
    edges = finite(widths, "the widths of boxes")
    try:
        wide = np.broadcast_to(edges, places.shape)
    except ValueError:
        raise InputError(f"boxes have widths of shape {edges.shape} for centres {places.shape}; let them fit") from None
    return places, np.array(wide)


def _vertices(vertices: ArrayLike, corners: int, dimension: int | None = None) -> np.ndarray:
    points = finite(vertices, "vertices", 3)
    if points.shape[1] != corners or (dimension and points.shape[2] != dimension):
        raise InputError(f"vertices have shape {points.shape}; give (n, {corners}, {dimension or '2 or 3'})")
    return points


def _unit_rows(vectors: np.ndarray, name: str) -> np.ndarray:
    lengths = np.linalg.norm(vectors, axis=1)
    if not (lengths > 0).all():
        raise InputError(f"{name} {int(np.argmin(lengths))} has length or area zero; leave it out")
    return vectors / lengths[:, None]

"""Moving least squares written plainly, for one target at a time: dense matrices, SVD, quadrature with many points.

Shares no formula with the package: functionals of monomials are sums over points, null spaces are found by collocation.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import numpy as np
import scipy.linalg

Values = Callable[[np.ndarray], np.ndarray]  # places (n, d) -> (n, basis)

ROOTS: dict[str, Callable[[np.ndarray], np.ndarray]] = {
    "Power": lambda r: (1 - r) ** 2,
    "Gaussian": lambda r: np.exp(-4.5 * r**2),
    "CubicSpline": lambda r: 1 - 3 * r**2 + 2 * r**3,
    "CardinalSpline": lambda r: np.where(r < 0.5, 1 - 6 * r**2 + 6 * r**3, 2 * (1 - r) ** 3),
    "Cosine": lambda r: np.sin(np.pi / 2 * (1 - r)),
    "Sigmoid": lambda r: (1 + np.exp(-6)) / (1 + np.exp(6 * (2 * r - 1))),
}


@dataclass
class Monomials:
    """All monomials of some components in coordinates around a target."""

    dimension: int
    order: int
    components: int
    target: np.ndarray

    def __post_init__(self) -> None:
        powers = itertools.product(range(self.order + 1), repeat=self.dimension)
        scalar = [e for e in powers if sum(e) <= self.order]
        self.basis = [(c, e) for c in range(self.components) for e in scalar]
        self.powers, self.of_component = np.array([e for _, e in self.basis]), np.array([c for c, _ in self.basis])

    def derivative(self, places: np.ndarray, of: tuple[int, ...], component: int = 0) -> np.ndarray:
        """Values (places, basis) of a derivative of a component."""
        u = np.atleast_2d(places) - self.target
        powers, components = self.powers, self.of_component
        left = powers - np.array(of)
        kept = (components == component) & (left >= 0).all(axis=1)
        falling = np.array([[math.perm(k, r) for k in range(self.order + 1)] for r in of])[range(len(of)), powers]
        return falling.prod(axis=1) * kept * (u[:, None, :] ** np.maximum(left, 0)).prod(axis=2)

    def unit(self, *axes: int) -> tuple[int, ...]:
        return tuple(axes.count(d) for d in range(self.dimension))

    def value(self, places: np.ndarray, component: int = 0) -> np.ndarray:
        return self.derivative(places, self.unit(), component)

    def laplacian(self, places: np.ndarray, component: int = 0) -> np.ndarray:
        return np.sum([self.derivative(places, self.unit(d, d), component) for d in range(self.dimension)], axis=0)

    def null_space(self, operator: str) -> np.ndarray:
        """Coefficients, (basis, n), of polynomials that an operator maps to zero at many random places."""
        rng = np.random.default_rng(7)
        places = self.target + rng.uniform(-1, 1, (150, self.dimension))
        axes = range(self.dimension)
        if operator == "laplacian":
            rows = self.laplacian(places)
        elif operator == "divergence":
            rows = np.sum([self.derivative(places, self.unit(d), d) for d in axes], axis=0)
        else:
            rows = np.vstack(
                [
                    self.derivative(places, self.unit(a), b) - self.derivative(places, self.unit(b), a)
                    for a, b in itertools.combinations(axes, 2)
                ]
            )
        return scipy.linalg.null_space(np.linalg.qr(rows, mode="r"), rcond=1e-10)


@lru_cache
def _cube(dimension: int) -> tuple[np.ndarray, np.ndarray]:
    """Gauss points of the cube from -1/2 to 1/2, exact to degree 5, and weights that add up to 1."""
    nodes, weights = np.polynomial.legendre.leggauss(3)
    points = np.array(list(itertools.product(nodes / 2, repeat=dimension)))
    return points, np.prod(list(itertools.product(weights / 2, repeat=dimension)), axis=1)


@lru_cache
def _simplex(corners: int, cuts: int = 2) -> tuple[np.ndarray, np.ndarray]:
    """Barycentric coordinates and weights of Grundmann and Möller's rule, exact to degree 5."""
    size, degree = corners - 1, 2 * cuts + 1
    points, weights = [], []
    for i in range(cuts + 1):
        power = float(degree + size - 2 * i) ** degree
        factorials = math.factorial(i) * math.factorial(degree + size - i)
        weight = (-1) ** i * 2.0 ** (-2 * cuts) * power / factorials * math.factorial(size)
        for beta in itertools.product(range(cuts - i + 1), repeat=corners):
            if sum(beta) == cuts - i:
                points.append([(2 * k + 1) / (degree + size - 2 * i) for k in beta])
                weights.append(weight)
    return np.array(points), np.array(weights)


def box_mean(values: Values, centres: np.ndarray, widths: np.ndarray) -> np.ndarray:
    """Means, (n, basis), of what `values` gives at places, over boxes around centres (n, d)."""
    points, weights = _cube(centres.shape[1])
    return _mean(values, centres[:, None] + points * np.broadcast_to(widths, centres.shape)[:, None], weights)


def simplex_mean(values: Values, vertices: np.ndarray) -> np.ndarray:
    """The same over edges, triangles or tetrahedra of vertices (n, corners, d)."""
    points, weights = _simplex(vertices.shape[1])
    return _mean(values, np.einsum("qk,nkd->nqd", points, vertices), weights)


def _mean(values: Values, places: np.ndarray, weights: np.ndarray) -> np.ndarray:
    n, q, d = places.shape
    return np.einsum("nqb,q->nb", values(places.reshape(-1, d)).reshape(n, q, -1), weights)


def weights_by_svd(
    rows: np.ndarray, wanted: np.ndarray, roots: np.ndarray, exact: np.ndarray | None = None
) -> tuple[np.ndarray, Any]:
    """Weights (samples, wanted) of least Σ α²/w with rows.T α = wanted, and of exact rows, by SVD."""
    weighted = roots[:, None] * rows
    if exact is None:
        z = scipy.linalg.lstsq(weighted.T, wanted, cond=1e-11)[0]
        return roots[:, None] * z, None
    free = scipy.linalg.null_space(exact)
    z = scipy.linalg.lstsq(free.T @ weighted.T, free.T @ wanted, cond=1e-11)[0]
    alpha = roots[:, None] * z
    return alpha, scipy.linalg.lstsq(exact.T, wanted - rows.T @ alpha)[0]

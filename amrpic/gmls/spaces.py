"""Spaces of polynomials in one to three dimensions that a stencil reproduces."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from typing import ClassVar

import numpy as np

from .. import _native
from ..errors import InputError

ORDERS = (1, 2, 3, 4)


@dataclass(frozen=True)
class Space:
    """Polynomials of at most `order` (1 to 4). InputError for other orders."""

    order: int = 2
    vector: ClassVar[bool] = False
    operator: ClassVar[str | None] = None  # whose null space it is

    def __post_init__(self) -> None:
        if self.order not in ORDERS:
            raise InputError(f"the order of a space is {self.order}; use 1, 2, 3 or 4")

    def components(self, dimension: int) -> int:
        """Number of components of its polynomials. InputError for vectors in one dimension."""
        if self.vector and dimension == 1:
            raise InputError(f"{self} has no meaning in one dimension; use Scalar, or sites in two or three")
        return dimension if self.vector else 1

    def basis(self, dimension: int) -> np.ndarray:
        """Coefficients of the monomials of all components, (components * monomials, unknowns); (0, 0) for all of them."""
        if self.operator is None:
            return np.empty((0, 0))
        return _null_space(self.operator, dimension, self.order)

    def unknowns(self, dimension: int) -> int:
        """Number of its dimensions: as many independent samples determine a polynomial of it."""
        basis = self.basis(dimension)
        return basis.shape[1] or self.components(dimension) * len(exponents(dimension, self.order))


class Scalar(Space):
    """All scalar polynomials: 4, 10, 20, 35 unknowns in three dimensions for orders 1 to 4."""


class Harmonic(Space):
    """Scalar polynomials whose Laplacian is zero: (order + 1)² unknowns in three dimensions."""

    operator = "laplacian"


class Vector(Space):
    """All vector polynomials. Of whole vectors as samples each component is fitted by itself, with the same weights."""

    vector = True


class DivergenceFree(Space):
    """Vector polynomials without divergence: 11, 26, 50, 85 unknowns in three dimensions for orders 1 to 4."""

    vector = True
    operator = "divergence"


class CurlFree(Space):
    """Vector polynomials without curl: the gradients of scalar ones of the next order."""

    vector = True
    operator = "curl"


def exponents(dimension: int, order: int) -> np.ndarray:
    """Exponents of the monomials, (n, dimension), in the order of their coefficients."""
    return _native.gmls_exponents(dimension, order)


@lru_cache
def _null_space(operator: str, dimension: int, order: int) -> np.ndarray:
    """Orthonormal columns of coefficients that an operator maps to zero, found by SVD."""
    powers = exponents(dimension, order)
    number = {tuple(e): i for i, e in enumerate(powers)}
    slopes = []  # the matrix of each partial derivative
    for axis in range(dimension):
        slope = np.zeros((len(powers), len(powers)))
        for i, e in enumerate(powers):
            if e[axis] > 0:
                slope[number[tuple(e - np.eye(dimension, dtype=int)[axis])], i] = e[axis]
        slopes.append(slope)
    if operator == "laplacian":
        matrix = sum(slope @ slope for slope in slopes)
    elif operator == "divergence":
        matrix = np.hstack(slopes)
    else:
        rows = []
        for a in range(dimension):
            for b in range(a + 1, dimension):
                row = [np.zeros_like(slopes[0])] * dimension
                row[b], row[a] = slopes[a], -slopes[b]
                rows.append(np.hstack(row))
        matrix = np.vstack(rows)
    _, sizes, right = np.linalg.svd(matrix)
    rank = int((sizes > 1e-10 * sizes[0]).sum())
    return np.ascontiguousarray(right[rank:].T)

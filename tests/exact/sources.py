"""Charge whose potential and field are known in closed form or by quadrature. SI units.

Densities come as exact (or highly accurate) averages over cells, so that a mesh carries the total charge of its source
and an observed order is that of the solver alone.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np

from amrpic.units import VACUUM_PERMITTIVITY as EPS0
from amrpic.verify.known_charges import Array, Density, Vector, fill
from amrpic.verify.known_charges import ChargedSphere as Sphere
from amrpic.verify.known_charges import GaussianCharge as Gaussian

__all__ = ["EPS0", "Gaussian", "Layer", "Plummer", "Product", "Source", "Sphere", "Together", "Wave", "fill"]


class Source(Density, Protocol):
    """A density, and the potential (V) and field (V/m) that it makes."""

    def potential(self, x: Array, y: Array, z: Array) -> Array:
        """φ in V; arguments broadcast."""

    def field(self, x: Array, y: Array, z: Array) -> Vector:
        """E in V/m; arguments broadcast."""


@dataclass(frozen=True)
class Plummer:
    """Density falling as r⁻⁵ around a core: q/(4π ε₀ √(r² + a²)) is its potential."""

    core: float  # m
    centre: tuple[float, float, float] = (0.0, 0.0, 0.0)  # m
    charge: float = EPS0  # C

    def mean(self, x: Array, y: Array, z: Array) -> Array:
        """Gauss-Legendre, three points per axis."""
        nodes, weights = np.polynomial.legendre.leggauss(3)
        points = [(e[:-1, None] + np.diff(e)[:, None] * (nodes + 1) / 2).ravel() for e in (x, y, z)]
        r = self._softened(points[0][:, None, None], points[1][:, None], points[2])
        density = 3 * self.charge * self.core**2 / (4 * np.pi * r**5)
        density = density.reshape(len(x) - 1, 3, len(y) - 1, 3, len(z) - 1, 3)
        return np.einsum("iajbkc,a,b,c->ijk", density, weights / 2, weights / 2, weights / 2)

    def potential(self, x: Array, y: Array, z: Array) -> Array:
        return self.charge / (4 * np.pi * EPS0) / self._softened(x, y, z)

    def field(self, x: Array, y: Array, z: Array) -> Vector:
        over_radius = self.charge / (4 * np.pi * EPS0 * self._softened(x, y, z) ** 3)
        return tuple(over_radius * (s - c) for s, c in zip((x, y, z), self.centre, strict=True))  # type: ignore[return-value]

    def _softened(self, *x: Array) -> Array:
        """√(r² + a²)."""
        return np.sqrt(sum((s - c) ** 2 for s, c in zip(x, self.centre, strict=True)) + self.core**2)


@dataclass(frozen=True)
class Together:
    """The sum of several sources: trains, dipole pairs."""

    parts: tuple[Gaussian, ...]

    def density(self, x: Array, y: Array, z: Array) -> Array:
        return sum(part.density(x, y, z) for part in self.parts)  # type: ignore[return-value]

    def mean(self, x: Array, y: Array, z: Array) -> Array:
        return sum(part.mean(x, y, z) for part in self.parts)  # type: ignore[return-value]

    def potential(self, x: Array, y: Array, z: Array) -> Array:
        return sum(part.potential(x, y, z) for part in self.parts)  # type: ignore[return-value]

    def field(self, x: Array, y: Array, z: Array) -> Vector:
        fields = [part.field(x, y, z) for part in self.parts]
        return tuple(sum(f[d] for f in fields) for d in range(3))  # type: ignore[return-value]


class Factor(Protocol):
    """A function of one coordinate, its integral and its derivative."""

    def integral(self, s: Array) -> Array: ...
    def value(self, s: Array) -> Array: ...
    def slope(self, s: Array) -> Array: ...


@dataclass(frozen=True)
class Wave:
    """cos(k s + phase)."""

    k: float  # 1/m
    phase: float = 0.0

    def integral(self, s: Array) -> Array:
        return np.sin(self.k * s + self.phase) / self.k

    def value(self, s: Array) -> Array:
        return np.cos(self.k * s + self.phase)

    def slope(self, s: Array) -> Array:
        return -self.k * np.sin(self.k * s + self.phase)


@dataclass(frozen=True)
class Layer:
    """exp(−s/width): steep near s = 0."""

    width: float  # m

    def integral(self, s: Array) -> Array:
        return -self.width * np.exp(-s / self.width)

    def value(self, s: Array) -> Array:
        return np.exp(-s / self.width)

    def slope(self, s: Array) -> Array:
        return -np.exp(-s / self.width) / self.width


@dataclass(frozen=True)
class Product:
    """The manufactured potential f(x) g(y) h(z), in V, and the density that makes it."""

    factors: tuple[Factor, Factor, Factor]

    def mean(self, x: Array, y: Array, z: Array) -> Array:
        edge = (x, y, z)
        means = [np.diff(f.integral(e)) / np.diff(e) for f, e in zip(self.factors, edge, strict=True)]
        bends = [np.diff(f.slope(e)) / np.diff(e) for f, e in zip(self.factors, edge, strict=True)]
        laplacian = sum(
            np.einsum("i,j,k->ijk", *(bends[d] if d == axis else means[d] for d in range(3))) for axis in range(3)
        )
        return -EPS0 * laplacian

    def potential(self, x: Array, y: Array, z: Array) -> Array:
        f, g, h = self.factors
        return f.value(x) * g.value(y) * h.value(z)

    def field(self, x: Array, y: Array, z: Array) -> Vector:
        values = [f.value(s) for f, s in zip(self.factors, (x, y, z), strict=True)]
        slopes = [f.slope(s) for f, s in zip(self.factors, (x, y, z), strict=True)]
        f, g, h = values
        return -slopes[0] * g * h, -f * slopes[1] * h, -f * g * slopes[2]

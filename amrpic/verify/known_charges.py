"""Charge whose potential and field are known in closed form or by quadrature, and how far fields are from these. SI units.

Densities come as exact (or highly accurate) averages over cells, so that a mesh carries the total charge of its source
and an observed order is that of the solver alone.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from scipy.special import erf

from ..mesh.field import Field
from ..mesh.hierarchy import Hierarchy
from ..mpi import MPI
from ..units import VACUUM_PERMITTIVITY as EPS0

Array = np.ndarray
Vector = tuple[Array, Array, Array]


class Density(Protocol):
    """A charge density by its averages over cells."""

    def mean(self, x: Array, y: Array, z: Array) -> Array:
        """Mean density (C/m³) of the cells between edges x (nx + 1,), y and z; (nx, ny, nz)."""


def fill(density: Field, source: Density) -> Field:
    """Set every cell to the mean density of the source there; return the field."""
    for patch in density.patches:
        patch.data[...] = source.mean(*edges(patch.hierarchy, patch.level, patch.lower, patch.upper))
    return density


def edges(hierarchy: Hierarchy, level: int, lower: Sequence[int], upper: Sequence[int]) -> Vector:
    """Coordinates of the cell faces of a box along each axis, m."""
    spacing, origin = hierarchy.spacing(level), hierarchy.domain.lower
    return tuple(origin[d] + np.arange(lower[d], upper[d] + 2) * spacing[d] for d in range(3))


def _radius(centre: Sequence[float], *x: Array) -> Array:
    return np.sqrt(sum((a - c) ** 2 for a, c in zip(x, centre, strict=True)))


def _radial(centre: Sequence[float], over_radius: Array, *x: Array) -> Vector:
    """A radial field from its magnitude over the radius."""
    return tuple(over_radius * (a - c) for a, c in zip(x, centre, strict=True))  # type: ignore[return-value]


@dataclass(frozen=True)
class ChargedSphere:
    """Uniform density in a ball."""

    radius: float  # m
    centre: tuple[float, float, float] = (0.0, 0.0, 0.0)  # m
    charge: float = EPS0  # C

    def mean(self, x: Array, y: Array, z: Array) -> Array:
        """Chords along z, clipped to the cells and averaged over 16 x 16 lines per cell."""
        sub = (np.arange(16) + 0.5) / 16
        lines = [
            (e[:-1, None] + np.diff(e)[:, None] * sub - c).ravel() for e, c in zip((x, y), self.centre, strict=False)
        ]
        half = np.sqrt(np.maximum(self.radius**2 - lines[0][:, None] ** 2 - lines[1] ** 2, 0.0))[..., None]
        edge = z - self.centre[2]
        inside = np.diff(np.clip(edge, -half, half), axis=-1) / np.diff(z)
        share = inside.reshape(len(x) - 1, 16, len(y) - 1, 16, len(z) - 1).mean(axis=(1, 3))
        return self.charge / (4 / 3 * np.pi * self.radius**3) * share

    def potential(self, x: Array, y: Array, z: Array) -> Array:
        r, a = _radius(self.centre, x, y, z), self.radius
        inside = (3 - (r / a) ** 2) / (2 * a)
        return self.charge / (4 * np.pi * EPS0) * np.where(r < a, inside, 1 / np.maximum(r, a))

    def field(self, x: Array, y: Array, z: Array) -> Vector:
        r = np.maximum(_radius(self.centre, x, y, z), self.radius)
        return _radial(self.centre, self.charge / (4 * np.pi * EPS0 * r**3), x, y, z)


@dataclass(frozen=True)
class GaussianCharge:
    """Normal density along each axis.

    φ = Q/(2 π^{3/2} ε₀) ∫₀^∞ exp(−Σ x_i² t²/(1 + 2σ_i² t²)) / Π √(1 + 2σ_i² t²) dt, in closed form where it is round.
    """

    sigma: tuple[float, float, float]  # m
    centre: tuple[float, float, float] = (0.0, 0.0, 0.0)  # m
    charge: float = EPS0  # C

    def mean(self, x: Array, y: Array, z: Array) -> Array:
        shares = [
            np.diff(erf((e - c) / (np.sqrt(2) * s))) / (2 * np.diff(e))
            for e, c, s in zip((x, y, z), self.centre, self.sigma, strict=True)
        ]
        return self.charge * np.einsum("i,j,k->ijk", *shares)

    def density(self, x: Array, y: Array, z: Array) -> Array:
        """Density at points, C/m³."""
        exponent = sum(((a - c) / s) ** 2 / 2 for a, c, s in zip((x, y, z), self.centre, self.sigma, strict=True))
        return self.charge * np.exp(-exponent) / ((2 * np.pi) ** 1.5 * np.prod(self.sigma))

    @property
    def _round(self) -> bool:
        return len(set(self.sigma)) == 1

    def potential(self, x: Array, y: Array, z: Array) -> Array:
        if self._round:
            r = np.maximum(_radius(self.centre, x, y, z), 1e-12 * self.sigma[0])
            return self.charge / (4 * np.pi * EPS0) * erf(r / (np.sqrt(2) * self.sigma[0])) / r
        total: Array = np.zeros(())
        for t, weight, stretched in self._quadrature():
            total = total + weight * self._shape(t, stretched, x, y, z)
        return self.charge / (2 * np.pi**1.5 * EPS0) * total

    def field(self, x: Array, y: Array, z: Array) -> Vector:
        if self._round:
            s = self.sigma[0]
            r = np.maximum(_radius(self.centre, x, y, z), 1e-4 * s)
            slope = erf(r / (np.sqrt(2) * s)) / r**2 - np.sqrt(2 / np.pi) / (s * r) * np.exp(-(r**2) / (2 * s**2))
            return _radial(self.centre, self.charge / (4 * np.pi * EPS0) * slope / r, x, y, z)
        total = [0.0, 0.0, 0.0]
        for t, weight, stretched in self._quadrature():
            shape = weight * self._shape(t, stretched, x, y, z)
            total = [e + shape * 2 * t**2 / a**2 for e, a in zip(total, stretched, strict=True)]
        scale = self.charge / (2 * np.pi**1.5 * EPS0)
        return tuple(scale * e * (a - c) for e, a, c in zip(total, (x, y, z), self.centre, strict=True))

    def _quadrature(self) -> Iterator[tuple[float, float, Array]]:
        """Nodes t, weights, and √(1 + 2σ² t²): Gauss-Legendre in u, t = u/(1 − u)/σ, exact to about 1e-12."""
        nodes, weights = np.polynomial.legendre.leggauss(160)
        u, scale = (nodes + 1) / 2, 1 / max(self.sigma)
        for t, weight in zip(u / (1 - u) * scale, weights / 2 / (1 - u) ** 2 * scale, strict=True):
            yield float(t), float(weight), np.sqrt(1 + 2 * np.square(self.sigma) * t**2)

    def _shape(self, t: float, stretched: Array, *x: Array) -> Array:
        exponent = sum(((a - c) * t / s) ** 2 for a, c, s in zip(x, self.centre, stretched, strict=True))
        return np.exp(-exponent) / np.prod(stretched)


Exact = Callable[[np.ndarray, np.ndarray, np.ndarray], "np.ndarray | tuple[np.ndarray, ...]"]


def errors(fields: Sequence[Field], exact: Exact, offset: float = 0.0) -> tuple[float, float]:
    """The L2 error over the L2 norm of the exact field, and the largest error over the largest exact value. Collective.

    Several fields are the components of a vector, as `exact` then gives them. An `offset` is no error.
    """
    squares, largest = measured(fields, exact, offset)
    wrong, right = squares.sum(axis=0)
    return float(np.sqrt(wrong / right)), float(np.sqrt(largest[:, 0].max() / largest[:, 1].max()))


def measured(fields: Sequence[Field], exact: Exact, offset: float = 0.0) -> tuple[np.ndarray, np.ndarray]:
    """Per level (error, exact): volume integrals of the squares, and largest squares."""
    levels, comm = fields[0].hierarchy.levels, fields[0].comm
    squares, largest = np.zeros((levels, 2)), np.zeros((levels, 2))
    for i, patch in enumerate(fields[0].patches):
        use, volume = ~patch.covered, np.prod(patch.hierarchy.spacing(patch.level))
        expected = [np.broadcast_to(e, patch.data.shape)[use] for e in components(exact, patch.centres())]
        wrong = sum((f.patches[i].data[use] - offset - t) ** 2 for f, t in zip(fields, expected, strict=True))
        right = sum(t**2 for t in expected)
        squares[patch.level] += volume * np.array([np.sum(wrong), np.sum(right)])
        top = [np.max(wrong, initial=0.0), np.max(right, initial=0.0)]
        largest[patch.level] = np.maximum(largest[patch.level], top)
    comm.Allreduce(MPI.IN_PLACE, squares, op=MPI.SUM)
    comm.Allreduce(MPI.IN_PLACE, largest, op=MPI.MAX)
    return squares, largest


def components(exact: Exact, places: tuple[np.ndarray, ...]) -> tuple[np.ndarray, ...]:
    values = exact(*places)
    return values if isinstance(values, tuple) else (values,)

"""A Gaussian bunch between open faces, conducting and magnetic walls and periodic faces: exact density, potential and field."""

from __future__ import annotations

import functools
from collections.abc import Iterable, Iterator
from dataclasses import dataclass

import numpy as np
from scipy.special import erf, erfc

from amrpic.units import VACUUM_PERMITTIVITY as EPS0
from lattice_between_faces import SIGNS, Faces, background, quadrature

Array = np.ndarray


@dataclass(frozen=True)
class GaussianBetweenFaces:
    """A bunch of charge ε₀ in a box from 0 to `lengths`, with all its images; one face at least is open. SI units.

    The potential is the integral over time of three heat kernels, one per axis, and the density is their product at time 0:
    the charge as images add up, tails beyond a wall included. With `cut`, a lower wall beside an open face cuts the bunch off
    instead, and the density is not zero at the wall. Zero of φ is that of `LatticeBetweenFaces`.
    """

    boundary: Faces
    sigma: float  # m
    centre: tuple[float, float, float]  # m
    lengths: tuple[float, float, float] = (1.0, 1.0, 1.0)  # m
    cut: bool = False

    def mean(self, x: Array, y: Array, z: Array) -> Array:
        """Mean density in C/m³ of the cells between the edges x, y and z."""
        shares = [
            np.diff(of_axis.integral(edges)) / np.diff(edges)
            for of_axis, edges in zip(self._axes(), (x, y, z), strict=True)
        ]
        return EPS0 * np.einsum("i,j,k->ijk", *shares)

    def potential(self, x: Array, y: Array, z: Array) -> Array:
        """φ in V at all points of a grid: x (nx, 1, 1), y (1, ny, 1) and z (1, 1, nz)."""
        return self._summed((x, y, z)) - self._background()

    def field(self, x: Array, y: Array, z: Array) -> tuple[Array, Array, Array]:
        """E in V/m at all points of a grid."""
        ex, ey, ez = (-self._summed((x, y, z), slope_along=axis) for axis in range(3))
        return ex, ey, ez

    def at_points(self, x: Array, y: Array, z: Array) -> Array:
        """φ in V at points; arguments of one shape."""
        times, weights = self._times()
        kx, ky, kz = (
            of_axis.kernel(np.ravel(place)[:, None], times, slope=False)
            for of_axis, place in zip(self._axes(), (x, y, z), strict=True)
        )
        return (np.einsum("nt,nt,nt,t->n", kx, ky, kz, weights) - self._background()).reshape(np.shape(x))

    def _axes(self) -> list[Axis]:
        return [
            Axis(faces, self.sigma, centre, length, self.cut)
            for faces, centre, length in zip(self.boundary, self.centre, self.lengths, strict=True)
        ]

    def _times(self) -> tuple[Array, Array]:
        return quadrature(1e-6 * self.sigma**2, 64 * max(self.lengths) ** 2)

    def _summed(self, places: tuple[Array, Array, Array], slope_along: int | None = None) -> Array:
        times, weights = self._times()
        kx, ky, kz = (
            of_axis.kernel(np.ravel(place)[:, None], times, slope=axis == slope_along)
            for axis, (of_axis, place) in enumerate(zip(self._axes(), places, strict=True))
        )
        return np.tensordot(kx, np.einsum("yt,zt->yzt", ky, kz * weights), axes=(1, 2))

    def _background(self) -> float:
        charge = np.prod([of_axis.charge for of_axis in self._axes()])
        return float(charge) * background(self.boundary, np.array(self.lengths), *self._times())


@dataclass(frozen=True)
class Axis:
    """The bunch along one axis, and how it spreads in time."""

    faces: tuple[str, str]
    sigma: float
    centre: float
    length: float
    cut: bool

    def integral(self, x: Array) -> Array:
        """Of the density up to x, but for a constant."""
        if self._period:
            k = self._wave_numbers()
            damped = 2 / self._period * np.exp(-((k * self.sigma) ** 2) / 2) / k
            waves = sum(sign * np.sin(k * (x[:, None] - place)) for sign, place in self._images)
            return waves @ damped + self._mean * x
        images = [(1.0, self.centre)] if self._is_cut else self._images
        return sum(sign * erf((x - place) / (np.sqrt(2) * self.sigma)) / 2 for sign, place in images)

    @property
    def charge(self) -> float:
        """Of the bunch in the box, of the unit charge."""
        return float(erfc(-self.centre / (np.sqrt(2) * self.sigma)) / 2) if self._is_cut else 1.0

    def kernel(self, x: Array, times: Array, slope: bool) -> Array:
        """The density after these times, or its derivative, at places (n, 1): (n, times)."""
        variance = self.sigma**2 + 2 * times
        if self._is_cut:
            image = SIGNS[self.faces[0]] * self._half(-x, times, slope)
            return self._half(x, times, slope) + (-image if slope else image)
        if self._period:
            k = self._wave_numbers()
            damped = 2 / self._period * np.exp(-np.outer(k**2, variance) / 2)
            phases = [(sign, k * (x - place)) for sign, place in self._images]
            if slope:
                return total(-sign * k * np.sin(phase) for sign, phase in phases) @ damped
            return total(sign * np.cos(phase) for sign, phase in phases) @ damped + self._mean
        return total(
            sign * normal(x - place, variance) * (-(x - place) / variance if slope else 1.0)
            for sign, place in self._images
        )

    def _half(self, x: Array, times: Array, slope: bool) -> Array:
        """The part beyond x = 0, spread over all of the axis: a Gaussian times the part of another one."""
        variance = self.sigma**2 + 2 * times
        narrow = 2 * times * self.sigma**2 / variance
        middle = (2 * times * self.centre + self.sigma**2 * x) / variance
        wide, part = normal(x - self.centre, variance), erfc(-middle / np.sqrt(2 * narrow)) / 2
        if not slope:
            return wide * part
        return wide * (-(x - self.centre) / variance * part + normal(middle, narrow) * self.sigma**2 / variance)

    @property
    def _is_cut(self) -> bool:
        return self.cut and self.faces[0] in SIGNS and self.faces[1] == "open"

    @property
    def _period(self) -> float:
        """After which charge and images come again; 0: never."""
        if "open" in self.faces:
            return 0.0
        if "periodic" in self.faces:
            return self.length
        return self.length * (2 if self.faces[0] == self.faces[1] else 4)

    @property
    def _images(self) -> Iterator[tuple[float, float]]:
        """Signs and places of the bunch and its images in one period."""
        lower, upper = (SIGNS.get(face, 0) for face in self.faces)
        yield 1.0, self.centre
        if lower:
            yield lower, -self.centre
        if upper and not lower:
            yield upper, 2 * self.length - self.centre
        if lower * upper < 0:
            yield -1.0, self.centre - 2 * self.length
            yield -lower, -self.centre - 2 * self.length

    @property
    def _mean(self) -> float:
        return sum(sign for sign, _ in self._images) / self._period

    def _wave_numbers(self) -> Array:
        """Those that the bunch has: the next one is damped by exp(-40)."""
        return 2 * np.pi / self._period * np.arange(1, int(9 * self._period / (2 * np.pi * self.sigma)) + 2)


def total(terms: Iterable[Array]) -> Array:
    return functools.reduce(np.add, terms)


def normal(x: Array, variance: Array) -> Array:
    return np.exp(-(x**2) / (2 * variance)) / np.sqrt(2 * np.pi * variance)

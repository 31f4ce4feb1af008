"""Fields of charges in uniform motion along z, in closed form and by retarded times, and of their images in walls across.

It shares no code with the package.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np
from scipy.optimize import brentq
from scipy.special import erf

C = 299_792_458.0  # m/s
EPS0 = 8.8541878188e-12  # F/m
Array = np.ndarray


@dataclass(frozen=True)
class Ball:
    """Charge that is Gaussian and round in its own frame, with this rms size in m; a point for 0."""

    charge: float  # C
    place: float  # m, along z
    beta: float  # along z
    sigma: float = 0.0

    @property
    def gamma(self) -> float:
        return float(1 / np.sqrt(1 - self.beta**2))

    def density(self, x: Array, y: Array, z: Array) -> Array:
        """In the laboratory, C/m³."""
        square = x**2 + y**2 + (self.gamma * (z - self.place)) ** 2
        return self.charge * self.gamma * np.exp(-square / (2 * self.sigma**2)) / (2 * np.pi * self.sigma**2) ** 1.5

    def fields(self, points: Array) -> tuple[Array, Array]:
        """E (n, 3) in V/m and B (n, 3) in T in the laboratory at points (n, 3): those at rest, transformed."""
        at_rest = (points - (0, 0, self.place)) * (1, 1, self.gamma)
        r = np.linalg.norm(at_rest, axis=1)
        inside = self.charge * np.ones(len(r))
        if self.sigma > 0:
            s = r / (np.sqrt(2) * self.sigma)
            inside = self.charge * (erf(s) - 2 / np.sqrt(np.pi) * s * np.exp(-(s**2)))
        electric = at_rest * (inside / (4 * np.pi * EPS0 * r**3))[:, None] * (self.gamma, self.gamma, 1)
        return electric, np.cross((0, 0, self.beta), electric) / C


def mirrored(balls: list[Ball], wall: float, sign: int = -1) -> list[Ball]:
    """The images in a plane: of charge -q in a conductor, q in a magnetic wall (sign 1)."""
    return [replace(one, charge=sign * one.charge, place=2 * wall - one.place, beta=-one.beta) for one in balls]


def between(balls: list[Ball], length: float, reflections: int) -> list[Ball]:
    """The charges and their images in conductors at z = 0 and `length`, so many periods to both sides."""
    out = [*balls, *mirrored(balls, 0.0)]
    periods = range(-reflections, reflections + 1)
    return [replace(one, place=one.place + 2 * length * n) for n in periods for one in out]


def total(balls: list[Ball], points: Array) -> tuple[Array, Array]:
    """E and B of all of them."""
    fields = [one.fields(points) for one in balls]
    electric, magnetic = (np.sum([field[n] for field in fields], axis=0) for n in range(2))
    return electric, magnetic


def force(fields: tuple[Array, Array], beta: float) -> Array:
    """On a charge that moves along z, over the charge, V/m."""
    return fields[0] + C * np.cross((0, 0, beta), fields[1])


def retarded(charge: Ball, points: Array) -> Iterator[tuple[Array, Array]]:
    """E and B of a point charge at each point at time 0, from where it was when light left it (Liénard, Wiechert)."""
    velocity = np.array([0, 0, charge.beta])

    def place(light_way: float) -> Array:
        return np.array([0, 0, charge.place - charge.beta * light_way])

    for point in points:
        reach = (np.linalg.norm(point - place(0.0)) + 1e-9) / (1 - abs(charge.beta)) * 1.01

        def late(light_way: float, at: Array = point) -> float:
            return float(np.linalg.norm(at - place(light_way)) - light_way)

        way = brentq(late, 0.0, reach, xtol=1e-15, rtol=1e-15)
        towards = (point - place(way)) / way
        squeezed = (1 - towards @ velocity) ** 3
        electric = charge.charge / (4 * np.pi * EPS0) * (towards - velocity) / (charge.gamma**2 * squeezed * way**2)
        yield electric, np.cross(towards, electric) / C

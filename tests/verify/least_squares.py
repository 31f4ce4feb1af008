"""Least squares: orders on points, on surfaces and of Poisson's equation, and what lattices leave undetermined."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
from mpi4py import MPI

from amrpic import gmls
from amrpic.units import VACUUM_PERMITTIVITY
from amrpic.verify.table import Goal, Table

from . import between_meshes
from .lengths import in_brief

WANTED = (gmls.VALUE, gmls.GRADIENT, gmls.LAPLACIAN)
SIZES = (12, 16, 22, 30)  # points per axis
COUNTS = (1000, 2500, 6300, 16000)  # points of a surface
SURFACE = {2: (1.5, 1.8), 3: (1.9, 1.8), 4: (3.7, 3.8)}  # orders of Laplace-Beltrami and of Gaussian curvature
REACHES = (1.05, 1.2, 1.4, 1.6, 2.0)
AXES = np.array([1.0, 1.2, 0.8])  # of the ellipsoid
WALLS = (10, 15, 22, 38)  # points per axis, for Poisson's equation
FEW = (8, 11, 15), (11, 15, 20)  # in brief; with slopes everywhere
POISSON = {2: 1.8, 3: 1.8, 4: 3.5}  # its orders


def tables(comm: MPI.Comm) -> Iterator[Table]:
    """The tables of this topic. Collective."""
    if not in_brief():
        yield from _of_points()
    yield Table(
        "Least squares: orders on surfaces",
        "Order of the rms error from 1000 to 16000 points, tangent planes by principal axes, reach 1.7 times the distance of "
        "the n-th; f = xy + xyz.",
        (
            "surface",
            "order",
            "Laplace-Beltrami",
            "Gaussian curvature",
            "mean curvature",
            "error of the Gaussian, 16000 points",
        ),
        [
            _on_surface(name, axes, order)
            for name, axes in (("sphere", np.ones(3)), ("ellipsoid", AXES))
            for order in SURFACE
        ],
    )
    yield Table(
        "Least squares: Poisson's equation on points",
        "Order of the rms error of φ on a jittered lattice (±0.25 h) of 10³ to 38³ points in a cube, and of as many along the "
        "diameter of a ball with points on its surface. Potentials are given on the whole boundary, slopes in their place "
        "where its normal lies along x or z, or slopes everywhere, where φ is known up to a constant (orders lower by 0.3). "
        "φ = sin(3x + 0.3) exp(y) cos(2z); reach 1.6; GMRES to 1e-10.",
        ("domain", "slopes", "order", "order of φ", "iterations, 38³", "rms error, 38³"),
        [
            _poisson(comm, make, sloped, order)
            for make in (cube, ball)
            for sloped in ("nowhere", "on a part", "everywhere")
            for order in POISSON
        ],
    )
    if not in_brief():
        yield from between_meshes.tables(comm)


def _of_points() -> Iterator[Table]:
    yield Table(
        "Least squares: orders on scattered points",
        "Order of the rms error from 12³ to 30³ points of a jittered lattice (±0.25 h), reach twice the distance of the "
        "n-th; f = sin(3x + 0.3) exp(y) cos(2z) at 400 places of the middle.",
        ("order", "value", "gradient", "Laplacian", "error of the value, 30³"),
        [_orders(order) for order in (1, 2, 3, 4)],
    )
    yield Table(
        "Least squares: lattices",
        "All 12³ cells of a lattice, up to its corners: targets that no reach determined, the most growths of 15 % that a "
        "target needed, and the largest residual of reproduction.",
        ("order", "reach", "undetermined", "targets whose reach grew", "growths", "residual"),
        [_on_lattice(order, reach) for order in (1, 2, 3, 4) for reach in REACHES],
    )


def f(x: np.ndarray) -> np.ndarray:
    """A smooth function of places (n, 3)."""
    return np.sin(3 * x[:, 0] + 0.3) * np.exp(x[:, 1]) * np.cos(2 * x[:, 2])


def _orders(order: int) -> list[str | float | Goal]:
    t = np.random.default_rng(order).uniform(0.3, 0.7, (400, 3))
    exact = {"value": f(t), "gradient": slope_of_f(t), "laplacian": -12 * f(t)}
    errors = []
    for n in SIZES:
        x = jittered(n)
        near = gmls.nearby(x, t, order=order, reach=2.0)
        found = gmls.stencils(t, near, space=gmls.Scalar(order), samples=gmls.Points(x), wanted=WANTED).apply(f(x))
        errors.append([_rms(found[name] - exact[name]) for name in exact])
    value, gradient, laplacian = (-np.polyfit(np.log(SIZES), np.log(each), 1)[0] for each in zip(*errors, strict=True))
    second = Goal(laplacian, order - 1.2, least=True) if order > 1 else "–"
    return [order, Goal(value, order + 0.8, least=True), Goal(gradient, order - 0.2, least=True), second, errors[-1][0]]


def slope_of_f(x: np.ndarray) -> np.ndarray:
    """The gradient (n, 3) of f."""
    s, c = np.sin(3 * x[:, 0] + 0.3), np.cos(3 * x[:, 0] + 0.3)
    e, cz, sz = np.exp(x[:, 1]), np.cos(2 * x[:, 2]), np.sin(2 * x[:, 2])
    return np.stack([3 * c * e * cz, s * e * cz, -2 * s * e * sz], axis=1)


def jittered(n: int) -> np.ndarray:
    """Points (n³, 3) of a jittered lattice in the unit cube."""
    lattice = np.stack(np.meshgrid(*[np.arange(n) + 0.5] * 3, indexing="ij"), axis=-1).reshape(-1, 3)
    return (lattice + np.random.default_rng(1).uniform(-0.25, 0.25, lattice.shape)) / n


def _on_surface(name: str, axes: np.ndarray, order: int) -> list[str | float | Goal]:
    errors = []
    for count in COUNTS:
        x = fibonacci(count) * axes
        t = x[:: count // 1000]
        nth = gmls.nearby(x, t, radius=np.sqrt(8 * np.pi * gmls.Scalar(order).unknowns(2) / count))
        found = gmls.surface(t, x, nth, order=order)
        values = found.stencils.apply(x[:, 0] * x[:, 1] * (1 + x[:, 2]))["laplace_beltrami"]
        wrong = (
            values - laplace_beltrami(t, axes),
            found.gaussian_curvature - gaussian_curvature(t, axes),
            np.abs(found.mean_curvature) - mean_curvature(t, axes),
        )
        errors.append([_rms(error) for error in wrong])
    slopes = (-2 * np.polyfit(np.log(COUNTS), np.log(e), 1)[0] for e in zip(*errors, strict=True))
    less, (of_value, of_curvature) = 0.2 * (name != "sphere"), SURFACE[order]
    least = (of_value, of_curvature, of_curvature)
    goals = [Goal(slope, bound - less, least=True) for slope, bound in zip(slopes, least, strict=True)]
    return [name, order, *goals, errors[-1][1]]


def fibonacci(count: int) -> np.ndarray:
    """Points (count, 3) of about equal density on the unit sphere."""
    k = np.arange(count) + 0.5
    z, turn = 1 - 2 * k / count, np.pi * (1 + 5**0.5) * k
    r = np.sqrt(1 - z**2)
    return np.stack([r * np.cos(turn), r * np.sin(turn), z], axis=1)


def laplace_beltrami(x: np.ndarray, axes: np.ndarray) -> np.ndarray:
    """Of xy + xyz on the ellipsoid Σ x²/a² = 1: Δf - 2 H n·∇f - n·(∇∇f) n, where Δf = 0."""
    g = x / axes**2
    size = np.linalg.norm(g, axis=1)
    n = g / size[:, None]
    two_h = ((1 / axes**2).sum() - (n**2 / axes**2).sum(axis=1)) / size
    gradient = np.stack([x[:, 1] * (1 + x[:, 2]), x[:, 0] * (1 + x[:, 2]), x[:, 0] * x[:, 1]], axis=1)
    mixed = n[:, 0] * n[:, 1] * (1 + x[:, 2]) + n[:, 0] * n[:, 2] * x[:, 1] + n[:, 1] * n[:, 2] * x[:, 0]
    return -two_h * (n * gradient).sum(axis=1) - 2 * mixed


def gaussian_curvature(x: np.ndarray, axes: np.ndarray) -> np.ndarray:
    """Of the ellipsoid Σ x²/a² = 1."""
    return 1 / (axes.prod() ** 2 * (x**2 / axes**4).sum(axis=1) ** 2)


def mean_curvature(x: np.ndarray, axes: np.ndarray) -> np.ndarray:
    """Of the ellipsoid Σ x²/a² = 1."""
    size = np.linalg.norm(x / axes**2, axis=1)
    return ((axes**2).sum() - (x**2).sum(axis=1)) / (2 * axes.prod() ** 2 * size**3)


def _on_lattice(order: int, reach: float) -> list[float | Goal]:
    x = np.stack(np.meshgrid(*[np.arange(12) + 0.5] * 3, indexing="ij"), axis=-1).reshape(-1, 3)
    near = gmls.nearby(x, x, order=order, reach=reach)
    found = gmls.stencils(x, near, space=gmls.Scalar(order), samples=gmls.Points(x), wanted=WANTED, failed="mark")
    grown = found.quality.growth
    return [
        order,
        reach,
        Goal(found.quality.failed.size, 0),
        int((grown > 0).sum()),
        Goal(int(grown.max()), 5),
        Goal(float(found.quality.residual.max()), 1e-9),
    ]


def _rms(error: np.ndarray) -> float:
    return float(np.sqrt(np.mean(error**2)))


# ---- Poisson's equation ----


@dataclass(frozen=True, eq=False)
class Cloud:
    """Points of a domain with those of its boundary and their outward normals; the potential is f."""

    sites: np.ndarray
    normals: np.ndarray  # (n, 3), zero inside

    @property
    def rho(self) -> np.ndarray:
        return 12 * VACUUM_PERMITTIVITY * f(self.sites)

    def potential(self, places: np.ndarray) -> np.ndarray:
        return f(places)

    def walls(self, sloped: str) -> dict[str, Any]:
        """What `gmls.poisson` takes: slopes "nowhere", "everywhere", or "on a part" of the boundary."""
        boundary = np.abs(self.normals).max(axis=1) > 0
        along = np.abs(self.normals)
        part = {
            "nowhere": np.zeros(len(boundary), bool),
            "everywhere": boundary,
            "on a part": boundary & (along[:, 1] < 0.5),
        }
        slopes, values = np.flatnonzero(part[sloped]), np.flatnonzero(boundary & ~part[sloped])
        given = (slope_of_f(self.sites[slopes]) * self.normals[slopes]).sum(axis=1)
        return {
            "dirichlet": (values, f(self.sites[values])) if len(values) else None,
            "neumann": (slopes, self.normals[slopes], given) if len(slopes) else None,
        }


def cube(n: int) -> Cloud:
    """A jittered lattice with n points along each edge of the unit cube, those of its faces in their places."""
    lattice = np.stack(np.meshgrid(*[np.arange(n)] * 3, indexing="ij"), axis=-1).reshape(-1, 3)
    normals = (lattice == n - 1).astype(float) - (lattice == 0)
    inside = ~normals.any(axis=1)
    shift = np.random.default_rng(1).uniform(-0.25, 0.25, lattice.shape)
    normals[~inside] /= np.linalg.norm(normals[~inside], axis=1, keepdims=True)
    return Cloud((lattice + inside[:, None] * shift) / (n - 1), normals)


def ball(n: int) -> Cloud:
    """The points of a jittered lattice of n points along the diameter inside a unit ball, and Fibonacci's on its surface."""
    h = 2 / (n - 1)
    inside = 2 * cube(n).sites - 1
    inside = inside[np.linalg.norm(inside, axis=1) < 1 - 0.5 * h]
    surface = fibonacci(round(4 * np.pi / h**2))
    return Cloud(np.concatenate([surface, inside]), np.concatenate([surface, np.zeros_like(inside)]))


@dataclass(frozen=True)
class PoissonError:
    rms: float
    iterations: int


def error_on(comm: MPI.Comm, cloud: Cloud, sloped: str, order: int) -> PoissonError:
    """The error of the potential. Collective."""
    found = gmls.poisson(comm, cloud.sites, cloud.rho, order=order, **cloud.walls(sloped))
    error = found.phi - f(cloud.sites)
    return PoissonError(_rms(error - error.mean() if sloped == "everywhere" else error), found.iterations)


def _poisson(comm: MPI.Comm, make: Callable[[int], Cloud], sloped: str, order: int) -> list[str | float | Goal]:
    sizes = FEW[sloped == "everywhere"] if in_brief() else WALLS
    errors = [error_on(comm, make(n), sloped, order) for n in sizes]
    slope = float(-np.polyfit(np.log(sizes), np.log([e.rms for e in errors]), 1)[0])
    least = POISSON[order] - (0.3 if sloped == "everywhere" else 0.0)
    at_most = Goal(max(e.iterations for e in errors), 40)
    return [make.__name__, sloped, order, Goal(slope, least, least=True), at_most, errors[-1].rms]

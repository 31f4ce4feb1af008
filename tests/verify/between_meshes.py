"""Fields between meshes and at points, by least squares: orders, integrals, bounds."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np
from mpi4py import MPI

from amrpic.mesh.domain import Domain
from amrpic.mesh.field import Field
from amrpic.mesh.hierarchy import Hierarchy
from amrpic.verify.table import Goal, Table
from exact.errors import observed_order

SIZES = (16, 24, 32, 40)  # base cells per axis
POINTS = 2000


def tables(comm: MPI.Comm) -> Iterator[Table]:
    """The tables of fields between meshes. Collective."""
    yield Table(
        "Least squares: fields between meshes",
        "Means over cells of sin(3x + 0.3) exp(y) cos(2z) in the unit cube, from a mesh of n³ cells with half of it refined "
        "along each axis, n = 16 to 40, to the same base refined from the corner on, and to (5n/4)³ cells refined there. "
        "Order of the largest error, walls included, and the largest relative change of the integral. With bounds: the "
        "same function for x < 3/4, zero behind; the order where x < 1/2 and no cell within two of a wall, and by how "
        "much any value is outside of the range of the field before; bounds are that range, or those of neighbours.",
        ("to", "order", "bounds", "order of the error", "change of the integral", "outside of bounds", "error, n = 40"),
        [
            *(_carried(comm, base, order) for base in (False, True) for order in (2, 3, 4)),
            *(_bounded(comm, order, bounds) for order in (3, 4) for bounds in ("neighbours", "range")),
        ],
    )
    yield Table(
        "Least squares: fields at points",
        f"`Field.sample` on the same meshes with a third level in the corner of walls, at {POINTS} places, half of them beside "
        "faces of the levels, the same function at cell centres: orders of the rms error, of the largest error of values, "
        "and the largest error for a cubic on n = 16.",
        ("order", "values, rms", "values, largest", "gradients, rms", "largest error, n = 40", "error for a cubic"),
        [_sampled(comm, order) for order in (2, 3, 4)],
    )


def _mesh(comm: MPI.Comm, n: int, first: float, levels: int = 1) -> Hierarchy:
    """A base of n³ cells of the unit cube, half of it refined along each axis from `first` on, a quarter at the far corner."""
    low = round(2 * n * first)
    boxes = [[((low,) * 3, (low + n - 1,) * 3)]]
    if levels == 2:
        boxes = [[((n,) * 3, (2 * n - 1,) * 3)], [((3 * n,) * 3, (4 * n - 1,) * 3)]]
    return Hierarchy(comm, Domain(0, 1, n, "dirichlet"), boxes, 24, 2)


def _means(hierarchy: Hierarchy, ends: float = np.inf) -> Field:
    """The means over cells, zero behind x = `ends`."""
    out = Field(hierarchy)
    for patch in out.patches:
        x, y, z = patch.centres()
        a = hierarchy.spacing(patch.level) / 2
        along_x, along_y = np.sin(3 * x + 0.3) * _sinc(3 * a[0]), np.exp(y) * np.sinh(a[1]) / a[1]
        patch.data[...] = np.where(x < ends, along_x * along_y * np.cos(2 * z) * _sinc(2 * a[2]), 0.0)
    return out


def _sinc(x: float) -> float:
    return float(np.sinc(x / np.pi))


def _carried(comm: MPI.Comm, other_base: bool, order: int) -> Sequence[str | float | Goal]:
    errors, changes = [], []
    for n in SIZES:
        field = _means(_mesh(comm, n, 0.25))
        to = _mesh(comm, 5 * n // 4 if other_base else n, 0.0)
        found = field.remap(to, order)
        errors.append((found - _means(to)).max_abs())
        changes.append(abs(found.integral() / field.integral() - 1))
    goal = Goal(observed_order(SIZES, errors), order + 0.8, least=True)
    where = "another base" if other_base else "the same base"
    return [where, order, "none", goal, Goal(max(changes), 1e-14), "", errors[-1]]


def _bounded(comm: MPI.Comm, order: int, bounds: str) -> Sequence[str | float | Goal]:
    errors, changes, outside = [], [], []
    for n in SIZES:
        field = _means(_mesh(comm, n, 0.25), 0.75)
        to = _mesh(comm, 5 * n // 4, 0.0)
        least, most = field.min(), field.max()
        found = field.remap(to, order, bounds if bounds == "neighbours" else (least, most))
        errors.append(_largest_within(found - _means(to, 0.75)))
        changes.append(abs(found.integral() / field.integral() - 1))
        outside.append(max(least - found.min(), found.max() - most, 0.0))
    goal = Goal(observed_order(SIZES, errors), order + 0.8, least=True)
    return ["another base", order, bounds, goal, Goal(max(changes), 1e-14), Goal(max(outside), 0.0), errors[-1]]


def _largest_within(error: Field) -> float:
    """Largest error where x < 1/2, two base cells and more from walls. Collective."""
    h = error.hierarchy.spacing(0)
    inside = Field(error.hierarchy).fill(
        lambda x, y, z: (
            (np.abs(x - 0.25) < 0.25 - 2 * h[0])
            & (np.abs(y - 0.5) < 0.5 - 2 * h[1])
            & (np.abs(z - 0.5) < 0.5 - 2 * h[2])
        )
    )
    return (error * inside).max_abs()


def _f(x: np.ndarray, y: np.ndarray, z: np.ndarray) -> np.ndarray:
    return np.sin(3 * x + 0.3) * np.exp(y) * np.cos(2 * z)


def _slope_of_f(x: np.ndarray, y: np.ndarray, z: np.ndarray) -> np.ndarray:
    s, c, e = np.sin(3 * x + 0.3), np.cos(3 * x + 0.3), np.exp(y)
    return np.stack([3 * c * e * np.cos(2 * z), s * e * np.cos(2 * z), -2 * s * e * np.sin(2 * z)], axis=-1)


def _cubic(x: np.ndarray, y: np.ndarray, z: np.ndarray) -> np.ndarray:
    return 1 + x - 2 * y * z + 3 * x**3 - y**2 * z + x * y * z


def _sampled(comm: MPI.Comm, order: int) -> Sequence[float | Goal]:
    rng = np.random.default_rng(1)
    at = rng.uniform(size=(POINTS, 3))
    at[::4, 0], at[2::4, 1] = rng.normal(0.5, 0.02, POINTS // 4), rng.normal(0.75, 0.01, POINTS // 4)
    values, largest, gradients = [], [], []
    for n in SIZES:
        field = Field(_mesh(comm, n, 0.5, levels=2)).fill(_f)
        apart = field.sample(at, order) - _f(*at.T)
        values.append(_rms(apart))
        largest.append(float(np.abs(apart).max()))
        gradients.append(_rms(field.sample(at, order, "gradient") - _slope_of_f(*at.T)))
    cubic = Field(_mesh(comm, SIZES[0], 0.5, levels=2)).fill(_cubic)
    error = float(np.abs(cubic.sample(at, order) - _cubic(*at.T)).max())
    of_largest = observed_order(SIZES, largest)
    return [
        order,
        Goal(observed_order(SIZES, values), order + 0.8, least=True),
        Goal(of_largest, 3.8, least=True) if order == 3 else of_largest,
        Goal(observed_order(SIZES, gradients), order - 0.2, least=True),
        largest[-1],
        Goal(error, 1e-12) if order >= 3 else error,
    ]


def _rms(error: np.ndarray) -> float:
    return float(np.sqrt(np.mean(error**2)))

"""Bodies beside functions that say by themselves which points lie in them: a second derivation of each shape."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from matplotlib.path import Path

from amrpic import shapes

Contains = Callable[[np.ndarray], Any]  # (n, 3) points: booleans

PROFILE = ((-0.5, 0.1), (0.5, 0.1), (0.5, 0.4), (0.2, 0.4), (0.2, 0.2), (-0.3, 0.3))


def ellipsoid(x, y, z):
    return (x / 0.4) ** 2 + (y / 0.5) ** 2 + (z / 0.6) ** 2 - 1


def beside_axis(points, base, axis):
    """Return heights along an axis and distances from it."""
    unit = np.array(axis) / np.linalg.norm(axis)
    offset = points - np.array(base)
    height = offset @ unit
    return height, np.linalg.norm(offset - height[:, None] * unit, axis=1)


def in_cone(start, end, radius_start, radius_end) -> Contains:
    def contains(points):
        height, distance = beside_axis(points, start, np.subtract(end, start))
        share = height / np.linalg.norm(np.subtract(end, start))
        return (share >= 0) & (share <= 1) & (distance <= radius_start + (radius_end - radius_start) * share)

    return contains


def in_torus(centre, axis, radius, tube) -> Contains:
    def contains(points):
        height, distance = beside_axis(points, centre, axis)
        return np.hypot(distance - radius, height) <= tube

    return contains


def in_profile(points):
    height, distance = beside_axis(points, (0, 0, 0), (0, 0, 1))
    return Path(PROFILE).contains_points(np.column_stack([height, distance]))


START, END = (-0.3, -0.2, -0.4), (0.4, 0.3, 0.1)
# Name -> body, and what lies in it. None reaches beyond 0.8 m, except the half space.
BODIES: dict[str, tuple[shapes.Shape, Contains]] = {
    "sphere": (shapes.Sphere((0.1, 0.2, -0.1), 0.5), lambda p: ((p - (0.1, 0.2, -0.1)) ** 2).sum(axis=1) <= 0.25),
    "box": (
        shapes.Box((-0.3, -0.4, -0.2), (0.5, 0.1, 0.6)),
        lambda p: ((p >= (-0.3, -0.4, -0.2)) & (p <= (0.5, 0.1, 0.6))).all(axis=1),
    ),
    "cylinder": (shapes.Cylinder(START, END, 0.25), in_cone(START, END, 0.25, 0.25)),
    "upright cylinder": (
        shapes.Cylinder((0, 0, -0.4), (0, 0, 0.4), 0.25),
        in_cone((0, 0, -0.4), (0, 0, 0.4), 0.25, 0.25),
    ),
    "cone": (shapes.Cone(START, END, 0.3, 0.1), in_cone(START, END, 0.3, 0.1)),
    "cone with a tip": (shapes.Cone((0, 0, -0.4), (0, 0, 0.4), 0, 0.4), in_cone((0, 0, -0.4), (0, 0, 0.4), 0, 0.4)),
    "torus": (shapes.Torus((0, 0.1, 0), (1, 2, 3), 0.45, 0.2), in_torus((0, 0.1, 0), (1, 2, 3), 0.45, 0.2)),
    "thin torus": (shapes.Torus((0, 0, 0), (0, 0, 1), 0.6, 0.01), in_torus((0, 0, 0), (0, 0, 1), 0.6, 0.01)),
    "half space": (shapes.Plane((0, 0, 0.1), (1, 1, 0)), lambda p: p[:, 0] + p[:, 1] <= 0),
    "profile": (shapes.Revolved(PROFILE), in_profile),
    "level set": (shapes.LevelSet(ellipsoid, (-0.7,) * 3, (0.7,) * 3), lambda p: ellipsoid(*p.T) <= 0),
}
VOLUMES = {
    "sphere": np.pi / 6,
    "box": 0.8 * 0.5 * 0.8,
    "cylinder": np.pi * 0.25**2 * np.sqrt(0.99),
    "upright cylinder": np.pi * 0.25**2 * 0.8,
    "cone": np.pi / 3 * np.sqrt(0.99) * (0.3**2 + 0.3 * 0.1 + 0.1**2),
    "cone with a tip": np.pi / 3 * 0.8 * 0.4**2,
    "torus": 2 * np.pi**2 * 0.45 * 0.2**2,
    "thin torus": 2 * np.pi**2 * 0.6 * 0.01**2,
    "level set": 4 / 3 * np.pi * 0.4 * 0.5 * 0.6,
}
SURFACES = {
    "sphere": np.pi,
    "box": 2 * (0.8 * 0.5 + 0.5 * 0.8 + 0.8 * 0.8),
    "cylinder": 2 * np.pi * 0.25 * (0.25 + np.sqrt(0.99)),
    "upright cylinder": 2 * np.pi * 0.25 * (0.25 + 0.8),
    "cone": np.pi * (0.3**2 + 0.1**2 + 0.4 * np.sqrt(0.99 + 0.2**2)),
    "cone with a tip": np.pi * 0.4 * (0.4 + np.hypot(0.8, 0.4)),
    "torus": 4 * np.pi**2 * 0.45 * 0.2,
    "thin torus": 4 * np.pi**2 * 0.6 * 0.01,
}


def random_rotation(rng: np.random.Generator) -> tuple[np.ndarray, float]:
    """Return an axis and an angle."""
    return rng.normal(size=3), float(rng.uniform(0, 6))

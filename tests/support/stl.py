"""Surfaces of triangles, (n, 3, 3), and STL files of them."""

from __future__ import annotations

from pathlib import Path

import numpy as np


def sphere(rings: int, radius: float = 1.0) -> np.ndarray:
    """Return a sphere whose corners lie on it: `rings` from pole to pole, twice as many around."""
    theta = np.linspace(0, np.pi, rings + 1)[:, None]
    phi = np.linspace(0, 2 * np.pi, 2 * rings, endpoint=False)
    points = radius * np.stack(
        [
            np.sin(theta) * np.cos(phi),
            np.sin(theta) * np.sin(phi),
            np.broadcast_to(np.cos(theta), (rings + 1, len(phi))),
        ],
        axis=-1,
    )
    points[0], points[-1] = (0, 0, radius), (0, 0, -radius)
    a, b = points[:-1], points[1:]
    quads = np.stack([a, b, np.roll(b, -1, axis=1), np.roll(a, -1, axis=1)], axis=2).reshape(-1, 4, 3)
    triangles = np.concatenate([quads[:, [0, 1, 2]], quads[:, [0, 2, 3]]])
    edges = np.linalg.norm(triangles - np.roll(triangles, 1, axis=1), axis=2)
    return triangles[edges.min(axis=1) > 1e-12]


def box(lower=(-1.0, -1.0, -1.0), upper=(1.0, 1.0, 1.0)) -> np.ndarray:
    """Return the twelve triangles of a box."""
    faces = []
    for axis in range(3):
        for side in (0, 1):
            square = np.array([(0, 0), (1, 0), (1, 1), (0, 1)])
            corners = np.empty((4, 3))
            corners[:, axis], corners[:, (axis + 1) % 3], corners[:, (axis + 2) % 3] = side, square[:, 0], square[:, 1]
            if not side:
                corners = corners[::-1]
            faces += [corners[[0, 1, 2]], corners[[0, 2, 3]]]
    return np.array(lower) + np.array(faces) * np.subtract(upper, lower)


def write_binary(path: Path, triangles: np.ndarray) -> Path:
    """Write a binary STL file."""
    records = np.zeros(len(triangles), [("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("attribute", "<u2")])
    records["corners"] = triangles
    path.write_bytes(b"made by a test".ljust(80) + len(triangles).to_bytes(4, "little") + records.tobytes())
    return path


def write_text(path: Path, triangles: np.ndarray) -> Path:
    """Write an STL file of text."""
    lines = ["solid body"]
    for corners in triangles:
        lines += ["facet normal 0 0 0", "outer loop"]
        lines += [f"  vertex {x:.9g} {y:.9g} {z:.9g}" for x, y, z in corners]
        lines += ["endloop", "endfacet"]
    path.write_text("\n".join([*lines, "endsolid body", ""]))
    return path


def torus(around: int, radius: float = 0.7, tube: float = 0.25) -> np.ndarray:
    """Return a torus about z whose corners lie on it."""
    phi = np.linspace(0, 2 * np.pi, around, endpoint=False)[:, None]
    psi = np.linspace(0, 2 * np.pi, around // 2, endpoint=False)
    distance = radius + tube * np.cos(psi)
    points = np.stack([distance * np.cos(phi), distance * np.sin(phi), tube * np.sin(psi) + 0 * phi], axis=-1)
    beside = np.roll(points, -1, axis=0)
    quads = np.stack([points, beside, np.roll(beside, -1, axis=1), np.roll(points, -1, axis=1)], axis=2)
    quads = quads.reshape(-1, 4, 3)
    return np.concatenate([quads[:, [0, 1, 2]], quads[:, [0, 2, 3]]])


def winding_number(points: np.ndarray, triangles: np.ndarray) -> np.ndarray:
    """Return how often a surface goes around each point (n,), by solid angles (van Oosterom and Strackee)."""
    total = np.zeros(len(points))
    for corners in triangles:
        a, b, c = (corner - points for corner in corners)
        la, lb, lc = (np.linalg.norm(v, axis=1) for v in (a, b, c))
        above = (a * np.cross(b, c)).sum(axis=1)
        below = la * lb * lc + (a * b).sum(axis=1) * lc + (b * c).sum(axis=1) * la + (c * a).sum(axis=1) * lb
        total += 2 * np.arctan2(above, below)
    return total / (4 * np.pi)

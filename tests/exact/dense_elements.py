"""Finite elements at points with dense matrices of NumPy, and vectors, by numbers of nodes in the whole mesh."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.polynomial import Legendre

from amrpic import fem


def nodes_along(degree: int) -> np.ndarray:
    """Gauss-Lobatto nodes: the ends and the roots of the slope of Legendre's polynomial."""
    return np.concatenate([[-1.0], np.sort(Legendre.basis(degree).deriv().roots().real), [1.0]])


def rows_along(degree: int, x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Values and slopes (n, degree + 1) of the nodes' functions, by powers of x."""
    powers = np.arange(degree + 1)
    coefficients = np.linalg.inv(nodes_along(degree)[:, None] ** powers)
    slopes = powers * x[:, None] ** np.maximum(powers - 1, 0)
    return x[:, None] ** powers @ coefficients, slopes @ coefficients


def rows_at(points: fem.Points) -> tuple[np.ndarray, np.ndarray]:
    """Matrices of values (n, nodes) and slopes (3, n, nodes) in space at the points of a mesh that one rank has whole."""
    mesh, p = points.mesh, points.mesh.degree
    nx, ny, nz = (np.array(mesh.domain.cells) * p + 1).tolist()
    value, slope = np.zeros((len(points), nx * ny * nz)), np.zeros((3, len(points), nx * ny * nz))
    h = mesh.spacing
    at = (points.position - np.array(mesh.domain.lower)) / h
    cell = np.minimum(at.astype(int), np.array(mesh.domain.cells) - 1)
    rows = [rows_along(p, 2 * (at - cell)[:, d] - 1) for d in range(3)]
    each = np.arange(len(points))
    for k in range(p + 1):
        for j in range(p + 1):
            for i in range(p + 1):
                number = (cell[:, 0] * p + i) + nx * ((cell[:, 1] * p + j) + ny * (cell[:, 2] * p + k))
                of = [(rows[d][0][:, n], rows[d][1][:, n] * 2 / h[d]) for d, n in enumerate((i, j, k))]
                value[each, number] = of[0][0] * of[1][0] * of[2][0]
                slope[0, each, number] = of[0][1] * of[1][0] * of[2][0]
                slope[1, each, number] = of[0][0] * of[1][1] * of[2][0]
                slope[2, each, number] = of[0][0] * of[1][0] * of[2][1]
    return value, slope


def matrix(points: fem.Points, kind: type[fem.Operator]) -> np.ndarray:
    """Mass or Poisson of one component."""
    value, slope = rows_at(points)
    w = points.weight[:, None]
    if kind is fem.Mass:
        return value.T @ (w * value)
    return sum((s.T @ (w * s) for s in slope), np.zeros((value.shape[1],) * 2))


def on_all_nodes(mesh: fem.Mesh, v: np.ndarray) -> np.ndarray:
    """A vector of the mesh by numbers of its nodes, on every rank. Collective."""
    parts: list[Any] = mesh.comm.allgather((mesh.numbers, v))
    out = np.full((int(mesh.node_counts.prod()), *v.shape[1:]), np.nan)
    for number, values in parts:
        out[number] = values
    assert np.isfinite(out).all()
    return out


def smooth_vector(mesh: fem.Mesh, components: int) -> np.ndarray:
    """A vector whose values depend on nodes' places alone, and are of no element's space."""
    x, y, z = mesh.nodes.T
    rows = [np.sin(3 * x + c) * np.cos(2 * y - c) + np.exp(z * (c + 1)) * x for c in range(components)]
    return rows[0] if components == 1 else np.stack(rows, axis=1)


def of_one_dimension(mesh: fem.Mesh, kind: type[fem.Operator]) -> np.ndarray:
    """Mass or Poisson of one component, integrated exactly: products of one-dimensional matrices."""
    place, weight = np.polynomial.legendre.leggauss(mesh.degree + 1)
    value, slope = rows_along(mesh.degree, place)
    masses, stiffnesses = [], []
    for h, cells in zip(mesh.spacing, mesh.domain.cells, strict=True):
        m, k = np.zeros((2, cells * mesh.degree + 1, cells * mesh.degree + 1))
        for cell in range(cells):
            own = slice(cell * mesh.degree, (cell + 1) * mesh.degree + 1)
            m[own, own] += value.T @ np.diag(weight) @ value * h / 2
            k[own, own] += slope.T @ np.diag(weight) @ slope * 2 / h
        masses.append(m)
        stiffnesses.append(k)

    def product(x: np.ndarray, y: np.ndarray, z: np.ndarray) -> np.ndarray:
        return np.kron(z, np.kron(y, x))

    (mx, my, mz), (kx, ky, kz) = masses, stiffnesses
    if kind is fem.Mass:
        return product(mx, my, mz)
    return product(kx, my, mz) + product(mx, ky, mz) + product(mx, my, kz)

"""Operators and curvatures on a sphere and an ellipsoid that are known by points alone."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial import cKDTree

from amrpic import gmls
from amrpic.errors import InputError
from verify.least_squares import fibonacci, mean_curvature

AXES = {"sphere": np.array([1.0, 1.0, 1.0]), "ellipsoid": np.array([1.0, 1.2, 0.8])}


def f(x: np.ndarray) -> np.ndarray:
    return x[:, 0] * x[:, 1] + x[:, 0] * x[:, 1] * x[:, 2]


def neighbour_distance(x: np.ndarray, t: np.ndarray, order: int) -> np.ndarray:
    """Of the n-th nearest site, n the number of polynomials in the tangent plane."""
    n = gmls.Scalar(order).unknowns(2)
    return cKDTree(x).query(t, k=[n])[0][:, 0]


def test_gradients_are_tangential_and_the_divergence_of_the_normal_is_twice_the_mean_curvature():
    x = fibonacci(4000) * AXES["ellipsoid"]
    t = x[::9]
    near = gmls.nearby(x, t, radius=1.7 * neighbour_distance(x, t, 4))
    normals = x / AXES["ellipsoid"] ** 2
    normals /= np.linalg.norm(normals, axis=1)[:, None]
    found = gmls.surface(t, x, near, order=4, normals=normals[::9])
    gradient = found.stencils.apply(f(x))["gradient"]
    n = normals[::9]
    exact = np.stack([t[:, 1] * (1 + t[:, 2]), t[:, 0] * (1 + t[:, 2]), t[:, 0] * t[:, 1]], axis=1)
    exact -= (exact * n).sum(axis=1)[:, None] * n
    assert np.abs(gradient - exact).max() < 1e-3
    assert np.abs((gradient * found.normal).sum(axis=1)).max() < 1e-12
    assert np.abs(found.normal - n).max() < 1e-4
    assert np.abs(found.divergence(normals) - 2 * mean_curvature(t, AXES["ellipsoid"])).max() < 2e-3
    assert (found.mean_curvature < 0).all()  # bends away from outer normals


def test_normals_that_are_zero_are_refused():
    x = fibonacci(400)
    with pytest.raises(InputError, match=r"least length 0\.0"):
        gmls.surface(x, x, gmls.nearby(x, x, radius=0.4), normals=np.zeros_like(x))

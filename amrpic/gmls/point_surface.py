"""Surfaces in three dimensions that are known by points alone: operators on them, and their curvature.

About each target the surface is a height z(u, v) over its tangent plane, fitted to the neighbours like any function f on
it. With D = 1 + |∇z|² the inverse metric is g^ij = δ_ij - z_i z_j / D, and

    Δ_Γ f = g^ij f_ij - (g^ij z_ij)(z_k f_k) / D,   K = (z_uu z_vv - z_uv²) / D²,   2 H = g^ij z_ij / √D.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike

from ..errors import InputError
from .inputs import finite
from .neighbours import Neighbours
from .samples import Points
from .spaces import Scalar
from .stencils import Stencils, stencils
from .targets import GRADIENT, HESSIAN, VALUE
from .weights import QUADRATIC, Weight


@dataclass(frozen=True, eq=False)
class Surface:
    """What surface points say about the surface and about functions on it, at n targets."""

    stencils: Stencils  # "value", "gradient" (3, tangential, in x, y, z) and "laplace_beltrami" of a function
    normal: np.ndarray  # (n, 3): unit normals, up to their sign if they were not given
    gaussian_curvature: np.ndarray  # (n,) in 1/m²
    mean_curvature: np.ndarray  # (n,) in 1/m, above zero where the surface bends towards the normal

    def divergence(self, vectors: ArrayLike) -> np.ndarray:
        """Return the surface divergence, (n,), of vectors (m, 3) at the sites, tangential or not."""
        gradients = self.stencils.apply(finite(vectors, "the vectors", 2))["gradient"]  # (n, 3, 3): of each component
        return np.trace(gradients, axis1=1, axis2=2)


def surface(
    targets: ArrayLike,
    sites: ArrayLike,
    near: Neighbours,
    *,
    order: int = 2,
    normals: ArrayLike | None = None,
    weight: Weight = QUADRATIC,
) -> Surface:
    """Return operators on the surface at targets (n, 3) on it, from the sites (m, 3) on it that `near` lists; in m.

    Tangent planes by the principal axes of the neighbours, or from normals (n, 3). Reaches do not grow here: neighbours want
    about 1.7 times the distance of the n-th site, n that of polynomials in two dimensions. InputError for what does not fit,
    SolverError for targets that the sites do not determine. Not collective.
    """
    places, points = finite(targets, "the targets", 2), finite(sites, "the sites", 2)
    if places.shape[1] != 3 or points.shape[1] != 3:
        raise InputError(f"a surface has sites of {points.shape[1]} coordinates; give 3")
    frame = _frames(places, points, near, normals)
    offset = points[near.index] - np.repeat(places, np.diff(near.start), axis=0)
    local = np.einsum("eab,eb->ea", np.repeat(frame, np.diff(near.start), axis=0), offset)
    flat = Neighbours(near.start, np.arange(len(near.index), dtype=np.int32), near.reach)
    fit = stencils(
        np.zeros((len(places), 2)),
        flat,
        space=Scalar(order),
        samples=Points(local[:, :2]),
        wanted=[VALUE, GRADIENT, HESSIAN],
        weight=weight,
    )
    height = fit.apply(local[:, 2])
    z, zz = height["gradient"], height["hessian"]
    d = 1 + (z**2).sum(axis=1)
    metric = np.eye(2) - z[:, :, None] * z[:, None, :] / d[:, None, None]  # inverse
    bend = np.einsum("nij,nij->n", metric, zz)
    tangent = frame[:, :2] + z[:, :, None] * frame[:, 2:]  # ∂r/∂u, ∂r/∂v
    value, slope, second = (fit.weights[:, fit.rows[name][0]] for name in ("value", "gradient", "hessian"))
    of = np.repeat(np.arange(len(places)), np.diff(near.start))
    gradient = np.einsum("ei,eij,ejx->ex", slope, metric[of], tangent[of])
    laplacian = np.einsum("eij,eij->e", metric[of], second.reshape(-1, 2, 2))
    laplacian -= (bend / d)[of] * np.einsum("ei,ei->e", slope, z[of])
    on_surface = replace(
        fit,
        index=near.index,
        samples=len(points),
        solved=np.column_stack([value, gradient, laplacian]),
        rows={"value": (slice(0, 1), ()), "gradient": (slice(1, 4), (3,)), "laplace_beltrami": (slice(4, 5), ())},
    )
    normal = (frame[:, 2] - np.einsum("ni,nix->nx", z, frame[:, :2])) / np.sqrt(d)[:, None]
    return Surface(on_surface, normal, np.linalg.det(zz) / d**2, bend / np.sqrt(d) / 2)


def _frames(targets: np.ndarray, sites: np.ndarray, near: Neighbours, normals: ArrayLike | None) -> np.ndarray:
    """Return rows of two tangents and the normal, (n, 3, 3)."""
    if normals is not None:
        vectors = finite(normals, "the normals", 2)
        lengths = np.linalg.norm(vectors, axis=1)
        if vectors.shape != targets.shape or not (lengths > 0).all():
            raise InputError(
                f"normals have shape {vectors.shape} and least length {lengths.min()}; give one per target"
            )
        n = vectors / lengths[:, None]
        least = np.eye(3)[np.abs(n).argmin(axis=1)]
        first = np.cross(n, least)
        first /= np.linalg.norm(first, axis=1)[:, None]
        return np.stack([first, np.cross(n, first), n], axis=1)
    offset = sites[near.index] - np.repeat(targets, np.diff(near.start), axis=0)
    of = np.repeat(np.arange(len(targets)), np.diff(near.start))
    products = offset[:, :, None] * offset[:, None, :]
    moments = np.stack(
        [np.bincount(of, products[:, a, b], len(targets)) for a in range(3) for b in range(3)], axis=1
    ).reshape(-1, 3, 3)
    return np.linalg.eigh(moments)[1].transpose(0, 2, 1)[:, ::-1]

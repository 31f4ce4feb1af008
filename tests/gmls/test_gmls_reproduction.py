"""Every legal combination of space, sample, target, order and dimension against dense SVD, on jittered lattices."""

from __future__ import annotations

import itertools
from collections.abc import Callable
from functools import partial
from typing import Any

import numpy as np
import pytest

from amrpic import gmls
from gmls_oracle import ROOTS, Monomials, box_mean, simplex_mean, weights_by_svd

SCALARS = {"Scalar": gmls.Scalar, "Harmonic": gmls.Harmonic}
VECTORS = {"Vector": gmls.Vector, "DivergenceFree": gmls.DivergenceFree, "CurlFree": gmls.CurlFree}
OPERATORS = {"Harmonic": "laplacian", "DivergenceFree": "divergence", "CurlFree": "curl"}

Rows = Callable[[Monomials, np.ndarray], np.ndarray]  # of samples by number, (numbers, basis)


def along(m: Monomials, mean_of: Callable[[Any], np.ndarray], directions: np.ndarray) -> np.ndarray:
    """Means of vectors along directions; `mean_of` takes what gives values at places."""
    parts = [directions[:, c, None] * mean_of(lambda x, c=c: m.value(x, c)) for c in range(m.dimension)]
    return np.sum(parts, axis=0)


def scalar_samples(kind: str, x: np.ndarray, rng: np.random.Generator) -> tuple[gmls.Samples, Rows]:
    """Samples of a scalar near places x, and what they make of monomials."""
    n, d = x.shape
    w = rng.uniform(0.1, 0.3, x.shape)
    corners = x[:, None] + rng.uniform(-0.3, 0.3, (n, d + 1, d))
    boxes = gmls.boxes(x, w)
    if kind == "points":
        return gmls.Points(x), lambda m, j: m.value(x[j])
    if kind == "with Laplacian":
        return gmls.WithLaplacian(x, 0.2, 1 / 30), lambda m, j: m.value(x[j]) + 0.04 / 30 * m.laplacian(x[j])
    if kind == "differences":
        return gmls.Differences(x - w, x + w), lambda m, j: m.value(x[j] + w[j]) - m.value(x[j] - w[j])
    if kind == "box means":
        return gmls.Means(boxes), lambda m, j: box_mean(m.value, x[j], w[j])
    if kind == "box integrals":
        return gmls.Integrals(boxes), lambda m, j: w[j].prod(axis=1)[:, None] * box_mean(m.value, x[j], w[j])
    if kind == "triangles":
        return gmls.Means(gmls.triangles(corners[:, :3])), lambda m, j: simplex_mean(m.value, corners[j, :3])
    if kind == "tetrahedra":
        return gmls.Means(gmls.tetrahedra(corners)), lambda m, j: simplex_mean(m.value, corners[j])
    if kind == "polygons":  # chevrons, which are not convex: two triangles of one area along their line of symmetry
        shape = np.zeros((4, d))
        shape[1:, :2] = (0.3, 0.0), (0.1, 0.1), (0.0, 0.3)
        if d == 3:
            shape = shape @ np.linalg.qr(rng.normal(size=(3, 3)))[0]
        chevrons = x[:, None] + shape[[2, 1, 0, 3]] if rng.uniform() < 0.5 else x[:, None] + shape
        parts = [x[:, None] + shape[[0, 1, 2]], x[:, None] + shape[[0, 2, 3]]]
        return (
            gmls.Means(gmls.polygons(chevrons)),
            lambda m, j: (simplex_mean(m.value, parts[0][j]) + simplex_mean(m.value, parts[1][j])) / 2,
        )
    assert kind == "custom"
    return (
        gmls.Custom(x, lambda basis: basis(x) * 2.0 + basis.slope(x, 0) * w[:, 0]),
        lambda m, j: 2 * m.value(x[j]) + w[j, :1] * m.derivative(x[j], m.unit(0)),
    )


def vector_samples(kind: str, x: np.ndarray, rng: np.random.Generator) -> tuple[gmls.Samples, Rows]:
    """Samples of a vector near places x, and what they make of monomials."""
    n, d = x.shape
    w = rng.uniform(0.1, 0.3, x.shape)
    directions = rng.normal(size=x.shape)
    if kind == "vectors":
        return gmls.Vectors(x), lambda m, j: np.stack([m.value(x[j], c) for c in range(d)], 1).reshape(d * len(j), -1)
    if kind == "components":
        return (
            gmls.Components(x, directions),
            lambda m, j: np.sum([directions[j, c, None] * m.value(x[j], c) for c in range(d)], axis=0),
        )
    if kind == "edges":
        ends = np.stack([x - 0.2 * directions, x + 0.1 * directions], axis=1)
        return (
            gmls.Integrals(gmls.edges(ends[:, 0], ends[:, 1])),
            lambda m, j: along(m, lambda v: simplex_mean(v, ends[j]), 0.3 * directions[j]),
        )
    if kind == "box faces":
        axis = np.asarray(rng.integers(0, d, n))
        flat = np.where(np.arange(d) == axis[:, None], 0, w)
        return (
            gmls.Along(gmls.box_faces(x, w, axis)),
            lambda m, j: along(m, lambda v: box_mean(v, x[j], flat[j]), np.eye(d)[axis[j]]),
        )
    if kind == "triangles":
        corners = x[:, None] + rng.uniform(-0.3, 0.3, (n, 3, d))
        normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
        normal /= np.linalg.norm(normal, axis=1)[:, None]
        return (
            gmls.Along(gmls.triangles(corners)),
            lambda m, j: along(m, lambda v: simplex_mean(v, corners[j]), normal[j]),
        )
    assert kind == "custom"
    return (
        gmls.Custom(
            x,
            lambda basis: sum((basis(x, component=c) * directions[:, c] ** 2 for c in range(1, d)), basis(x) * w[:, 0]),
            "vector",
        ),
        lambda m, j: sum(
            (directions[j, c, None] ** 2 * m.value(x[j], c) for c in range(1, d)), w[j, :1] * m.value(x[j])
        ),
    )


def scalar_targets(
    t: np.ndarray, sees_constants: bool, order: int
) -> list[tuple[gmls.Wanted, Callable[[Monomials, int], Any]]]:
    """Quantities of a scalar at targets t, and what they make of monomials: (numbers, basis)."""
    n, d = t.shape
    size = np.linspace(0.1, 0.3, d)
    further = t[:, None] + np.array([[0.1] * d, [-0.2] * d])
    axes = range(d)
    widths = np.where(np.arange(d) == 0, 0, size)
    out: list[tuple[gmls.Wanted, Callable[[Monomials, int], Any]]] = [
        (gmls.GRADIENT, lambda m, i: [m.derivative(t[i], m.unit(a)) for a in axes]),
        (gmls.HESSIAN, lambda m, i: [m.derivative(t[i], m.unit(a, b)) for a in axes for b in axes]),
        (gmls.LAPLACIAN, lambda m, i: m.laplacian(t[i])),
        (gmls.Derivative(*[1] * d), lambda m, i: m.derivative(t[i], (1,) * d)),
        (
            gmls.MeanSlope(gmls.box_faces(t + 0.1, size, 0)),
            lambda m, i: box_mean(lambda x: m.derivative(x, m.unit(0)), t[[i]] + 0.1, widths),
        ),
        (
            gmls.GRADIENT.at(further, "gradients further off"),
            lambda m, i: [m.derivative(y, m.unit(a)) for y in further[i] for a in axes],
        ),
    ]
    if sees_constants:
        out += [
            (gmls.VALUE, lambda m, i: m.value(t[i])),
            (gmls.Mean(gmls.boxes(t, size)), lambda m, i: box_mean(m.value, t[[i]], size)),
            (gmls.Integral(gmls.boxes(t, size)), lambda m, i: size.prod() * box_mean(m.value, t[[i]], size)),
            (
                gmls.Function("sum", lambda b, y: b(y) + b.slope(y, 0)),
                lambda m, i: m.value(t[i]) + m.derivative(t[i], m.unit(0)),
            ),
            (gmls.COEFFICIENTS, lambda m, i: _coefficients(m, t[i])),
        ]
    return out


def _coefficients(m: Monomials, at: np.ndarray) -> list[np.ndarray]:
    """By degree, then by falling powers of the first coordinates: values and derivatives over factorials."""
    powers = [e for e in itertools.product(range(m.order + 1), repeat=m.dimension) if sum(e) <= m.order]
    powers.sort(key=lambda e: (sum(e), [-k for k in e]))
    factorials = [np.prod([np.prod(np.arange(1.0, k + 1)) for k in e]) for e in powers]
    return [m.derivative(at, e, c) / f for c in range(m.components) for e, f in zip(powers, factorials, strict=True)]


def vector_targets(t: np.ndarray) -> list[tuple[gmls.Wanted, Callable[[Monomials, int], Any]]]:
    """The same of a vector."""
    n, d = t.shape
    axes = range(d)
    size = np.linspace(0.1, 0.3, d)
    flat = np.where(np.arange(d) == 1, 0, size)

    def curl(m: Monomials, y: np.ndarray) -> list[np.ndarray]:
        pairs = [(0, 1)] if d == 2 else [(1, 2), (2, 0), (0, 1)]
        return [m.derivative(y, m.unit(a), b) - m.derivative(y, m.unit(b), a) for a, b in pairs]

    return [
        (gmls.VALUE, lambda m, i: [m.value(t[i], c) for c in axes]),
        (gmls.JACOBIAN, lambda m, i: [m.derivative(t[i], m.unit(a), c) for c in axes for a in axes]),
        (gmls.DIVERGENCE, lambda m, i: sum(m.derivative(t[i], m.unit(a), a) for a in axes)),
        (gmls.CURL, lambda m, i: curl(m, t[i])),
        (
            gmls.CURL_CURL,
            lambda m, i: [
                np.sum([m.derivative(t[i], m.unit(a, b), b) for b in axes], axis=0) - m.laplacian(t[i], a) for a in axes
            ],
        ),
        (gmls.LAPLACIAN, lambda m, i: [m.laplacian(t[i], c) for c in axes]),
        (
            gmls.Mean(gmls.boxes(t, size)),
            lambda m, i: [box_mean(partial(m.value, component=c), t[[i]], size) for c in axes],
        ),
        (gmls.MeanAlong(gmls.box_faces(t, size, 1)), lambda m, i: box_mean(lambda x: m.value(x, 1), t[[i]], flat)),
        (gmls.COEFFICIENTS, lambda m, i: _coefficients(m, t[i])),
        (gmls.VALUE.at(t[:, None] + 0.1, "value further off"), lambda m, i: [m.value(t[i] + 0.1, c) for c in axes]),
    ]


SCALAR_SAMPLES = {
    "points": (1, 2, 3),
    "with Laplacian": (1, 2, 3),
    "differences": (1, 2, 3),
    "box means": (1, 2, 3),
    "box integrals": (1, 2, 3),
    "triangles": (2, 3),
    "tetrahedra": (3,),
    "polygons": (2, 3),
    "custom": (1, 2, 3),
}
VECTOR_SAMPLES = {
    "vectors": (2, 3),
    "components": (2, 3),
    "edges": (2, 3),
    "box faces": (2, 3),
    "triangles": (3,),
    "custom": (2, 3),
}
COMBINATIONS = [
    *((space, samples, d) for space in SCALARS for samples, ds in SCALAR_SAMPLES.items() for d in ds),
    *((space, samples, d) for space in VECTORS for samples, ds in VECTOR_SAMPLES.items() for d in ds),
]


def jittered(d: int, count: int, rng: np.random.Generator) -> np.ndarray:
    """About so many points of a jittered lattice around the origin, of a size so that their reach is about one."""
    per_axis = int(np.ceil(count ** (1 / d)))
    lattice = np.stack(np.meshgrid(*[np.arange(per_axis)] * d, indexing="ij"), -1).reshape(-1, d) - (per_axis - 1) / 2
    return (lattice + rng.uniform(-0.25, 0.25, lattice.shape)) * 2 / per_axis


@pytest.mark.parametrize("order", [1, 2, 3, 4])
@pytest.mark.parametrize(("space_name", "kind", "d"), COMBINATIONS)
def test_polynomials_are_reproduced_and_weights_are_those_of_a_dense_svd(space_name, kind, d, order, long):
    clouds = 200 if long else 4
    rng = np.random.default_rng([order, d, len(kind), len(space_name)])
    vector = space_name in VECTORS
    space = (VECTORS if vector else SCALARS)[space_name](order)
    needed = 3 * (space.unknowns(d) // (d if kind == "vectors" else 1)) // 2 + 10
    x = jittered(d, 2 ** (d if order > 1 else 0) * needed, rng)
    t = rng.uniform(-0.15, 0.15, (clouds, d))
    distances = np.sort(np.linalg.norm(x - t[:, None], axis=2), axis=1)
    near = gmls.nearby(x, t, radius=distances[:, min(needed, len(x) - 1)])
    samples, rows = (vector_samples if vector else scalar_samples)(kind, x, rng)
    targets = vector_targets(t) if vector else scalar_targets(t, kind != "differences", order)
    found = gmls.stencils(t, near, space=space, samples=samples, wanted=[w for w, _ in targets])
    assert (found.quality.growth == 0).all()
    assert found.quality.residual.max() < 1e-12
    per_site = d if kind == "vectors" else 1
    around_origin = Monomials(d, order, d if vector else 1, np.zeros(d))
    operator = OPERATORS.get(space_name)
    basis = around_origin.null_space(operator) if operator else np.eye(len(around_origin.basis))
    for i in range(clouds):
        m = Monomials(d, order, d if vector else 1, t[i])
        sites = near.index[near.start[i] : near.start[i + 1]]
        p = rows(m, sites) @ basis
        tau = np.vstack([np.reshape(of(m, i), (-1, len(m.basis))) for _, of in targets]) @ basis
        distance = np.linalg.norm(samples.sites[sites] - t[i], axis=1) / near.reach[i]
        roots = np.repeat(np.where(distance < 1, 1 - distance, 0), per_site)
        alpha = found.weights[found.start[i] : found.start[i + 1]]
        sizes = np.abs(alpha).T @ np.abs(p)
        assert (np.abs(alpha.T @ p - tau) <= 1e-10 * sizes.max(axis=1)[:, None] + 1e-13).all()
        if i >= clouds // 3:
            continue
        expected, _ = weights_by_svd(p, tau.T, roots)
        bound = 1e-9 if found.quality.path[i] == 2 else 1e-11
        assert (np.abs(alpha - expected) <= bound * np.abs(expected).max(axis=0) + 1e-14 * np.abs(expected).max()).all()


@pytest.mark.parametrize("name", list(ROOTS))
@pytest.mark.parametrize("portable", [False, True])
def test_each_weight_is_its_formula(name, portable):
    rng = np.random.default_rng(3)
    x, t = jittered(2, 150, rng), rng.uniform(-0.1, 0.1, (20, 2))
    near = gmls.nearby(x, t, order=2, reach=1.8)
    weight = getattr(gmls, name)()
    found = gmls.stencils(
        t, near, space=gmls.Scalar(2), samples=gmls.Points(x), wanted=[gmls.LAPLACIAN], weight=weight, portable=portable
    )
    for i in range(len(t)):
        sites = near.index[near.start[i] : near.start[i + 1]]
        m = Monomials(2, 2, 1, t[i])
        distance = np.linalg.norm(x[sites] - t[i], axis=1) / near.reach[i]
        roots = np.sqrt(np.where(distance < 1, ROOTS[name](np.minimum(distance, 1)), 0))
        expected, _ = weights_by_svd(m.value(x[sites]), m.laplacian(t[i]).T, roots)
        alpha = found.weights[found.start[i] : found.start[i + 1]]
        assert np.abs(alpha - expected).max() <= 1e-11 * np.abs(expected).max()


@pytest.mark.parametrize(
    "rows", [("mean",), ("dirichlet",), ("neumann",), ("dirichlet", "neumann"), ("mean", "neumann")]
)
@pytest.mark.parametrize("order", [1, 2, 3, 4])
@pytest.mark.parametrize("d", [2, 3])
def test_exact_rows_hold_and_their_data_get_weights(rows, order, d):
    rng = np.random.default_rng([order, d])
    x, t = jittered(d, 500 if d == 3 else 200, rng), rng.uniform(-0.1, 0.1, (12, d))
    near = gmls.nearby(x, t, order=order, reach=1.8)
    normals, places, size = rng.normal(size=t.shape), t + rng.uniform(-0.1, 0.1, t.shape), np.full(d, 0.2)
    normals[3] = np.nan  # one without it
    makers = {
        "mean": (gmls.ExactMean(gmls.boxes(t, size)), lambda m, i: box_mean(m.value, t[[i]], size)),
        "dirichlet": (gmls.Dirichlet(places), lambda m, i: m.value(places[i])[0]),
        "neumann": (
            gmls.Neumann(normals),
            lambda m, i: sum(
                n * m.derivative(t[i], m.unit(a))[0] for a, n in enumerate(normals[i] / np.linalg.norm(normals[i]))
            ),
        ),
    }
    found = gmls.stencils(
        t,
        near,
        space=gmls.Scalar(order),
        samples=gmls.Points(x),
        wanted=[gmls.VALUE, gmls.LAPLACIAN],
        exact=[makers[r][0] for r in rows],
    )
    for i in range(len(t)):
        m = Monomials(d, order, 1, t[i])
        present = [r for r in rows if not (r == "neumann" and i == 3)]
        sites = near.index[near.start[i] : near.start[i + 1]]
        distance = np.linalg.norm(x[sites] - t[i], axis=1) / near.reach[i]
        tau = np.vstack([m.value(t[i]), m.laplacian(t[i])]).T
        exact = np.vstack([makers[r][1](m, i) for r in present]) if present else None
        alpha, beta = weights_by_svd(m.value(x[sites]), tau, np.where(distance < 1, 1 - distance, 0), exact)
        got = found.weights[found.start[i] : found.start[i + 1]]
        assert np.abs(got - alpha).max() <= 1e-10 * np.abs(alpha).max() + 1e-13
        got = found.exact_weights[i, [r in present for r in rows]]
        if present:
            assert np.abs(got - beta).max() <= 1e-10 * max(np.abs(beta).max(), np.abs(alpha).max()) + 1e-13
        assert not found.exact_weights[i, [r not in present for r in rows]].any()

"""Orders under refinement, of what combines: on jittered points and on cells across levels."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from amrpic import gmls


def jittered(n: int, d: int, seed: int = 1) -> np.ndarray:
    """Points of a jittered lattice in the unit cube."""
    lattice = np.stack(np.meshgrid(*[np.arange(n) + 0.5] * d, indexing="ij"), -1).reshape(-1, d)
    return (lattice + np.random.default_rng(seed).uniform(-0.25, 0.25, lattice.shape)) / n


def two_levels(n: int) -> tuple[np.ndarray, np.ndarray]:
    """Centres and widths of the cells of a square, half of it with cells half as wide."""
    coarse = np.stack(np.meshgrid(np.arange(n // 2), np.arange(n), indexing="ij"), -1).reshape(-1, 2)
    fine = np.stack(np.meshgrid(np.arange(n, 2 * n), np.arange(2 * n), indexing="ij"), -1).reshape(-1, 2)
    centres = np.concatenate([(coarse + 0.5) / n, (fine + 0.5) / (2 * n)])
    return centres, np.repeat([1 / n, 0.5 / n], [len(coarse), len(fine)])


def f(x: np.ndarray) -> np.ndarray:
    return np.sin(3 * x[..., 0] + 0.3) * np.exp(x[..., 1] - 0.5)


def exact(x: np.ndarray) -> dict[str, np.ndarray]:
    s, c, e = np.sin(3 * x[:, 0] + 0.3), np.cos(3 * x[:, 0] + 0.3), np.exp(x[:, 1] - 0.5)
    return {"value": s * e, "gradient": np.stack([3 * c * e, s * e], axis=1), "laplacian": -8 * s * e}


def slope(sizes: list[int], errors: list[float]) -> float:
    return -np.polyfit(np.log(sizes), np.log(errors), 1)[0]


WANTED = [gmls.VALUE, gmls.GRADIENT, gmls.LAPLACIAN]


@pytest.mark.parametrize("order", [1, 2, 3, 4])
@pytest.mark.parametrize("kind", ["points", "means of cells across levels"])
def test_errors_fall_with_the_order_of_the_space(kind, order):
    sizes, errors = [16, 24, 36, 54], []
    rng = np.random.default_rng(order)
    t = rng.uniform(0.3, 0.7, (1000, 2))
    for n in sizes:
        if kind == "points":
            x = jittered(n, 2)
            samples, values = gmls.Points(x), f(x)
        else:
            x, w = two_levels(n)
            samples = gmls.Means(gmls.boxes(x, w[:, None]))
            g, gw = np.polynomial.legendre.leggauss(4)
            values = np.zeros(len(x)) + sum(
                a * b / 4 * f(x + w[:, None] * np.array([u, v]) / 2)
                for u, a in zip(g, gw, strict=True)
                for v, b in zip(g, gw, strict=True)
            )
        near = gmls.nearby(x, t, order=order, reach=1.8)
        found = gmls.stencils(t, near, space=gmls.Scalar(order), samples=samples, wanted=WANTED).apply(values)
        errors.append([np.sqrt(np.mean((found[q] - e) ** 2)) for q, e in exact(t).items()])
    value, gradient, laplacian = (slope(sizes, list(e)) for e in zip(*errors, strict=True))
    assert value > order + 0.8
    assert gradient > order - 0.2
    assert order < 2 or laplacian > order - 1.2


@pytest.mark.parametrize("order", [1, 2, 3, 4])
def test_vectors_have_curl_and_divergence_of_the_order_and_none_in_their_spaces(order):
    sizes, errors = [16, 24, 36, 54], []
    t = np.random.default_rng(order).uniform(0.3, 0.7, (1000, 2))

    def rotation(x: np.ndarray) -> np.ndarray:  # without divergence
        return np.stack([np.sin(3 * x[:, 1]) * np.exp(x[:, 0]), np.cos(3 * x[:, 1]) * np.exp(x[:, 0]) / 3], axis=1)

    curl = (np.cos(3 * t[:, 1]) / 3 - 3 * np.cos(3 * t[:, 1])) * np.exp(t[:, 0])
    for n in sizes:
        x = jittered(n, 2)
        near = gmls.nearby(x, t, order=order, reach=1.8)
        arguments: dict[str, Any] = dict(samples=gmls.Vectors(x), wanted=[gmls.VALUE, gmls.CURL, gmls.DIVERGENCE])
        free = gmls.stencils(t, near, space=gmls.DivergenceFree(order), **arguments).apply(rotation(x))
        plain = gmls.stencils(t, near, space=gmls.Vector(order), **arguments).apply(rotation(x))
        assert np.abs(free["divergence"]).max() < 1e-10 * np.abs(free["curl"]).max()
        parts = [free["value"] - rotation(t), free["curl"] - curl, plain["divergence"]]
        errors.append([np.sqrt(np.mean(e**2)) for e in parts])
    value, turned, spread = (slope(sizes, list(e)) for e in zip(*errors, strict=True))
    assert value > order + 0.8
    assert turned > order - 0.2
    assert spread > order - 0.2


def test_the_staggered_laplacian_is_the_divergence_of_a_vector_fitted_to_differences():
    sizes, errors = [10, 14, 20, 28], []
    for n in sizes:
        x = jittered(n, 2)
        inner = np.flatnonzero(((x > 0.3) & (x < 0.7)).all(axis=1))[::3]
        near = gmls.nearby(x, x[inner], order=3, reach=1.6)
        worst = []
        for i, t in enumerate(inner):
            others = near.index[near.start[i] : near.start[i + 1]]
            others = others[others != t]
            edges = gmls.edges(np.broadcast_to(x[t], (len(others), 2)), x[others])
            every = gmls.Neighbours(np.array([0, len(others)]), np.arange(len(others), dtype=np.int32), near.reach[[i]])
            found = gmls.stencils(
                x[[t]], every, space=gmls.CurlFree(2), samples=gmls.Integrals(edges), wanted=[gmls.DIVERGENCE]
            )
            worst.append(found.apply(f(x[others]) - f(x[t]))["divergence"][0] - exact(x[[t]])["laplacian"][0])
        errors.append(np.sqrt(np.mean(np.square(worst))))
    assert slope(sizes, errors) > 1.8  # the potential of a curl-free vector of order 2 is of order 3

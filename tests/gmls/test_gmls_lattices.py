"""Lattices, cells of three levels, and clouds that determine nothing: every stencil is right or is reported."""

from __future__ import annotations

import sys
from typing import Any

import numpy as np
import pytest

from amrpic import gmls
from amrpic.errors import InputError, SolverError

WANTED = [gmls.VALUE, gmls.GRADIENT, gmls.LAPLACIAN]


def three_levels() -> np.ndarray:
    """Centres of the uncovered cells of an 8³ mesh with two refined boxes, one in the other, off the middle."""
    cells = []
    boxes = [((0, 0, 0), (8, 8, 8)), ((2, 0, 4), (10, 10, 16)), ((8, 4, 16), (16, 12, 24))]
    for level, (low, high) in enumerate(boxes):
        corner = np.stack(np.meshgrid(*[np.arange(a, b) for a, b in zip(low, high, strict=True)], indexing="ij"), -1)
        corner = corner.reshape(-1, 3)
        if level < 2:
            lo, hi = (np.array(c) // 2 for c in boxes[level + 1])
            corner = corner[((corner < lo) | (corner >= hi)).any(axis=1)]
        cells.append((corner + 0.5) / 2**level)
    return np.concatenate(cells)


def monomials(x: np.ndarray, order: int) -> np.ndarray:
    powers = [(i, j, k) for i in range(5) for j in range(5) for k in range(5) if i + j + k <= order]
    return np.stack([np.prod(x**e, axis=1) for e in powers], axis=1)


def reproduction_error(found: gmls.Stencils, x: np.ndarray, t: np.ndarray, reach: np.ndarray, order: int) -> np.ndarray:
    """For each target the error of the value of all monomials around it, in units of its reach, over the sum of |α|."""
    out = np.empty(len(t))
    for i in range(len(t)):
        entries = slice(found.start[i], found.start[i + 1])
        alpha = found.weights[entries, found.rows["value"][0].start]
        u = (x[found.index[entries]] - t[i]) / reach[i]
        out[i] = np.abs(alpha @ monomials(u, order) - monomials(np.zeros((1, 3)), order)).max() / np.abs(alpha).sum()
    return out


@pytest.mark.parametrize("reach", [1.05, 1.2, 1.4, 1.6, 2.0])
@pytest.mark.parametrize("order", [1, 2, 3, 4])
@pytest.mark.parametrize("levels", [1, 3])
def test_every_target_of_a_lattice_is_determined_within_five_growths(levels, order, reach):
    lattice = np.stack(np.meshgrid(*[np.arange(9) + 0.5] * 3, indexing="ij"), -1).reshape(-1, 3)
    x = three_levels() if levels == 3 else lattice
    t = x[np.random.default_rng(order).choice(len(x), 250, replace=False)]
    near = gmls.nearby(x, t, order=order, reach=reach)
    found = gmls.stencils(t, near, space=gmls.Scalar(order), samples=gmls.Points(x), wanted=WANTED)
    assert found.quality.failed.size == 0
    assert found.quality.growth.max() <= 5
    assert found.quality.residual.max() < 1e-9
    reaches = near.reach * 1.15**found.quality.growth
    assert reproduction_error(found, x, t, reaches, order).max() < 1e-10
    assert (found.quality.neighbours == np.diff(found.start)).all()


@pytest.mark.parametrize("portable", [False, True])
@pytest.mark.parametrize("order", [2, 3, 4])
def test_monomials_and_their_derivatives_are_right_up_to_the_corners_of_a_lattice(order, portable):
    """41³ sites from -0.5 to 0.5. Reaches of few sites leave pivots down to 1e-8, which equations lose digits with."""
    axis, rng = np.linspace(-0.5, 0.5, 41), np.random.default_rng(order)
    x = np.stack(np.meshgrid(axis, axis, axis, indexing="ij"), -1).reshape(-1, 3)
    corners = rng.choice([-0.5, 0.5], (1200, 3)) + rng.uniform(-0.08, 0.08, (1200, 3))
    t = np.clip(np.concatenate([corners, rng.uniform(-0.5, 0.5, (300, 3))]), -0.5, 0.5)
    powers = [(i, j, k) for i in range(5) for j in range(5) for k in range(5) if i + j + k <= order]
    exact = {"value": np.empty((len(t), len(powers))), "gradient": np.empty((len(t), 3, len(powers)))}
    exact["laplacian"] = np.empty_like(exact["value"])
    for column, e in enumerate(powers):
        value, slope, second = ([derived(t[:, d], e[d], times) for d in range(3)] for times in range(3))
        exact["value"][:, column] = np.prod(value, axis=0)
        for d in range(3):
            others = np.prod([value[a] for a in range(3) if a != d], axis=0)
            exact["gradient"][:, d, column] = slope[d] * others
            exact["laplacian"][:, column] = second[d] * others + (exact["laplacian"][:, column] if d else 0)
    given = np.stack([np.prod(x**e, axis=1) for e in powers], axis=1)
    paths = set()
    for reach in (1.4, 1.6):
        near = gmls.nearby(x, t, order=order, reach=reach)
        found = gmls.stencils(
            t, near, space=gmls.Scalar(order), samples=gmls.Points(x), wanted=WANTED, portable=portable
        )
        paths |= set(found.quality.path.tolist())
        for name, values in found.apply(given).items():
            assert np.abs(values - exact[name]).max() < 1e-9, (name, reach)
    assert paths == {0, 2}


def derived(x: np.ndarray, power: int, times: int) -> np.ndarray:
    """The derivative of x^power."""
    factor = np.prod(np.arange(power, power - times, -1.0))
    return factor * x ** max(power - times, 0)


@pytest.mark.parametrize(
    ("sites", "where"),
    [
        (lambda rng: np.column_stack([rng.uniform(size=(60, 2)), np.full(60, 0.3)]), "in a plane"),
        (lambda rng: rng.uniform(size=(60, 1)) * np.ones(3), "on a line"),
        (lambda rng: np.full((60, 3), 0.5), "in one point"),
    ],
)
def test_sites_that_determine_nothing_are_reported_with_their_cause(sites, where):
    x = sites(np.random.default_rng(1))
    t = x[:3] + np.array([0, 0, 0.01])
    near = gmls.nearby(x, t, radius=0.6)
    arguments: dict[str, Any] = dict(space=gmls.Scalar(2), samples=gmls.Points(x), wanted=WANTED)
    with pytest.raises(SolverError, match=rf"target 0 .* its \d+ sites lie {where}"):
        gmls.stencils(t, near, **arguments)
    marked = gmls.stencils(t, near, failed="mark", **arguments)
    assert marked.quality.failed.tolist() == [0, 1, 2]
    assert np.isnan(marked.weights).all()


def test_too_few_sites_are_reported_with_their_number():
    x = np.random.default_rng(1).uniform(size=(7, 3))
    t = x[:1]
    near = gmls.nearby(x, t, radius=2.0)
    with pytest.raises(SolverError, match=r"target 0 .* its 7 sites are too few for 10 unknowns of order 2"):
        gmls.stencils(t, near, space=gmls.Scalar(2), samples=gmls.Points(x), wanted=WANTED)
    with pytest.raises(InputError, match="7 sites for 10 unknowns"):
        gmls.nearby(x, t, order=2)


def test_a_target_in_a_plane_of_sites_fails_where_others_do_not():
    rng = np.random.default_rng(2)
    x = np.concatenate([rng.uniform(size=(400, 3)), [5, 0, 0] + rng.uniform(size=(40, 3)) * [1, 1, 0]])
    t = np.array([[0.5, 0.5, 0.5], [5.5, 0.5, 0], [0.4, 0.5, 0.5], [9.0, 9.0, 9.0]])
    near = gmls.nearby(x, t, radius=0.4)
    found = gmls.stencils(t, near, space=gmls.Scalar(2), samples=gmls.Points(x), wanted=WANTED, failed="mark")
    assert found.quality.failed.tolist() == [1, 3]
    assert np.isfinite(found.weights[: found.start[1]]).all()
    with pytest.raises(SolverError, match="target 1"):
        gmls.stencils(t, near, space=gmls.Scalar(2), samples=gmls.Points(x), wanted=WANTED)


def test_weights_depend_neither_on_the_batch_nor_on_the_lane_nor_on_the_order_of_sites():
    rng = np.random.default_rng(4)
    x = rng.uniform(size=(900, 3))
    t = x[:101]
    arguments: dict[str, Any] = dict(space=gmls.Scalar(3), samples=gmls.Points(x), wanted=WANTED)
    near = gmls.nearby(x, t, order=3, reach=1.6)
    whole = gmls.stencils(t, near, **arguments)
    for i in range(0, 101, 7):
        for others in ([i], [i, 5], [3, 9, i, 70, 71, 72, 73]):
            some = gmls.stencils(t[others], gmls.nearby(x, t[others], order=3, reach=1.6), **arguments)
            at = others.index(i)
            mine = some.weights[some.start[at] : some.start[at + 1]]
            assert np.array_equal(mine, whole.weights[whole.start[i] : whole.start[i + 1]])  # bit by bit
    mixed = rng.permutation(len(x))
    moved = gmls.stencils(
        t,
        gmls.nearby(x[mixed], t, order=3, reach=1.6),
        space=gmls.Scalar(3),
        samples=gmls.Points(x[mixed]),
        wanted=WANTED,
    )
    for name in ("value", "gradient", "laplacian"):
        a, b = whole.matrix(name), moved.matrix(name)
        assert abs(a - b[:, np.argsort(mixed)]).max() < 1e-11 * abs(a).max()


def test_target_by_target_on_kokkos_and_in_lanes_the_weights_agree_to_rounding():
    rng = np.random.default_rng(5)
    x = np.concatenate([rng.uniform(size=(500, 3)), three_levels() / 8 + [2, 0, 0]])
    t = x[::7]
    arguments: dict[str, Any] = dict(space=gmls.Scalar(3), samples=gmls.Points(x), wanted=WANTED)
    near = gmls.nearby(x, t, order=3, reach=1.5)
    lanes, single = (gmls.stencils(t, near, portable=portable, **arguments) for portable in (False, True))
    assert np.array_equal(lanes.quality.path, single.quality.path)
    assert np.array_equal(lanes.quality.growth, single.quality.growth)
    scale = np.abs(lanes.weights).max(axis=0)
    assert (np.abs(lanes.weights - single.weights) <= 1e-12 * scale).all()


def test_no_targets_are_legal():
    x = np.random.default_rng(0).uniform(size=(50, 2))
    t = np.empty((0, 2))
    found = gmls.stencils(
        t, gmls.nearby(x, t, order=2), space=gmls.Scalar(2), samples=gmls.Points(x), wanted=[gmls.GRADIENT]
    )
    assert len(found) == 0
    assert found.apply(np.ones(50))["gradient"].shape == (0, 2)
    assert found.matrix("gradient").shape == (0, 50)


@pytest.mark.parametrize("vector", [False, True])
def test_weights_are_the_same_bit_by_bit_in_runs_of_targets_of_any_length(monkeypatch, vector):
    x = np.stack(np.meshgrid(*[np.arange(7.0)] * 3, indexing="ij"), axis=-1).reshape(-1, 3)
    near = gmls.nearby(x, x, order=2, reach=1.05)
    space, samples = (gmls.Vector(2), gmls.Vectors(x)) if vector else (gmls.Scalar(2), gmls.Points(x))

    def found() -> gmls.Stencils:
        return gmls.stencils(x, near, space=space, samples=samples, wanted=[gmls.VALUE, gmls.LAPLACIAN])

    at_once = found()
    assert at_once.quality.growth.max() > 1
    for entries in (1, 100, 3000):
        monkeypatch.setattr(
            sys.modules["amrpic.gmls.stencils"], "WRITTEN_TOGETHER", 8 * at_once.solved.shape[1] * entries
        )
        in_runs = found()
        for one, other in ((at_once, in_runs), (at_once.quality, in_runs.quality)):
            for name, value in vars(one).items():
                if isinstance(value, np.ndarray):
                    assert np.array_equal(value, getattr(other, name)), (entries, name)

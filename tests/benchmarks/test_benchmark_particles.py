"""The benchmark of the particle stages runs with every shape."""

from __future__ import annotations

import numpy as np
import pytest

import particles as benchmark
import plain_particles
from amrpic.particles.clouds import SHAPES
from amrpic.units import SPEED_OF_LIGHT

pytestmark = pytest.mark.long  # what is tested is a tool, which users do not meet: for `make verify`


def test_every_stage_takes_time():
    for shape in SHAPES:
        found = benchmark.measure(500, 16, 8, shape, repeats=1)
        assert list(found) == list(benchmark.STAGES)
        assert all(value > 0 for value in found.values())


def test_plain_loops_do_what_their_stages_do():
    """Against NumPy, one by one: the charge in each cell, a step in the field, bricks in order, and the sums."""
    n, count, charge, mass, dt = 16, 3000, -1.6e-19, 9.1e-31, 1e-11
    rng = np.random.default_rng(3)
    x, p = rng.random((count, 3)), 1e-22 * rng.normal(size=(count, 3))
    moved, weight = x + 0.1 * rng.normal(size=x.shape), rng.random(count)
    plain = plain_particles.PlainStages(n, x, p, moved, weight, charge, mass, dt)
    base = np.floor(x * n - 0.5).astype(int)
    share = x * n - 0.5 - base
    rho, e = np.zeros((n, n, n)), np.zeros((count, 3))
    for corner in np.ndindex(2, 2, 2):
        cell = tuple(((base + corner) % n).T[::-1])
        each = np.prod(np.where(corner, share, 1 - share), axis=1)
        np.add.at(rho, cell, weight * each)
        e += each[:, None] * plain._field[cell]
    assert plain.deposit() == pytest.approx(rho, rel=1e-12, abs=1e-13)
    *places, ux, uy, uz = plain.gather_and_push()
    kicked = p + charge * dt * e
    u = kicked / (mass * SPEED_OF_LIGHT)
    assert np.stack([ux, uy, uz], axis=1) == pytest.approx(kicked, rel=1e-9, abs=1e-34)
    flown = x + SPEED_OF_LIGHT * dt * u / np.sqrt(1 + (u**2).sum(axis=1))[:, None]
    assert np.stack(places, axis=1) == pytest.approx(flown, rel=1e-12)
    columns, ids = plain.migrate()
    at = np.stack(columns[:3], axis=1)
    assert np.array_equal(at, (moved - np.floor(moved))[ids]) and np.array_equal(np.sort(ids), np.arange(count))
    brick = np.floor(at * n).astype(int) // 8 @ [1, 2, 4]
    assert np.all(np.diff(brick) >= 0) and np.all(np.diff(ids)[np.diff(brick) == 0] > 0)
    sums = plain.moments()
    assert sums[8:11] / sums[6] == pytest.approx(np.diag(np.cov(x.T, aweights=weight, ddof=0)), rel=1e-12)

"""Segments in the hole of a body are left out of the search for hits, and nothing else is."""

from __future__ import annotations

import numpy as np
import pytest

from amrpic import shapes
from amrpic.shapes.shape import Shape

BLOCK = shapes.Box((-2, -2, -2), (2, 2, 2))
HOLES = {
    "cylinder": shapes.Cylinder((0.1, 0, -3), (0.2, 0.1, 3), 0.8),
    "cone": shapes.Cone((0.1, 0, -1), (0.3, 0.2, 2.5), 1.2, 0),
    "sphere": shapes.Sphere((0.2, 0.1, 0), 1.1),
    "box": shapes.Box((-1, -0.7, -0.8), (0.5, 1.2, 3)),
    "turned box": shapes.Box((-1, -0.7, -0.8), (0.5, 1.2, 3)).turned((1, 2, 3), 0.7),
    "bore": BLOCK,
    "torus": shapes.Torus((0, 0, 0), (0, 0, 1), 1.0, 0.4),
    "two": shapes.Cylinder((0, 0, -3), (0, 0, 3), 0.5),
}


@pytest.mark.parametrize("name", HOLES)
def test_hits_are_those_of_a_search_through_all_segments(name, monkeypatch):
    body = BLOCK - HOLES[name]
    if name == "bore":
        body = shapes.Revolved([(-1, 0.9), (1.5, 0.7), (0, 2)], (1, 1, 2), (0.1, 0, 0))
    if name == "two":
        body = body - shapes.Cylinder((-3, 0, 0), (3, 0, 0), 0.7)
    rng = np.random.default_rng(7)
    start = rng.uniform(-2.2, 2.2, (4000, 3))
    end = start + rng.normal(size=(4000, 3)) * rng.choice([1e-3, 0.3, 2.0], (4000, 1))
    hits, inside = body.first_hits(start, end), body.inside(start)
    asked = len(body._near(start, end))
    monkeypatch.setattr(Shape, "_near", lambda self, begin, finish: np.arange(len(begin)))
    monkeypatch.setattr(type(body), "_near", Shape._near)
    for ours, other in zip(hits, body.first_hits(start, end), strict=True):
        assert np.array_equal(ours, other)
    assert np.array_equal(inside, body.inside(start))
    assert name == "torus" or asked < 3900

"""Unions, differences and intersections: against the same operations on points."""

import numpy as np
import pytest

from amrpic import shapes
from amrpic.shapes import Box, Disk, Shape, Sphere
from bodies import BODIES


def random_tree(rng, depth):
    """Return a body and what lies in it."""
    if depth == 0 or rng.uniform() < 0.15:
        body, contains = list(BODIES.values())[rng.integers(len(BODIES))]
        by = rng.uniform(-0.2, 0.2, 3)
        return body.moved(by), lambda points: contains(points - by)
    (one, in_one), (other, in_other) = random_tree(rng, depth - 1), random_tree(rng, depth - 1)
    match rng.integers(3):
        case 0:
            return one | other, lambda points: in_one(points) | in_other(points)
        case 1:
            return one & other, lambda points: in_one(points) & in_other(points)
        case _:
            return one - other, lambda points: in_one(points) & ~in_other(points)


@pytest.mark.parametrize("seed", range(40))
def test_random_trees_hold_what_their_parts_say(seed):
    rng = np.random.default_rng(seed)
    body, contains = random_tree(rng, 4)
    points, direction = rng.uniform(-0.8, 0.8, (1500, 3)), rng.normal(size=(1500, 3))
    assert np.array_equal(body.inside(points), contains(points))
    spans = body.spans(points, direction)
    for parameter in rng.uniform(-0.8, 0.8, (4, 1500)):
        found = np.zeros(1500, bool)
        at = parameter[spans.line]
        found[spans.line[(spans.enter <= at) & (at <= spans.leave)]] = True
        assert np.array_equal(found, contains(points + parameter[:, None] * direction))
    assert (spans.enter < spans.leave).all()
    lower, upper = np.array(body.bounds)
    held = points[contains(points)]
    assert (held >= lower).all() and (held <= upper).all()


@pytest.mark.parametrize("seed", range(8))
def test_normals_of_trees_are_those_of_the_part_that_is_met(seed):
    rng = np.random.default_rng(seed)
    body, contains = random_tree(rng, 3)
    start, direction = rng.uniform(-0.8, 0.8, (500, 3)), rng.normal(size=(500, 3))
    spans = body.spans(start, direction)
    finite = np.isfinite(spans.enter)
    line = spans.line[finite]
    points = start[line] + spans.enter[finite, None] * direction[line]
    normals = body.normals(points, spans.first[finite], direction[line])
    right = ~contains(points + 1e-8 * normals) & contains(points - 1e-8 * normals)
    assert np.count_nonzero(~right) <= 0.005 * len(right)  # places within 1e-8 of an edge


def line_along_x(body, y=0.0, z=0.0):
    spans = body.spans([(0, y, z)], 0)
    return list(zip(spans.enter.tolist(), spans.leave.tolist(), strict=True))


LEFT, RIGHT = Box((0, -1, -1), (1, 1, 1)), Box((1, -1, -1), (2, 1, 1))
FOIL = Disk((1, 0, 0), (1, 0, 0), 0.5)


@pytest.mark.parametrize(
    "body, expected",
    [
        (LEFT | RIGHT, [(0, 2)]),
        (LEFT & RIGHT, []),
        (LEFT - RIGHT, [(0, 1)]),
        ((LEFT | RIGHT) - LEFT, [(1, 2)]),
        (LEFT - LEFT, []),
        (LEFT | FOIL, [(0, 1)]),
        (LEFT & FOIL, [(1, 1)]),
        (RIGHT & FOIL, [(1, 1)]),
        (FOIL - LEFT, []),
        (FOIL - RIGHT, []),
        (FOIL - Box((0, -1, 0.1), (2, 1, 1)), [(1, 1)]),
        (FOIL - Box((0, -1, -0.1), (2, 1, 1)), []),
        (Box((0, -1, -1), (2, 1, 1)) - FOIL, [(0, 2)]),
        (FOIL | FOIL.moved((1, 0, 0)), [(1, 1), (2, 2)]),
        (FOIL & FOIL, [(1, 1)]),
        (LEFT | RIGHT.moved((0.5, 0, 0)) | FOIL.moved((3, 0, 0)), [(0, 1), (1.5, 2.5), (4, 4)]),
    ],
)
def test_bodies_that_touch_and_foils_on_them_follow_one_rule(body, expected):
    assert line_along_x(body) == expected


def test_operations_do_not_depend_on_the_order_of_parts():
    rng = np.random.default_rng(3)
    parts: list[Shape] = [Sphere(tuple(rng.uniform(-0.5, 0.5, 3)), rng.uniform(0.1, 0.4)) for _ in range(6)]
    start, direction = rng.uniform(-1, 1, (2000, 3)), rng.normal(size=(2000, 3))
    union, other = parts[0], parts[-1]
    for part in parts[1:]:
        union = union | part
    for part in parts[-2::-1]:
        other = part | other
    spans, others = union.spans(start, direction), other.spans(start, direction)
    assert np.array_equal(spans.enter, others.enter) and np.array_equal(spans.leave, others.leave)


def test_what_is_no_shape_cannot_be_combined():
    with pytest.raises(TypeError):
        shapes.Sphere((0, 0, 0), 1) | 3  # type: ignore[operator]

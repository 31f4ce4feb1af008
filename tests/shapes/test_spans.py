"""Where lines enter and leave bodies: against functions of points, closed forms of volume and surface, and turned copies."""

import pickle

import numpy as np
import pytest

import bodies
from amrpic import shapes
from amrpic.shapes.shape import rotation
from amrpic.shapes.spans import Spans
from bodies import BODIES

NAMES = list(BODIES)


def random_lines(n, seed, reach=0.8):
    rng = np.random.default_rng(seed)
    return rng.uniform(-reach, reach, (n, 3)), rng.normal(size=(n, 3))


def within(spans: Spans, parameter: np.ndarray) -> np.ndarray:
    """Return whether one place on each line lies in a span."""
    found = np.zeros(len(parameter), bool)
    at = parameter[spans.line]
    found[spans.line[(spans.enter <= at) & (at <= spans.leave)]] = True
    return found


def measure(spans: Spans) -> float:
    return float((spans.leave - spans.enter).sum())


@pytest.mark.parametrize("name", NAMES)
def test_spans_hold_the_points_of_lines_that_lie_in_the_body(name):
    body, contains = BODIES[name]
    start, direction = random_lines(3000, 1)
    spans = body.spans(start, direction)
    for parameter in np.random.default_rng(2).uniform(-1, 1, (5, 3000)):
        points = start + parameter[:, None] * direction
        assert np.array_equal(within(spans, parameter), contains(points))
        assert np.array_equal(body.inside(points), contains(points))


@pytest.mark.parametrize("name", NAMES)
def test_spans_are_disjoint_and_in_order(name):
    spans = BODIES[name][0].spans(*random_lines(3000, 3))
    assert (spans.enter < spans.leave).all()
    same = spans.line[1:] == spans.line[:-1]
    assert (np.diff(spans.line) >= 0).all() and (spans.enter[1:] > spans.leave[:-1])[same].all()


@pytest.mark.parametrize("name", NAMES)
def test_ends_of_spans_lie_on_the_surface_to_rounding(name):
    body, contains = BODIES[name]
    start, direction = random_lines(3000, 4)
    spans = body.spans(start, direction)
    for ends, way in ((spans.enter, 1), (spans.leave, -1)):
        finite = np.isfinite(ends)
        line = spans.line[finite]
        inside, outside = (
            contains(start[line] + (ends[finite] + sign * way * 1e-11)[:, None] * direction[line]) for sign in (1, -1)
        )
        # Lines that touch an edge are within rounding of both sides.
        assert inside.mean() > 0.999 and outside.mean() < 0.001


@pytest.mark.parametrize("name", NAMES)
def test_normals_point_out_of_the_body(name):
    body, contains = BODIES[name]
    start, direction = random_lines(2000, 5)
    spans = body.spans(start, direction)
    for ends, surface, sign in ((spans.enter, spans.first, 1), (spans.leave, spans.last, -1)):
        finite = np.isfinite(ends)
        line = spans.line[finite]
        points = start[line] + ends[finite, None] * direction[line]
        normals = body.normals(points, surface[finite], sign * direction[line])
        assert np.linalg.norm(normals, axis=1) == pytest.approx(1)
        assert not contains(points + 1e-8 * normals).any() and contains(points - 1e-8 * normals).all()


@pytest.mark.parametrize("name", bodies.VOLUMES)
def test_lines_along_each_axis_measure_the_volume(name):
    body = BODIES[name][0]
    lower, upper = np.array(body.bounds)
    for axis in range(3):
        u, v = (a for a in range(3) if a != axis)
        n = 500 if name == "thin torus" else 300
        places = [lower[a] + (np.arange(n) + 0.5) / n * (upper - lower)[a] for a in (u, v)]
        start = np.zeros((n, n, 3))
        start[..., u], start[..., v] = np.meshgrid(*places, indexing="ij")
        volume = measure(body.spans(start.reshape(-1, 3), axis)) * (upper - lower)[[u, v]].prod() / n**2
        assert volume == pytest.approx(bodies.VOLUMES[name], rel=4e-3)


@pytest.mark.parametrize("name", bodies.SURFACES)
def test_random_lines_cross_the_surface_as_often_as_cauchy_and_crofton_say(name):
    """Lines that are uniform in a ball of radius R cross a surface of area A on average A / (2πR²) times."""
    body = BODIES[name][0]
    rng, n, radius = np.random.default_rng(6), 200_000, 1.0
    direction = rng.normal(size=(n, 3))
    direction /= np.linalg.norm(direction, axis=1)[:, None]
    place = rng.normal(size=(n, 3))
    place -= (place * direction).sum(axis=1)[:, None] * direction
    place *= (radius * np.sqrt(rng.uniform(size=n)) / np.linalg.norm(place, axis=1))[:, None]
    spans = body.spans(place, direction)
    per_line = np.bincount(spans.line, minlength=n) * 2
    expected = bodies.SURFACES[name] / (2 * np.pi * radius**2)
    assert abs(per_line.mean() - expected) < 4 * per_line.std() / np.sqrt(n)


@pytest.mark.parametrize("name", NAMES)
def test_a_turned_and_moved_body_is_met_where_turned_and_moved_lines_meet_it(name):
    body = BODIES[name][0]
    rng = np.random.default_rng(7)
    axis, angle = bodies.random_rotation(rng)
    by = rng.normal(size=3)
    start, direction = random_lines(1000, 8)
    turned = body.turned(axis, angle).moved(by)
    turn = rotation(tuple(axis / np.linalg.norm(axis)), angle)
    spans, others = body.spans(start, direction), turned.spans(start @ turn.T + by, direction @ turn.T)
    assert np.array_equal(spans.line, others.line)
    assert others.enter == pytest.approx(spans.enter, abs=1e-7)
    assert others.leave == pytest.approx(spans.leave, abs=1e-7)


@pytest.mark.parametrize("name", NAMES)
def test_a_scaled_body_holds_scaled_points(name):
    body, contains = BODIES[name]
    points, _ = random_lines(2000, 9)
    about, factor = np.array([0.1, -0.2, 0.3]), np.array([2.0, 0.5, 1.5])
    scaled = body.scaled(factor, about)
    assert np.array_equal(scaled.inside(about + factor * (points - about)), contains(points))


@pytest.mark.parametrize("name", NAMES)
def test_digits_do_not_depend_on_the_other_lines(name):
    body = BODIES[name][0].turned((1, 2, 3), 0.4)
    start, direction = random_lines(101, 10)
    together = body.spans(start, direction)
    for n in range(0, 101, 7):
        alone = body.spans(start[n : n + 1], direction[n : n + 1])
        own = together.line == n
        assert np.array_equal(alone.enter, together.enter[own]) and np.array_equal(alone.leave, together.leave[own])


@pytest.mark.parametrize("name", NAMES)
def test_bounds_hold_the_body_and_touch_it(name):
    body = BODIES[name][0]
    turned = body.turned((3, 1, 2), 1.1)
    for shape in (body, turned):
        lower, upper = np.array(shape.bounds)
        if np.isinf(lower).any():
            continue
        spans = shape.spans(*random_lines(20_000, 11))
        start, direction = random_lines(20_000, 11)
        points = np.concatenate(
            [start[spans.line] + ends[:, None] * direction[spans.line] for ends in (spans.enter, spans.leave)]
        )
        assert (points >= lower - 1e-9).all() and (points <= upper + 1e-9).all()
        if shape is body and name not in ("level set", "thin torus"):
            assert points.min(axis=0) == pytest.approx(lower, abs=0.05)


@pytest.mark.parametrize("name", NAMES)
def test_shapes_are_values(name):
    body = BODIES[name][0]
    for shape in (body, body.moved((1, 2, 3)), body | shapes.Sphere((0, 0, 0), 1), body - body.moved((0.1, 0, 0))):
        copy = pickle.loads(pickle.dumps(shape))
        assert copy == shape and hash(copy) == hash(shape)
        assert copy != shape.moved((0, 0, 1e-3))
        assert np.array_equal(copy.inside(random_lines(50, 1)[0]), shape.inside(random_lines(50, 1)[0]))


def test_segments_meet_a_body_where_they_enter_it():
    ball = shapes.Sphere((0, 0, 0), 1)
    start = [(-3, 0, 0), (-3, 2, 0), (0.5, 0, 0), (0, 0, -1.5), (0, 0, 3)]
    end = [(3, 0, 0), (3, 2, 0), (3, 0, 0), (0, 0, -1.2), (0, 0, 0)]
    hits = ball.first_hits(start, end)
    assert hits.segment.tolist() == [0, 2, 4]
    assert hits.share == pytest.approx([1 / 3, 0, 2 / 3])
    assert hits.normal == pytest.approx(np.array([(-1, 0, 0), (1, 0, 0), (0, 0, 1)]))


def test_first_hits_are_the_first_points_of_segments_that_lie_in_the_body():
    body = BODIES["torus"][0] | BODIES["cone with a tip"][0]
    start, way = random_lines(500, 12)
    hits = body.first_hits(start, start + way)
    shares = np.linspace(0, 1, 2001)
    inside = body.inside((start[:, None] + shares[:, None] * way[:, None]).reshape(-1, 3)).reshape(500, -1)
    first = np.where(inside.any(axis=1), shares[inside.argmax(axis=1)], np.inf)
    found = np.full(500, np.inf)
    found[hits.segment] = hits.share
    met = np.isfinite(first)
    assert (found[met] <= first[met] + 1e-12).all() and (found[met] >= first[met] - 1 / 2000 - 1e-12).all()


def test_a_foil_is_met_but_holds_nothing():
    foil = shapes.Disk((0, 0, 0.5), (0, 0, 1), 1)
    spans = foil.spans([(0, 0, 0), (0.9, 0.9, 0), (0, 0, 9)], (0, 0, 2))
    assert spans.line.tolist() == [0, 2] and spans.enter.tolist() == spans.leave.tolist() == [0.25, -4.25]
    assert len(foil.spans([(-3, 0, 0.5)], 0)) == 0  # along it
    tilted = foil.turned("x", 0.3)
    assert len(tilted.spans(random_lines(1000, 1)[0], 2)) == np.count_nonzero(
        (lambda p: p[:, 0] ** 2 + ((p[:, 1] + 0.5 * np.sin(0.3)) / np.cos(0.3)) ** 2 <= 1)(random_lines(1000, 1)[0])
    )


def test_quarter_turns_have_no_rounding():
    box = shapes.Box((-0.1, -0.2, -0.3), (0.1, 0.2, 0.3))
    turned = box.turned("x", np.pi / 2)
    assert turned.bounds == ((-0.1, -0.3, -0.2), (0.1, 0.3, 0.2))
    assert turned.spans([(0, 0, 0)], 1).leave.tolist() == [0.3]

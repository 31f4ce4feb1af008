"""Bodies of triangles: against formulas, for any order of triangles, with defects, and files that cannot be used."""

import pickle
import re

import numpy as np
import pytest

import stl
from amrpic import Electrode, shapes
from amrpic.conductors.arms import arms_of_boxes
from amrpic.errors import InputError
from arms_of_one_box import of_box

BALL = shapes.Sphere((0, 0, 0), 1)


def random_lines(n, seed):
    rng = np.random.default_rng(seed)
    return rng.uniform(-1.2, 1.2, (n, 3)), rng.normal(size=(n, 3))


def observed_order(n, errors):
    return -np.polyfit(np.log(n), np.log(errors), 1)[0]


def test_a_sphere_of_triangles_is_a_sphere_to_order_two():
    start, direction = random_lines(4000, 1)
    exact = BALL.spans(start, direction)
    rings = [8, 16, 32, 64]
    errors, volumes = [], []
    for n in rings:
        spans = shapes.Mesh(stl.sphere(n)).spans(start, direction)
        errors.append(1 - (spans.leave - spans.enter).sum() / (exact.leave - exact.enter).sum())
        both = np.isin(exact.line, spans.line)
        volumes.append(np.abs(exact.enter[both] - spans.enter).mean())
    assert observed_order(rings, errors) > 1.9 and observed_order(rings, volumes) > 1.8
    assert errors[-1] < 2e-3


def test_a_box_of_triangles_is_the_box():
    lower, upper = (-0.5, -0.25, -0.75), (0.5, 1.0, 0.25)
    mesh, box = shapes.Mesh(stl.box(lower, upper)), shapes.Box(lower, upper)
    assert mesh.bounds == box.bounds and mesh.report.open_edges == 0
    start, direction = random_lines(5000, 2)
    spans, expected = mesh.spans(start, direction), box.spans(start, direction)
    assert np.array_equal(spans.line, expected.line)
    assert spans.enter == pytest.approx(expected.enter, abs=1e-9)
    points = start[spans.line] + spans.leave[:, None] * direction[spans.line]
    normals = mesh.normals(points, spans.last, -direction[spans.line])
    assert normals == pytest.approx(box.normals(points, expected.last, -direction[spans.line]), abs=1e-12)


def test_lines_through_edges_and_corners_enter_as_often_as_they_leave():
    """Lines of a lattice whose points are corners, along the axes and diagonals."""
    for triangles in (stl.box(), stl.sphere(8), np.round(8 * stl.sphere(6)) / 8):
        mesh = shapes.Mesh(triangles)
        grid = np.linspace(-1, 1, 17)
        start = np.stack(np.meshgrid(grid, grid, grid, indexing="ij"), axis=-1).reshape(-1, 3)
        for direction in [(1, 0, 0), (0, 1, 0), (0, 0, 1), (0, 0, -1), (1, 1, 0), (1, -1, 1), (0, 1, 2)]:
            vectors = np.tile(np.array(direction, float), (len(start), 1))
            line, _, depth, *_ = mesh._triangles.crossings(start, vectors)
            assert not np.bincount(line, depth, len(start)).any()
            assert abs(depth).max() == 1


@pytest.mark.parametrize("shift", [0, 1e-16, -1e-16])
def test_a_box_of_triangles_on_planes_of_centres_is_cut_as_the_box(shift):
    lower, upper = np.array((0.25, 0.35, 0.45)) + shift, np.array((0.55, 0.55, 0.65)) - shift
    arms = [
        arms_of_boxes([Electrode("a", shape, voltage=1)], [[0, 0, 0, 9, 9, 9]], 0.0, 0.1)[0]
        for shape in (shapes.Mesh(stl.box(lower, upper)), shapes.Box(tuple(lower), tuple(upper)))
    ]
    assert np.array_equal(arms[0].solid, arms[1].solid) and len(arms[0].solid) == 4 * 3 * 3
    assert np.array_equal(arms[0].cell, arms[1].cell)
    assert arms[0].theta == pytest.approx(arms[1].theta, abs=1e-9)


def random_surface(rng):
    """Return a closed surface of some pieces, on a coarse lattice so that many lines meet corners."""
    pieces = [
        stl.sphere(int(rng.integers(3, 9)), 0.6),
        stl.torus(int(rng.integers(6, 14))),
        stl.box((-0.5,) * 3, (0.5,) * 3),
    ]
    chosen = [pieces[n] + rng.uniform(-0.4, 0.4, 3) for n in rng.integers(0, 3, rng.integers(1, 4))]
    triangles = np.concatenate(chosen)
    return np.round(triangles * 16) / 16 if rng.uniform() < 0.5 else triangles


@pytest.mark.parametrize("seed", range(25))
def test_inside_is_where_the_winding_number_is_above_a_half(seed):
    rng = np.random.default_rng(seed)
    triangles = random_surface(rng)
    lost = rng.permutation(len(triangles))[: rng.integers(0, 2) if len(triangles) > 90 else 0]  # a small hole, or none
    mesh = shapes.Mesh(np.delete(triangles, lost, axis=0))
    points = np.concatenate([rng.uniform(-1.2, 1.2, (500, 3)), rng.integers(-9, 10, (300, 3)) / 8 + 1 / 64])
    points += rng.uniform(-1, 1, points.shape) * 1e-3 * (rng.uniform(size=(800, 1)) < 0.5)
    number = stl.winding_number(points, triangles)
    clear = abs(number - np.round(number)) < 1e-6  # not on the surface
    near_hole = len(lost) > 0 and np.linalg.norm(points - triangles[lost].mean(axis=(0, 1)), axis=1) < 0.3
    sure = clear & ~np.broadcast_to(near_hole, clear.shape)
    assert sure.mean() > 0.8
    assert np.array_equal(mesh.inside(points)[sure], number[sure] > 0.5)
    start, direction = random_lines(800, seed)
    line, _, depth, *_ = mesh._triangles.crossings(start, direction)
    assert not np.bincount(line, depth).any()


def test_digits_do_not_depend_on_the_order_of_triangles_or_of_their_corners():
    triangles = stl.sphere(12)
    rng = np.random.default_rng(3)
    mixed = np.stack([np.roll(t, rng.integers(3), axis=0) for t in rng.permutation(triangles)])
    one, other = shapes.Mesh(triangles), shapes.Mesh(mixed)
    assert one == other and hash(one) == hash(other)
    start, direction = random_lines(2000, 4)
    spans, others = one.spans(start, direction), other.spans(start, direction)
    assert all(
        np.array_equal(getattr(spans, name), getattr(others, name)) for name in ("line", "enter", "leave", "first")
    )


def test_arms_of_triangles_do_not_depend_on_boxes():
    electrodes = [Electrode("a", shapes.Mesh(np.round(8 * stl.sphere(6)) / 8), voltage=1)]
    whole, _ = arms_of_boxes(electrodes, [[0, 0, 0, 15, 15, 15]], -1.25, 2.5 / 16)
    parts = [[i, j, k, i + 3, j + 7, k + 3] for k in range(0, 16, 4) for j in range(0, 16, 8) for i in range(0, 16, 4)]
    arms, _ = arms_of_boxes(electrodes, parts, -1.25, 2.5 / 16)
    theta = np.full((16, 16, 16, 6), np.inf)
    for number, box in enumerate(parts):
        own = of_box(arms, number)
        k, j, i = np.unravel_index(own.cell, (4, 8, 4))
        theta[k + box[2], j + box[1], i + box[0]] = own.theta
    expected = np.full((4096, 6), np.inf)
    expected[whole.cell] = whole.theta
    assert np.array_equal(theta.reshape(-1, 6), expected) and len(arms.solid) == len(whole.solid) > 100


@pytest.mark.parametrize("write", [stl.write_binary, stl.write_text])
def test_files_are_read_with_their_unit(tmp_path, write):
    mesh = shapes.Mesh(write(tmp_path / "ball.stl", 250 * stl.sphere(8)), unit="mm")
    assert mesh.bounds[1] == pytest.approx((0.25, 0.25, 0.25), rel=1e-6) and str(mesh.report) == "224 triangles, closed"
    copy = pickle.loads(pickle.dumps(mesh))
    (tmp_path / "ball.stl").unlink()
    assert copy == mesh and copy.inside([(0.1, 0, 0), (0.3, 0, 0)]).tolist() == [True, False]


def test_a_binary_file_may_begin_with_the_word_of_text_files(tmp_path):
    path = stl.write_binary(tmp_path / "a.stl", stl.box())
    path.write_bytes(b"solid facet" + path.read_bytes()[11:])
    assert shapes.Mesh(path).report.triangles == 12


def same_body(mesh, expected, seed=5):
    """Whether spans are those of another body but for a few lines."""
    start, direction = random_lines(3000, seed)
    points = start + np.random.default_rng(seed).uniform(-1, 1, (3000, 1)) * direction
    return np.array_equal(mesh.inside(points), expected.inside(points))


DEFECTS = {
    "all flipped": lambda t, rng: t[:, ::-1],
    "every third flipped": lambda t, rng: np.where((np.arange(len(t)) % 3 == 0)[:, None, None], t[:, ::-1], t),
    "any flipped": lambda t, rng: np.where((rng.uniform(size=len(t)) < 0.5)[:, None, None], t[:, ::-1], t),
    "some twice": lambda t, rng: np.concatenate([t, t[::5], t[::7, [1, 2, 0]]]),
    "some twice and flipped": lambda t, rng: np.concatenate([t, t[::5, ::-1]]),
    "some without area": lambda t, rng: np.concatenate([t, t[:9, [0, 0, 1]], t[:9, [1, 1, 1]]]),
    "corners rounded apart": lambda t, rng: t + rng.uniform(-1e-8, 1e-8, t.shape),
    "an edge split on one side": lambda t, rng: np.concatenate(
        [t[1:], [[t[0, 0], (t[0, 0] + t[0, 1]) / 2, t[0, 2]], [(t[0, 0] + t[0, 1]) / 2, t[0, 1], t[0, 2]]]]
    ),
}


@pytest.mark.parametrize("name", DEFECTS)
def test_defects_are_repaired(name):
    triangles = stl.sphere(12)
    mesh = shapes.Mesh(DEFECTS[name](triangles, np.random.default_rng(6)))
    assert same_body(mesh, shapes.Mesh(triangles))


def test_small_holes_are_closed_and_reported():
    triangles = stl.sphere(16)
    middle = triangles.mean(axis=1)
    gone = [*np.linalg.norm(middle - (0, 0.98, 0.1), axis=1).argsort()[:2].tolist(), 500]
    mesh = shapes.Mesh(np.delete(triangles, gone, axis=0))
    report = mesh.report
    lost = triangles[gone]
    area = np.linalg.norm(np.cross(lost[:, 1] - lost[:, 0], lost[:, 2] - lost[:, 0]), axis=1).sum() / 2
    assert report.holes == 2 and report.open_edges == 7 and report.hole_area == pytest.approx(area, rel=0.05)
    assert re.fullmatch(r"957 triangles, 7 open edges around 2 holes of 0\.0\d+ m² in all, closed", str(report))
    start, direction = random_lines(4000, 7)
    spans, whole = mesh.spans(start, direction), shapes.Mesh(triangles).spans(start, direction)
    assert (spans.leave - spans.enter).sum() == pytest.approx((whole.leave - whole.enter).sum(), rel=1e-3)
    line, _, depth, *_ = mesh._triangles.crossings(start, direction)
    assert not np.bincount(line, depth).any()


def test_hollows_parts_and_overlaps_are_what_they_look_like():
    outer, inner = shapes.Box((-1,) * 3, (1,) * 3), shapes.Box((-0.5,) * 3, (0.5,) * 3)
    shell = np.concatenate([stl.box(), stl.box((-0.5,) * 3, (0.5,) * 3)[:, ::-1]])
    assert same_body(shapes.Mesh(shell), outer - inner)
    apart = np.concatenate([stl.box((-1,) * 3, (-0.5,) * 3), stl.box((0.2,) * 3, (0.9,) * 3)[:, ::-1]])
    assert same_body(shapes.Mesh(apart), shapes.Box((-1,) * 3, (-0.5,) * 3) | shapes.Box((0.2,) * 3, (0.9,) * 3))
    across = np.concatenate([stl.box((-1,) * 3, (0.3,) * 3), stl.box((-0.2,) * 3, (0.9,) * 3)])
    assert same_body(shapes.Mesh(across), shapes.Box((-1,) * 3, (0.3,) * 3) | shapes.Box((-0.2,) * 3, (0.9,) * 3))


def test_an_open_surface_may_be_a_foil():
    tube = stl.sphere(16)
    tube = tube[abs(tube[..., 2]).max(axis=1) < 0.8]
    with pytest.raises(InputError, match="open edges around holes of"):
        shapes.Mesh(tube)
    foil = shapes.Mesh(tube, foil=True)
    spans = foil.spans([(0, 0, 0), (0, 0, 0.9)], 0)
    assert np.array_equal(spans.enter, spans.leave) and spans.line.tolist() == [0, 0]
    assert spans.enter == pytest.approx([-1, 1], abs=0.02)
    assert foil != shapes.Mesh(stl.sphere(16), foil=True)


def test_combined_moved_and_turned_triangles():
    mesh = shapes.Mesh(stl.box())
    for body, expected in (
        (mesh - BALL, shapes.Box((-1,) * 3, (1,) * 3) - BALL),
        (mesh.turned((1, 2, 3), 0.7).scaled(0.5), shapes.Box((-1,) * 3, (1,) * 3).turned((1, 2, 3), 0.7).scaled(0.5)),
        (BALL & mesh.moved((0.3, 0.4, 0.5)), BALL & shapes.Box((-0.7, -0.6, -0.5), (1.3, 1.4, 1.5))),
    ):
        assert same_body(body, expected)


def cut_off(path):
    path.write_bytes(path.read_bytes()[:-20])


def with_text(text):
    return lambda path: path.write_text(text)


def facet(rows):
    return "solid a\nfacet normal 0 0 0\nouter loop\n" + "\n".join(rows) + "\nendloop\nendfacet\nendsolid a\n"


BROKEN_FILES = {
    "none": (lambda path: path.unlink(), "cannot be read"),
    "a folder": (lambda path: (path.unlink(), path.mkdir()), "cannot be read"),
    "empty": (lambda path: path.write_bytes(b""), "has 0 bytes"),
    "cut off": (cut_off, "is cut off or no STL file"),
    "something else": (lambda path: path.write_bytes(bytes(range(256)) * 9), "no STL file"),
    "no triangles": (lambda path: path.write_bytes(bytes(84)), "has no triangles"),
    "text without triangles": (with_text("solid a\nfacets\nendsolid a\n" * 9), "has no triangles"),
    "a word for a number": (
        with_text(facet(["vertex 0 0 0", "vertex 1 x 0", "vertex 0 1 0"])),
        '"vertex 1 x 0" in line 5',
    ),
    "two numbers": (with_text(facet(["vertex 0 0 0", "vertex 1 0", "vertex 0 1 0"])), '"vertex 1 0" in line 5'),
    "two corners": (with_text(facet(["vertex 0 0 0", "vertex 1 0 0"])), "2 corners in 1 facets"),
    "text cut off": (with_text(facet(["vertex 0 0 0", "vertex 1 0 0", "vertex 0 1 0"])[:62]), "three numbers"),
    "not finite": (with_text(facet(["vertex 0 0 0", "vertex nan 0 0", "vertex 0 1 0"])), "not finite"),
    "no area": (with_text(facet(["vertex 0 0 0", "vertex 1 0 0", "vertex 2 0 0"])), "have no area"),
    "one triangle": (with_text(facet(["vertex 0 0 0", "vertex 1 0 0", "vertex 0 1 0"])), "foil=True"),
    "flat": (lambda path: stl.write_binary(path, stl.box() * (1, 1, 0)), "no volume"),
    "open": (lambda path: stl.write_binary(path, stl.box()[2:]), "open edges around holes"),
}


@pytest.mark.parametrize("name", BROKEN_FILES)
def test_broken_files_get_one_sentence_with_the_file_and_a_remedy(tmp_path, name):
    path = stl.write_binary(tmp_path / "part.stl", stl.box())
    breaks, sentence = BROKEN_FILES[name]
    breaks(path)
    with pytest.raises(InputError) as refused:
        shapes.Mesh(path)
    text = str(refused.value)
    assert sentence in text and "part.stl" in text and "\n" not in text and re.search("[;:,] ", text)


def test_units_and_arrays_are_checked():
    with pytest.raises(InputError, match='its unit is "inch"; use one of m, cm'):
        shapes.Mesh(stl.box(), unit="inch")
    with pytest.raises(InputError, match=r"have shape \(2, 3\)"):
        shapes.Mesh(np.zeros((2, 3)))

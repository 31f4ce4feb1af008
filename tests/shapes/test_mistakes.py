"""Shapes that cannot be: one sentence each, with the value that was given and what to do."""

import re
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from amrpic import shapes as checked_shapes
from amrpic.errors import InputError

shapes: Any = checked_shapes  # what is wrong on purpose is no mistake of types
BALL = shapes.Sphere((0, 0, 0), 1)

SHAPES: dict[str, tuple[Callable[[], object], str]] = {
    "no radius": (lambda: shapes.Sphere((0, 0, 0), 0), "Sphere: radius is 0"),
    "a negative radius": (lambda: shapes.Sphere((0, 0, 0), -0.3), "Sphere: radius is -0.3"),
    "a radius that is no number": (lambda: shapes.Sphere((0, 0, 0), "3 mm"), "Sphere: radius is '3 mm'"),
    "a point of two": (lambda: shapes.Sphere((0, 0), 1), r"Sphere: centre is \(0, 0\), which is no point"),
    "a point at infinity": (lambda: shapes.Sphere((0, 0, np.inf), 1), "which is not finite"),
    "a box inside out": (lambda: shapes.Box((0, 2, 0), (1, 1, 1)), "Box reaches from 2 to 1 m along y"),
    "a rod of no length": (lambda: shapes.Cylinder((1, 2, 3), (1, 2, 3), 1), "start and end are the same point"),
    "a cone of no width": (lambda: shapes.Cone((0, 0, 0), (0, 0, 1), 0, 0), "its radii are 0 and 0 m"),
    "a cone of negative width": (lambda: shapes.Cone((0, 0, 0), (0, 0, 1), 1, -1), "its radii are 1 and -1 m"),
    "an axis of no length": (lambda: shapes.Torus((0, 0, 0), (0, 0, 0), 2, 1), "which has no direction"),
    "an axis of no name": (lambda: shapes.Torus((0, 0, 0), "w", 2, 1), 'Torus: axis is "w"'),
    "a thick tube": (lambda: shapes.Torus((0, 0, 0), "z", 1, 2), "its tube, 2 m, is not below its radius, 1 m"),
    "a plane of no normal": (lambda: shapes.Plane((0, 0, 0), (0, 0, 0)), "Plane: normal"),
    "a disk of no size": (lambda: shapes.Disk((0, 0, 0), (0, 0, 1), 0), "Disk: radius is 0"),
    "two points": (lambda: shapes.Revolved([(0, 0), (1, 1)]), "its 2 different points enclose no area"),
    "points on a line": (lambda: shapes.Revolved([(0, 0), (1, 1), (2, 2)]), "enclose no area"),
    "a negative distance": (lambda: shapes.Revolved([(0, -1), (1, 1), (2, 0)]), "point 0 has the radius -1 m"),
    "a point that is not finite": (lambda: shapes.Revolved([(0, 0), (1, np.nan), (2, 0)]), "point 1 is not finite"),
    "points of three": (lambda: shapes.Revolved([(0, 0, 0), (1, 1, 1)]), "no pairs of numbers"),
    "a loop": (
        lambda: shapes.Revolved([(0, 0.1), (1, 0.5), (1, 0.1), (0, 0.8)]),
        "the edges after points 0 and 2 meet",
    ),
    "no function": (lambda: shapes.LevelSet(3, (0, 0, 0), (1, 1, 1)), "LevelSet: function is 3"),
    "no number": (lambda: shapes.LevelSet(lambda x, y, z: x * np.nan, (0, 0, 0), (1, 1, 1)), r"not a number at \("),
    "one sample": (lambda: shapes.LevelSet(lambda x, y, z: x, (0, 0, 0), (1, 1, 1), samples=1), "samples is 1"),
    "a turn without an angle": (lambda: BALL.turned("x", "much"), "turned: angle is 'much'"),
    "a scale of zero": (lambda: BALL.scaled(0), "scaled: factor is 0"),
    "a scale of two numbers": (lambda: BALL.scaled((1, 2)), r"scaled: factor is \(1, 2\)"),
    "a move by two numbers": (lambda: BALL.moved((1, 2)), r"moved: by is \(1, 2\)"),
    "points of two numbers": (lambda: BALL.spans(np.zeros((3, 2)), 0), r"start has shape \(3, 2\)"),
    "a point that is lost": (lambda: BALL.first_hits([(0, 0, np.nan)], [(0, 0, 0)]), "not finite in row 0"),
}


@pytest.mark.parametrize("name", SHAPES)
def test_shapes_that_cannot_be_get_one_sentence(name):
    make, sentence = SHAPES[name]
    with pytest.raises(InputError, match=sentence) as refused:
        make()
    assert "\n" not in str(refused.value) and re.search("[;,] ", str(refused.value))


FILES: dict[str, tuple[str | bytes, str]] = {
    "empty": ("", "its 0 different points"),
    "a title alone": ("z,r\n", "its 0 different points"),
    "a word": ("z,r\n0,0\n1,one\n", '"1,one" in line 3'),
    "three columns": ("0,0,0\n", '"0,0,0" in line 1'),
    "one column": ("# outline\n0\n1\n", '"0" in line 2'),
    "not finite": ("0,0\n1,inf\n2,0\n", "point 1 is not finite"),
    "inside out": ("0,0\n1,-1\n2,0\n", "point 1 has the radius -1 m"),
    "no text": (b"\xff\xfe\x00\x81", "is no text"),
}


@pytest.mark.parametrize("name", FILES)
def test_outlines_that_cannot_be_read_get_one_sentence_with_the_file(tmp_path, name):
    text, sentence = FILES[name]
    path = tmp_path / "outline.csv"
    path.write_bytes(text if isinstance(text, bytes) else text.encode())
    with pytest.raises(InputError) as refused:
        shapes.Revolved(path)
    assert sentence in str(refused.value) and "outline.csv" in str(refused.value) and "\n" not in str(refused.value)


def test_outlines_are_read_from_files(tmp_path):
    path = tmp_path / "outline.csv"
    path.write_text("# an outline\nz; r\n\n0; 0\n1; 0.5\n1; 0\n")
    assert shapes.Revolved(path) == shapes.Revolved([(0, 0), (1, 0.5), (1, 0)])
    with pytest.raises(InputError, match="cannot be read"):
        shapes.Revolved(tmp_path / "none.csv")


def test_a_cone_turned_from_its_outline_is_the_cone():
    rng = np.random.default_rng(1)
    start, direction = rng.uniform(-1, 1, (2000, 3)), rng.normal(size=(2000, 3))
    axis = np.array((1.0, 2.0, 2.0)) / 3
    outline = shapes.Revolved([(-0.5, 0), (-0.5, 0.2), (0.5, 0.6), (0.5, 0)], axis=tuple(axis), origin=(0.1, 0, 0))
    cone = shapes.Cone(tuple((0.1, 0, 0) - axis / 2), tuple((0.1, 0, 0) + axis / 2), 0.2, 0.6)
    spans, expected = outline.spans(start, direction), cone.spans(start, direction)
    assert np.array_equal(spans.line, expected.line)
    assert spans.enter == pytest.approx(expected.enter, abs=1e-12)
    assert spans.leave == pytest.approx(expected.leave, abs=1e-12)


@pytest.mark.parametrize("reverse", [False, True])
def test_an_outline_may_be_walked_either_way_and_may_have_hollows(reverse):
    ring = [(-0.5, 0.3), (0.5, 0.3), (0.5, 0.8), (-0.5, 0.8)]
    body = shapes.Revolved(ring[::-1] if reverse else ring)
    whole = shapes.Cylinder((0, 0, -0.5), (0, 0, 0.5), 0.8) - shapes.Cylinder((0, 0, -1), (0, 0, 1), 0.3)
    rng = np.random.default_rng(2)
    start, direction = rng.uniform(-1, 1, (2000, 3)), rng.normal(size=(2000, 3))
    spans, expected = body.spans(start, direction), whole.spans(start, direction)
    assert np.array_equal(spans.line, expected.line)
    assert spans.enter == pytest.approx(expected.enter, abs=1e-12)

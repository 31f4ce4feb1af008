"""Planes, lines and pictures of fields: the finest cell at each place."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any, cast

import numpy as np
import pytest
from matplotlib.collections import LineCollection

import amrpic

DOMAIN = amrpic.Domain((-1, -2, 0), (1, 2, 6), (8, 16, 24))
FINE = [((4, 8, 16), (11, 23, 31))]


def field(comm) -> amrpic.Field:
    hierarchy = amrpic.Hierarchy(comm, DOMAIN, [FINE], max_grid_size=8, blocking_factor=4)
    return amrpic.Field(hierarchy, "V").fill(lambda x, y, z: x + 10 * y + 100 * z).average_down()


def finest_centre(x: np.ndarray, low: float, high: float) -> np.ndarray:
    """Centre of the cell that holds a coordinate where the fine level reaches from low to high; base cells are 0.25 wide."""
    width = np.where((x > low) & (x < high), 0.125, 0.25)
    return (np.floor(x / width) + 0.5) * width


@pytest.mark.mpi(ranks=(1, 2))
def test_a_slice_has_coordinates_and_the_finest_cell_at_each(comm):
    shown = field(comm).slice("x", 0.3)
    assert (shown.axis, shown.axes, shown.position, shown.values.shape) == (0, (2, 1), 0.3, (48, 32))
    z, y = np.meshgrid(*shown.centres, indexing="ij")
    inside = (abs(y) < 1) & (z > 2) & (z < 4)
    width = np.where(inside, 0.125, 0.25)
    cell = [(np.floor(at / width) + 0.5) * width for at in (np.full_like(y, 0.3), y, z)]
    np.testing.assert_allclose(shown.values, cell[0] + 10 * cell[1] + 100 * cell[2], rtol=1e-13)
    np.testing.assert_array_equal(field(comm).slice(0, 0.3).values, shown.values)
    middle = field(comm).slice()
    assert (middle.axis, middle.position) == (2, 3.0)


@pytest.mark.mpi(ranks=(1, 2))
def test_a_level_by_itself_is_nan_where_it_has_no_cells(comm):
    alone = field(comm).slice("z", 3.0, level=1)
    assert np.isfinite(alone.values).sum() == 8 * 16
    assert np.isnan(field(comm).slice("z", 0.1, level=1).values).all()


@pytest.mark.mpi(ranks=(1, 2))
def test_a_line_runs_from_start_to_end_through_the_finest_cells(comm):
    along = field(comm).line((0.3, 0.2, 0), (0.3, 0.2, 6))
    assert along.unit == "V" and along.values.shape == (96,) and along.distance[-1] == pytest.approx(6)
    np.testing.assert_allclose(along.points[[0, -1]], [(0.3, 0.2, 0), (0.3, 0.2, 6)], atol=1e-15)
    z = along.distance[1:-1]  # the ends lie on walls
    x, y = (np.where((z > 2) & (z < 4), fine, coarse) for fine, coarse in ((0.3125, 0.375), (0.1875, 0.125)))
    np.testing.assert_allclose(along.values[1:-1], x + 10 * y + 100 * finest_centre(z, 2, 4), rtol=1e-12)
    assert field(comm).line((0, 0, 1), (0, 0, 2), count=7).values.shape == (7,)


@pytest.mark.mpi(ranks=(1, 2))
def test_a_picture_has_the_values_labels_with_units_and_boxes(comm):
    one = field(comm)
    figure = one.plot("y", 0.1, name="φ")
    panel = figure.axes[0]
    shown = one.slice("y", 0.1)
    np.testing.assert_allclose(np.asarray(panel.images[0].get_array()), shown.values.T, rtol=1e-13)
    assert (panel.get_xlabel(), panel.get_ylabel(), panel.get_title()) == ("z / m", "x / m", "φ at y = 0.1 m")
    assert figure.axes[1].get_ylabel() == "φ / V"
    outlines = [len(c.get_segments()) for c in panel.collections if isinstance(c, LineCollection)]
    assert outlines == [len({tuple(b) for b in np.delete(cut, [1, 4], 1).tolist()}) for cut in cut_boxes(one, 0.1)]
    assert not one.plot("y", 0.1, boxes=False).axes[0].collections
    assert figure._repr_png_().startswith(b"\x89PNG")


def cut_boxes(one: amrpic.Field, y: float) -> list[np.ndarray]:
    """The boxes of each level that hold a place along y."""
    out = []
    for level in range(one.hierarchy.levels):
        boxes, cell = one.hierarchy.boxes(level), np.floor((y + 2) / one.hierarchy.spacing(level)[1])
        out.append(boxes[(boxes[:, 1] <= cell) & (cell <= boxes[:, 4])])
    return out


def test_scales_and_profiles_are_drawn(comm):
    one = field(comm)
    assert one.plot(scale="log").axes[0].images[0].norm.vmax == pytest.approx(np.abs(one.slice().values).max())
    curve = one.line((0, 0, 0), (0, 0, 6)).plot()
    assert curve.axes[0].get_xlabel() == "distance along the line / m"
    assert curve.axes[0].get_ylabel() == "value / V"
    plain = amrpic.Field(one.hierarchy).fill(2.0).plot(name="number")
    assert plain.axes[1].get_ylabel() == "number"


def test_tables_for_notebooks_hold_what_there_is_and_load_nothing(comm, tmp_path):
    one = field(comm)
    solver = amrpic.PoissonSolver(one.hierarchy)
    rho = amrpic.Field(one.hierarchy, "C/m^3").fill(1e-9)
    _, report = solver.solve(rho)
    scene = amrpic.Scene(name="a <b>", domain=DOMAIN, schedule={"steps": 3})
    shown = {
        "field": one._repr_html_(),
        "vector": amrpic.VectorField(one, one, one)._repr_html_(),
        "hierarchy": one.hierarchy._repr_html_(),
        "report": report._repr_html_(),
        "scene": scene._repr_html_(),
        "results": amrpic.open(tmp_path)._repr_html_(),
    }
    for text in shown.values():
        assert text.startswith("<table>") and text.count("<tr>") == text.count("</tr>") > 1
        assert not re.search(r"src=|href=|<script|http", text)
    assert "<td>1</td><td>2048</td>" in shown["field"] and f"<td>{one.min():.4g}</td>" in shown["field"]
    assert "250 mm" in shown["hierarchy"] and "125 mm" in shown["hierarchy"]
    assert f"<td>{report.residuals[-1]:.2e}</td>" in shown["report"]
    assert "a &lt;b&gt;: 8x16x24 cells" in shown["scene"] and "<td>schedule</td>" in shown["scene"]
    assert "<td>tables</td><td>none</td>" in shown["results"]


@pytest.mark.mpi(ranks=(1, 2))
@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda f: f.slice("w"), "'w' is no axis; use one of x, y, z"),
        (lambda f: f.slice("z", 7.0), "the plane at z = 7 m lies outside the domain, which reaches from 0 to 6 m; choose"),
        (lambda f: f.slice("z", float("nan")), "lies outside the domain"),
        (lambda f: f.plot(scale="cubic"), "'cubic' is no scale of colours; use one of auto, linear, symmetric, log"),
        (lambda f: f.plot("z", 0.1, level=1), "level 1 of the field holds no finite value in this plane; choose another"),
        (lambda f: f.line((0, 0, 0), (0, 0, 0)), "has no direction; give two points in m"),
        (lambda f: f.line((0, 0), (1, 1)), r"points have shape \(2,\); give an array of \(x, y, z\) in m, of shape"),
        (lambda f: f.sample([(0, 0), (0, 1), (1, 1)]), r"points have shape \(3, 2\); give an array of \(x, y, z\)"),
        (lambda f: f.sample("here"), r"'here' are no points; give an array of \(x, y, z\) in m"),
        (lambda f: f.fill("much"), "a field cannot be filled with 'much'; give a number, or a function of x, y and z in m"),
        (lambda f: f.fill(lambda x, y, z: np.zeros(3)), r"the function gives an array of shape \(3,\) for a box of \(\d+, \d+"),
        (lambda f: amrpic.Field(f), "a field was given Field.* to live on; give an amrpic.Hierarchy"),
        (lambda f: f.to_xarray("fine"), "level 'fine' does not exist; the hierarchy has levels 0 to 1"),
        (lambda f: amrpic.PoissonSolver(f), "a solver was given Field.* to solve on; give an amrpic.Hierarchy"),
        (lambda f: amrpic.PoissonSolver(f.hierarchy).solve(f.array(0)), "rho is of type ndarray; give an amrpic.Field on"),
        (lambda f: amrpic.PoissonSolver(f.hierarchy).solve(f, guess=cast(Any, 1.0)), "guess is of type float; give an"),
        (lambda f: amrpic.Simulation("drift.toml"), "a simulation was given 'drift.toml' to run; give an amrpic.Scene"),
    ],
)  # fmt: skip
def test_mistakes_in_python_are_one_sentence(comm, call, message):
    with pytest.raises(amrpic.AmrpicError, match=message) as refused:
        call(field(comm))
    assert "\n" not in str(refused.value)


def test_numbers_and_single_points_are_taken(comm):
    one = field(comm)
    assert one.fill(3.0).max() == one.min() == 3.0 and one.sum() == 3.0 * (8 * 16 * 24 - 256 + 2048)
    assert one.sample((0, 0, 1)).shape == (1,) and one.sample([]).shape == (0,)
    assert amrpic.Domain(-1, 1, 4).cells == (4, 4, 4)


def test_the_page_on_fields_runs(comm, tmp_path, monkeypatch):
    page = (Path(__file__).parents[2] / "docs" / "fields.md").read_text()
    monkeypatch.chdir(tmp_path)
    held: dict[str, Any] = {}
    exec("".join(re.findall(r"^```python\n(.*?)^```", page, re.M | re.S)), held)
    assert (tmp_path / "phi.png").read_bytes().startswith(b"\x89PNG")
    assert held["along"].values.max() == pytest.approx(held["phi"].max(), rel=1e-12)

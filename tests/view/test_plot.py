"""Pictures show what was computed."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from matplotlib.backends.backend_agg import FigureCanvasAgg

from amrpic import Domain, Field, Hierarchy, Scene, Simulation, VectorField
from amrpic.errors import InputError, OutputError
from amrpic.io import vtkhdf_writer
from amrpic.io.field_reader import CheckpointDump, Dump, open_dump
from amrpic.io.provenance import Moment, Provenance
from amrpic.mesh import raster
from amrpic.units import quantity
from amrpic.view import draw, figures, views

DOMAIN = Domain(lower=(-0.02, -0.03, 0.01), upper=(0.02, 0.01, 0.17), cells=(16, 16, 32), boundary="dirichlet")
LEVELS = [[((8, 8, 8), (23, 23, 47))], [((24, 24, 40), (39, 39, 55))]]


def dumped(comm, folder, density):
    """Write a dump of three levels with φ = x + 10 y + 100 z and E = (x, y, z); return its path."""
    hierarchy = Hierarchy(comm, DOMAIN, LEVELS, max_grid_size=16, blocking_factor=8)
    phi = Field(hierarchy, "V").fill(lambda x, y, z: x + 10 * y + 100 * z)
    efield = VectorField(*(Field(hierarchy, "V/m").fill(lambda *at, i=i: at[i]) for i in range(3)))
    rho = Field(hierarchy, "C/m^3").fill(density).average_down()
    path = vtkhdf_writer.path_of(folder, 3)
    vtkhdf_writer.write(path, hierarchy, {"phi": phi, "rho": rho, "E": efield}, Moment(3, 2e-9), Provenance())
    return path


def cloud(x, y, z):
    return 1e-6 * np.exp(-((x / 4e-3) ** 2) - ((y + 0.01) / 4e-3) ** 2 - ((z - 0.09) / 3e-2) ** 2)


@pytest.mark.parametrize("axis", [0, 1, 2])
def test_a_slice_holds_the_finest_cells_in_their_places(comm, tmp_path, axis):
    finest = DOMAIN.spacing / 4
    place = float(DOMAIN.lower[axis] + (48.25 if axis == 2 else 32.25) * finest[axis])  # cuts all three levels
    with Dump(dumped(comm, tmp_path, cloud)) as dump:
        shown = raster.slice_through(dump, "phi", axis, place)
        strength = raster.slice_through(dump, "|E|", axis, place)
    a, b = shown.axes
    assert DOMAIN.upper[a] - DOMAIN.lower[a] >= DOMAIN.upper[b] - DOMAIN.lower[b]
    assert shown.values.shape == (4 * DOMAIN.cells[a], 4 * DOMAIN.cells[b])
    at = np.empty((*shown.values.shape, 3))
    at[..., a] = (shown.lower[0] + (np.arange(at.shape[0]) + 0.5) * finest[a])[:, None]
    at[..., b] = (shown.lower[1] + (np.arange(at.shape[1]) + 0.5) * finest[b])[None, :]
    at[..., axis] = place
    width = np.ones(shown.values.shape)  # of the finest cells at a pixel, in base cells
    for level, boxes in enumerate(LEVELS, start=1):
        for lower, upper in boxes:
            i, j = (slice(lower[d] * 4 >> level, (upper[d] + 1) * 4 >> level) for d in (a, b))
            width[i, j] = 0.5**level
    # A pixel shows the value at the centre of its cell: at most half a cell away along each axis.
    half = DOMAIN.spacing / 2
    assert np.all(np.abs(shown.values - at @ [1, 10, 100]) <= width * (half @ [1, 10, 100]) * 1.001)
    assert np.all(np.abs(strength.values - np.linalg.norm(at, axis=-1)) <= width * np.linalg.norm(half) * 1.001)


@pytest.mark.parametrize("axis", [0, 1, 2])
@pytest.mark.parametrize("most_pixels", [1600, 50])
def test_a_projection_holds_all_of_the_charge_once(comm, tmp_path, monkeypatch, axis, most_pixels):
    monkeypatch.setattr(raster, "MOST_PIXELS", most_pixels)
    with Dump(dumped(comm, tmp_path, cloud)) as dump:
        seen = raster.projection(dump, "rho", axis)
        spread = raster.spread_of(dump)
    area = np.prod((seen.upper - seen.lower) / seen.values.shape)
    exact = 1e-6 * np.pi**1.5 * 4e-3 * 4e-3 * 3e-2
    assert spread.charge == pytest.approx(exact, rel=2e-3, abs=0)
    # Fewer pixels than cells sample the cells and do not sum them.
    assert seen.values.sum() * area == pytest.approx(spread.charge, rel=1e-12 if most_pixels == 1600 else 0.03, abs=0)


def test_the_line_follows_the_long_side_of_the_charge_from_wall_to_wall(comm, tmp_path):
    with Dump(dumped(comm, tmp_path, cloud)) as dump:
        spread = raster.spread_of(dump)
        line = raster.line_through(dump, spread)
        values = raster.line_values(dump, "phi", line)
        efield = raster.line_values(dump, "E", line)
    np.testing.assert_allclose(spread.centre, [0, -0.01, 0.09], atol=3e-5)
    np.testing.assert_allclose(np.sqrt(np.diag(spread.covariance)), np.array([4e-3, 4e-3, 3e-2]) / 2**0.5, rtol=0.05)
    assert line.direction.tolist() == [0, 0, 1]
    assert line.points[0, 2] == pytest.approx(0.01, abs=1e-3)
    assert line.points[-1, 2] == pytest.approx(0.17, abs=1e-3)
    coarse = DOMAIN.spacing * [1, 10, 100] / 2
    assert np.abs(values - line.points @ [1, 10, 100]).max() <= coarse.sum() * 1.001
    assert np.abs(efield - line.points).max() <= DOMAIN.spacing.max() / 2 * 1.001


def test_a_train_of_bunches_is_drawn_along_its_diagonal(comm, tmp_path):
    def train(x, y, z):
        return sum(np.exp(-((x - b) ** 2 + (y + 0.01 - b) ** 2 + (z - 0.09) ** 2) / 2e-5) for b in (-0.01, 0, 0.01))

    with Dump(dumped(comm, tmp_path, train)) as dump:
        line = raster.line_through(dump, raster.spread_of(dump))
    np.testing.assert_allclose(line.direction, [0.5**0.5, 0.5**0.5, 0], atol=0.02)


# ---- the pictures ----

DENSITIES = {
    "positive": cloud,
    "negative": lambda x, y, z: -cloud(x, y, z),
    "both": lambda x, y, z: x * cloud(x, y, z),
    "none": lambda x, y, z: 0 * x * y * z,
}


@pytest.mark.parametrize(("density", "axis"), [("positive", "z"), ("negative", "x"), ("both", "z"), ("none", "x")])
def test_every_dump_can_be_drawn_and_no_label_is_clipped(comm, tmp_path, density, axis, monkeypatch):
    saved = []
    save = figures.save

    def watched(figure, path):
        saved.append(figure)
        return save(figure, path)

    monkeypatch.setattr(figures, "save", watched)
    shown = [replace(view, axis="xyz".index(axis)) for view in views.OVERVIEW]
    shown += [views.View("Ez", "projection", scale="symmetric", boxes=False), views.View("rho", scale="log", level=1)]
    pictures = draw.plot(dumped(comm, tmp_path, DENSITIES[density]), tmp_path / "pictures", shown)
    names = (
        f"phi_{axis}",
        f"E_{axis}",
        f"rho_along_{axis}",
        f"phi_E_rho_line_along_{axis}",
        "Ez_along_z",
        "rho_z_level1",
    )
    assert [p.name for p in pictures] == [f"fields_00000003_{n}.png" for n in names]
    for path, figure in zip(pictures, saved, strict=True):
        assert path.read_bytes().startswith(b"\x89PNG")
        box = figure.get_tightbbox(FigureCanvasAgg(figure).get_renderer())
        width, height = figure.get_size_inches()
        assert 0 <= box.x0 < box.x1 <= width
        assert 0 <= box.y0 < box.y1 <= height


def test_options_go_to_the_pictures_that_have_them():
    chosen = views.with_options(views.OVERVIEW, position=0.1, scale="log", axis=0)
    assert [view.position for view in chosen] == [0.1, 0.1, None, None]
    assert [view.scale for view in chosen] == ["log", "log", "log", "auto"]
    assert all(view.axis == 0 for view in chosen)
    with pytest.raises(InputError, match="boxes has no effect on a line"):
        views.with_options([views.View("phi", "line")], boxes=False)


@pytest.mark.parametrize(
    ("view", "message"),
    [
        (views.View("Q"), "holds no Q; choose among E, phi, rho"),
        (views.View("phi", "line", scale="log"), "scale has no effect on a line; leave it out"),
        (views.View("phi", "projection", position=0.1), "position has no effect on a projection"),
        (views.View("phi", level=3), "level 3 does not exist in .*; it has levels 0 to 2"),
        (
            views.View("phi", axis=2, position=0.2),
            "position 0.2 m lies outside the domain of .*, 0.01 to 0.17 m along z",
        ),
        (
            views.View("phi", axis=0, position=-0.019, level=2),
            "level 2 of .* has no cells at x = -0.019 m; choose another",
        ),
    ],
)
def test_a_view_of_what_is_not_there_is_refused_in_one_sentence(comm, tmp_path, view, message):
    with pytest.raises(InputError, match=message):
        draw.plot(dumped(comm, tmp_path, cloud), views=[view])


def test_what_cannot_be_drawn_is_named(comm, tmp_path):
    with pytest.raises(InputError, match="No such file"):
        draw.plot(tmp_path / "fields_00000001.vtkhdf")
    with pytest.raises(InputError, match=r"holds neither fields_\*.vtkhdf nor checkpoint_\*; name a folder"):
        draw.plot(tmp_path)
    (tmp_path / "pictures").write_text("in the way")
    with pytest.raises(OutputError, match=r"cannot write picture .*: File exists; choose another output folder"):
        draw.plot(dumped(comm, tmp_path, cloud), tmp_path / "pictures")


def test_a_level_by_itself_shows_its_own_cells(comm, tmp_path):
    with Dump(dumped(comm, tmp_path, cloud)) as dump:
        shown = raster.slice_through(dump, "phi", 2, 0.07, level=1)
        seen = raster.projection(dump, "rho", 2, level=1)
        everywhere = raster.slice_through(dump, "phi", 2, 0.07)
    inside = np.isfinite(shown.values)
    assert inside.sum() == 16 * 16 and np.array_equal(inside, np.isfinite(seen.values))
    # Level 2 covers the middle: its cells are half as wide, and level 1 holds the plane of its parents there.
    assert np.nanmax(np.abs(shown.values - everywhere.values[::2, ::2])) <= (DOMAIN.spacing * [1, 10, 100]).sum() / 2
    assert not np.array_equal(shown.values[inside], everywhere.values[::2, ::2][inside])


@pytest.mark.mpi(ranks=(2,))
@pytest.mark.parametrize("writers", [1, 2])
def test_a_checkpoint_shows_what_the_field_file_of_its_step_shows(comm, tmp_path, writers):
    scene = Scene.from_dict(
        {
            "domain": {"lower": -1, "upper": 1, "cells": 16},
            "bunches": [{"distribution": "gaussian", "sigma": 0.15, "charge": "1 nC", "particles": 2000}],
            "refinement": {"levels": 1, "max_grid_size": 8},
            "output": {"directory": str(tmp_path), "writers": writers, "write": ["fields", "checkpoint"]},
        }
    )
    Simulation(comm, scene).run()
    if comm.rank == 0:
        with open_dump(tmp_path / "checkpoint_00000000") as kept, open_dump(tmp_path) as written:
            assert isinstance(kept, CheckpointDump) and not isinstance(written, CheckpointDump)
            assert (kept.step, kept.time) == (written.step, written.time)
            for name in ("phi", "rho", "|E|", "Ex", "Ez"):
                assert kept.unit(name) == written.unit(name)
                for level in (None, 0, 1):
                    one, other = (raster.slice_through(dump, name, 1, 0.01, level) for dump in (kept, written))
                    np.testing.assert_array_equal(one.values, other.values)


@pytest.mark.parametrize(
    ("value", "unit", "text"),
    [(0.0, "s", "0 s"), (1.25e-9, "s", "1.25 ns"), (-0.0282842, "m", "-28.28 mm"), (0.99999, "V", "1 V")],
)
def test_quantities_take_the_prefix_that_suits_them(value, unit, text):
    assert quantity(value, unit) == text

"""The gallery shows every example as it is now, and tutorials run as scripts."""

from __future__ import annotations

import re
import runpy
from pathlib import Path

import matplotlib
import pytest

import gallery

ROOT = Path(__file__).parents[2]


def test_the_gallery_shows_every_example_as_it_is():
    examples = {path.name for path in (ROOT / "examples").iterdir() if path.is_file()}
    assert {f"{name}.toml" for name in gallery.SCENES} | {f"{name}.py" for name in gallery.SCRIPTS} == examples
    assert gallery.PAGE.read_text(encoding="utf-8") == gallery.page(), "run make gallery"
    pictures = re.findall(r"\]\((pictures/gallery_\w+\.png)\)", gallery.page())
    assert len(pictures) == len(examples)
    assert all((ROOT / "docs" / picture).read_bytes().startswith(b"\x89PNG") for picture in pictures)


@pytest.fixture
def ran(tmp_path, monkeypatch):
    """Run a tutorial as a script, in an empty folder; returns its names."""
    for package in ("pandas", "xarray", "yt", "beamphysics"):
        pytest.importorskip(package)
    monkeypatch.chdir(tmp_path)
    matplotlib.use("Agg")
    return lambda name: runpy.run_path(str(ROOT / "docs" / "tutorials" / f"{name}.py"))


def test_a_bunch_from_python_in_under_30_lines(ran):
    text = (ROOT / "docs" / "tutorials" / "bunch.py").read_text(encoding="utf-8")
    assert sum(bool(line.strip()) and not line.startswith("#") for line in text.splitlines()) < 30
    assert not re.search(r"mpiexec|MPI|kind|distribution", text)
    names = ran("bunch")
    assert names["now"].step == 10 and names["simulation"].step == 30
    assert names["report"].converged
    edge = names["phi"].sample([(0.012, 0, 0), (0, 0, 0.015)])
    assert abs(edge).max() < 2e-3 * names["phi"].max_abs()  # outside of both charges, which cancel
    assert list(names["beam"]["step"]) == list(range(10, 31))
    assert names["beam"]["emittance_x"].iloc[-1] > names["beam"]["emittance_x"].iloc[0]


def test_the_mesh_that_follows_a_halo_gives_the_radius_of_the_fine_one(ran):
    names = ran("halo")
    radii = names["radii"].max()
    assert radii["follows the particles"] == pytest.approx(radii["fine everywhere"], rel=2e-3)
    assert abs(radii["coarse"] / radii["fine everywhere"] - 1) > 0.02
    assert names["cells"]["follows the particles"] < names["cells"]["fine everywhere"] / 4


def test_the_convergence_study_finds_the_second_order(ran):
    orders = ran("convergence")["orders"]
    assert set(orders) == {"one level", "two more levels"}
    assert min(orders.values()) > 1.9


def test_results_are_read_as_written(ran):
    names = ran("results")
    losses, beam = names["losses"], names["beam"]
    assert len(losses) + beam.n_particle == 20_000
    assert ((losses.x**2 + losses.y**2) ** 0.5 > 0.0025 * (1 - 1e-9)).all()
    assert names["phi"].min() >= names["plane"].values.min()


@pytest.mark.long
def test_a_ring_of_xsuite_shifts_the_tunes_of_a_bunch(ran):
    pytest.importorskip("xtrack")
    names = ran("ring")
    assert names["error"] < 1e-2
    assert names["shift"].max(axis=1) == pytest.approx([0, 0], abs=0.02)
    assert ((names["shift"].mean(axis=1) < -0.03) & (names["shift"].mean(axis=1) > -0.05)).all()

"""Every code block of README.md and docs runs, or is checked for its syntax where it is for other machines."""

from __future__ import annotations

import shutil
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import matplotlib
import pytest

import code_blocks
from code_blocks import BASE, ROOT, Reader

SMALL = '--set bunches.0.particles=2000 --set output.write=[\\"series\\",\\"checkpoint\\",\\"particles\\"]'
RUN_ELSEWHERE = {  # (page, language): the test that runs these blocks
    ("elements", "python"): "tests/run/test_page_on_elements.py",
    ("elements", "toml"): "tests/run/test_page_on_elements.py",
    ("gallery", "toml"): "examples, in tests/docs/test_gallery.py",
    ("gallery", "python"): "examples, in tests/gmls/test_gmls_examples.py",
}


@dataclass(frozen=True)
class Page:
    """What a page needs besides its own blocks."""

    runs: tuple[str, ...] = ()  # folders that it looks at, of `RUNS`
    shorter: str = ""  # options for its runs, where the full ones take long
    loosely: bool = False  # compare the first words of printed lines alone
    needs: tuple[str, ...] = ()  # packages that it imports
    files: dict[str, str] = field(default_factory=dict)
    long: bool = False  # for `make verify`


LOSSY = """
[[bunches]]
name = "tail"
distribution = "gaussian"
species = "electron"
centre = [0, 0, "-2 cm"]
sigma = "5 mm"
charge = "-1 pC"
particles = 2000
velocity = [0, 0, "0.3 c"]

[[apertures]]
kind = "round"
name = "pipe"
radius = "9 mm"

[[screens]]
name = "behind"
z = "2 cm"

[motion]
kind = "leapfrog"
dt = "20 ps"

[schedule]
steps = 40

[output]
write = ["series", "checkpoint", "losses", "particles"]
"""
MOVES = """
[motion]
kind = "leapfrog"
dt = "10 ps"

[schedule]
steps = 20

[output]
write = ["series", "checkpoint", "fields", "particles"]
fields_every = 10
checkpoint_every = 10
"""
PAGES = {
    "README": Page(shorter="--set bunches.0.particles=20000 --set domain.cells=48", needs=("pandas", "xarray")),
    "batch": Page(files={"first.toml": BASE + MOVES}, long=True),
    "diagnostics": Page(("scene",), needs=("pandas",), files={"scene.toml": BASE + LOSSY}, long=True),
    "elements": Page(shorter="--set schedule.steps=3 --set bunches.0.particles=500"),
    "following": Page(("first", "drift", "drift_on_one_rank"), loosely=True, long=True),
    "halo": Page(shorter=f"--set schedule.steps=5 {SMALL}", needs=("pandas",), long=True),
    "mpm": Page(shorter="--set schedule.steps=2 --set faces.z.1.press=0.002", long=True),
    "losses": Page(("scene",), needs=("pandas", "beamphysics")),
    "outputs": Page(("first",)),
    "sources": Page(("waist",), needs=("beamphysics",)),
}
RUNS = {  # what pages look at, by the folder in `runs`
    "scene": BASE + LOSSY,
    "first": BASE + MOVES,
    "drift": BASE + MOVES,
    "drift_on_one_rank": BASE + MOVES,
    "waist": (ROOT / "examples" / "waist.toml").read_text(encoding="utf-8").replace("32_768", "500"),
}


@pytest.fixture(scope="module")
def runs(tmp_path_factory) -> Path:
    """A folder with `RUNS`, made when a page asks for the first one."""
    folder = tmp_path_factory.mktemp("pages")
    (folder / "runs").mkdir()
    return folder


def prepare(reader: Reader, wanted: tuple[str, ...], runs: Path) -> None:
    for name in wanted:
        if not (made := runs / "runs" / name).exists():
            scene = runs / f"{name.split('_')[0]}.toml"
            scene.write_text(RUNS[name], encoding="utf-8")
            reader.printed(f"amrpic run {scene} --output {made}")
        shutil.copytree(made, reader.folder / "runs" / name)


def checks(page: str, names: dict[str, Any], folder: Path) -> None:
    """What the code of a page has to come to."""
    if page == "README":
        assert names["report"].converged
        assert names["simulation"].step == names["simulation"].scene.schedule.last_step
        assert {"step", "rms_x"} <= set(names["results"].series)
        assert (folder / "runs" / "drift" / "own_far.csv").exists()
        left = {path.name for path in (folder / "runs" / "ten_bunches").iterdir()}
        assert {"fields_00000009.vtkhdf", "series.csv", "beam.csv", "checkpoint_00000009"} <= left
    elif page == "extend":
        assert names["with_wire"].step == 2 and names["simulation"].hierarchy.levels == 2
    elif page == "gmls":
        assert names["found"].phi.max() == pytest.approx(0.0188, rel=0.05)
    elif page == "quickstart":
        assert (folder / "runs" / "channel" / "screen_end.h5").exists()


def with_code() -> Iterator[Any]:
    for path in code_blocks.pages():
        if code_blocks.blocks(path):
            marks = [pytest.mark.long] if PAGES.get(path.stem, Page()).long else []
            yield pytest.param(path, id=path.stem, marks=marks)


@pytest.mark.parametrize("path", list(with_code()))
def test_code_on_a_page_runs(path, runs, tmp_path, monkeypatch):
    page = PAGES.get(path.stem, Page())
    for package in page.needs:
        pytest.importorskip(package)
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("AMRPIC_PROGRESS", "0")  # the machine may be busy
    matplotlib.use("Agg")
    reader = Reader(tmp_path, page.shorter, page.loosely)
    for name, text in page.files.items():
        (tmp_path / name).write_text(text, encoding="utf-8")
    prepare(reader, page.runs, runs)
    for block in code_blocks.blocks(path):
        if (path.stem, block.language) not in RUN_ELSEWHERE:
            reader.follow(block)
    checks(path.stem, reader.names, tmp_path)


def test_what_watch_prints_is_on_the_page_on_following(runs, tmp_path):
    reader = Reader(tmp_path)
    prepare(reader, ("first",), runs)
    [shown] = [one.text for one in code_blocks.blocks(ROOT / "docs" / "following.md") if one.language == "text"]
    printed = code_blocks.first_words(reader.printed("amrpic watch runs/first --once"))
    rest = iter(printed)
    assert [word for word in code_blocks.first_words(shown) if word not in rest] == []  # all there, in this order

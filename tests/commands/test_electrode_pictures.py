"""What commands say and show of electrodes: check, preview, pictures of a run, its report."""

from __future__ import annotations

from pathlib import Path

import matplotlib.image
import numpy as np
import pytest
from mpi4py import MPI

from amrpic import Scene, Simulation
from amrpic.commands.main import main
from amrpic.mesh.pictures import METAL
from amrpic.results import report_page

TABLE = """
[domain]
lower = -0.01
upper = 0.01
cells = 16
boundary = "dirichlet"

[[electrodes]]
name = "tip"
voltage = "2 kV"
shape = { kind = "stl", file = "tip.stl", unit = "mm" }

[[electrodes]]
name = "hair"
charge = "1 fC"
shape = { kind = "sphere", centre = "-3 mm", radius = "0.1 um" }

[[bunches]]
distribution = "gaussian"
species = "proton"
centre = [0, "1 mm", "-5 mm"]
sigma = "1 mm"
cutoff = 3
charge = "1 fC"
particles = 200
"""


def tetrahedron(open_side: bool) -> str:
    """Return a text file of four triangles, mm; one may be missing."""
    corners = [(0, 0, 0), (4, 0, 0), (0, 4, 0), (0, 0, 4)]
    faces = [(0, 2, 1), (0, 1, 3), (0, 3, 2), (1, 2, 3)][open_side:]
    lines = ["solid tip"]
    for face in faces:
        lines += ["facet normal 0 0 0", "outer loop", *(f"vertex {' '.join(map(str, corners[n]))}" for n in face)]
        lines += ["endloop", "endfacet"]
    return "\n".join([*lines, "endsolid"])


def status(*arguments: str) -> int:
    """Run a command, and return its exit status."""
    with pytest.raises(SystemExit) as end:
        main(arguments)
    return int(end.value.code or 0)


@pytest.fixture
def table(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "tip.stl").write_text(tetrahedron(False))
    (tmp_path / "scene.toml").write_text(TABLE)
    return tmp_path / "scene.toml"


def test_check_says_what_the_base_level_cuts(table, capsys):
    assert status("check", str(table)) == 0
    _, tip, file, hair = capsys.readouterr().out.splitlines()
    assert (
        tip.startswith("electrode tip, 2 kV: ")
        and "cells of the base level in metal" in tip
        and "the shortest at" in tip
    )
    assert file == f"  {table.with_name('tip.stl')}: 4 triangles, closed"
    assert hair.startswith("electrode hair, 1 fC: 0 cells") and hair.endswith(
        "so that the field does not see it: refine the mesh there"
    )


def test_check_refuses_a_file_with_large_holes_in_one_sentence(table, capsys):
    table.with_name("tip.stl").write_text(tetrahedron(True))
    assert status("check", str(table)) != 0
    said = capsys.readouterr()
    assert "tip.stl" in said.err and len(said.err.strip().splitlines()) == 1


def test_preview_has_electrodes_in_words_and_slices(table, capsys):
    table.write_text(TABLE.replace("0.1 um", "1.5 mm"))
    assert status("preview", str(table), "--seconds", "0") == 0
    said = capsys.readouterr().out
    assert "electrode tip, 2 kV: " in said and "of all levels in metal" in said
    assert {path.name for path in Path("runs/scene").glob("preview_rho_?.png")} == {
        f"preview_rho_{a}.png" for a in "xyz"
    }


def test_pictures_of_a_run_and_its_report_show_metal(table):
    data = {"output": {"directory": "out", "write": ["series", "fields", "pictures", "report"]}}
    scene = Scene.from_toml(table, ['electrodes.1.shape.radius="1.5 mm"'])
    scene = scene.replace(output=data["output"])
    Simulation(MPI.COMM_SELF, scene).run(log="silent")
    picture = matplotlib.image.imread("out/fields_00000000_phi_y.png")[..., :3]
    grey = np.abs(picture - METAL[:3]).max(axis=-1) < 0.02
    # the plane y = 1 mm cuts the tip, 4.5 mm² of 400 mm² that fill about half of the picture
    assert 0.005 < grey.mean() < 0.03
    assert Path("out/electrodes.vtk").exists()
    assert 'alt="phi_y"' in report_page.make(Path("out"))
    table.with_name("tip.stl").unlink()
    assert 'alt="phi_y"' in report_page.make(Path("out"))  # without what is no longer there

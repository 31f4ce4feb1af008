"""The report of a run: one page with all in it, that a browser shows."""

from __future__ import annotations

import re
from base64 import b64decode
from pathlib import Path

import pytest

import amrpic
import browser
from amrpic.commands.main import main
from amrpic.io import time_series
from amrpic.io.run_status import RunStatus
from amrpic.results import report_page

SECTIONS = ["Pictures", "Beam", "Solver", "Time", "Remarks", "Scene"]


def scene(folder: Path, steps: int = 3, *write: str) -> amrpic.Scene:
    return amrpic.Scene(
        name="beam <1>",
        domain=amrpic.Domain(-0.1, 0.1, 16, boundary="dirichlet"),
        bunches=[
            amrpic.GaussianBunch(
                species="electron", sigma=0.01, charge="-10 pC", particles=900, velocity=(0, 0, "0.05 c")
            )
        ],
        refinement={"levels": 1, "blocking_factor": 4},
        motion=amrpic.Leapfrog(dt="2 ns"),  # long: a remark
        schedule={"steps": steps},
        output={"directory": str(folder), "write": list(write or ("fields", "series", "checkpoint", "report"))},
    )


def pictures(page: str) -> dict[str, bytes]:
    found = re.findall(r'<img alt="([^"]*)" src="data:image/png;base64,([^"]*)">', page)
    assert len(found) == page.count("<img")
    return {name: b64decode(content) for name, content in found}


@pytest.mark.mpi(ranks=(1, 2))
def test_a_run_ends_with_a_page_that_has_all_in_it(comm, tmp_path):
    simulation = amrpic.Simulation(comm, scene(tmp_path))
    simulation.run(log="silent")
    comm.Barrier()
    page = (tmp_path / "report.html").read_text()
    assert re.findall(r"<h2>(\w+)</h2>", page) == SECTIONS
    assert not re.search(r"<script|<link|https?:|url\(|(src|href)=\"(?!data:)", page)
    shown = pictures(page)
    assert list(shown) == ["phi_z", "E_z", "rho_along_z", "phi_E_rho_line", "x-px", "z-pz", "beam", "solver", "time"]
    assert all(content.startswith(b"\x89PNG") and len(content) > 3000 for content in shown.values())
    assert "<h1>beam &lt;1&gt;</h1>" in page and '<p class="finished"><b>finished</b></p>' in page
    for what, held in (
        ("step", "3 of 3"),
        ("simulated time", "6 ns"),
        ("amrpic", f"{report_page.version('amrpic')}, seed 1"),
    ):
        assert f"<td>{what}</td><td>{held}</td>" in page
    assert f"<td>{len(simulation.report.residuals) - 1}</td><td>{simulation.report.residuals[-1]:.2e}</td>" in page
    row = time_series.read(tmp_path / "beam.csv")[-1]
    assert f"<td>bunch_0</td><td>{row['particles']}</td><td>{report_page.quantity(row['charge'], 'C')}</td>" in page
    status = RunStatus.read(tmp_path)
    assert any("motion.dt of 2e-09 s is long" in text for text in status.warnings)
    assert all(f'<p class="warning">{report_page.escape(text)}</p>' in page for text in status.warnings)
    assert all(f"<p>{report_page.escape(text)}</p>" in page for text in status.notes)
    assert "steps = 3" in page


def test_pictures_of_the_run_stand_in_where_there_are_no_dumps(comm, tmp_path, capsys):
    amrpic.Simulation(scene(tmp_path, 1, "series", "pictures")).run(log="silent")
    with pytest.raises(SystemExit) as ended:
        main(["report", str(tmp_path)])
    assert ended.value.code == 0 and capsys.readouterr().out == f"{tmp_path / 'report.html'}\n"
    shown = pictures((tmp_path / "report.html").read_text())
    drawn = sorted(tmp_path.glob("fields_00000001_*.png"))
    assert [shown[path.stem] for path in drawn] == [path.read_bytes() for path in drawn] and len(drawn) == 4


def test_a_run_of_tables_alone_and_one_of_a_single_row_have_pages(comm, tmp_path):
    amrpic.Simulation(scene(tmp_path, 0, "series")).run(log="silent")
    page = report_page.make(tmp_path)
    assert re.findall(r"<h2>(\w+)</h2>", page) == SECTIONS[1:] and set(pictures(page)) == {"beam", "solver", "time"}


def test_a_run_that_was_stopped_says_so(comm, tmp_path):
    simulation = amrpic.Simulation(scene(tmp_path))
    simulation.on_step(lambda now: (tmp_path / "STOP").touch())
    simulation.run(log="silent")
    page = (tmp_path / "report.html").read_text()
    assert f'<p class="stopped"><b>stopped</b>: the file {tmp_path / "STOP"} asks for it</p>' in page
    assert "<td>step</td><td>1 of 3</td>" in page


def test_what_is_no_run_is_one_sentence(comm, tmp_path, capfd):
    for folder, message in (
        (tmp_path, "series.csv cannot be read: "),
        (tmp_path / "nowhere", "nowhere is no folder; give"),
    ):
        with pytest.raises(SystemExit) as ended:
            main(["report", str(folder)])
        error = capfd.readouterr().err
        assert ended.value.code == 2 and message in error and error.count("\n") == 1


@pytest.mark.browser
@pytest.mark.parametrize("width", [500, 1200])
def test_a_browser_shows_all_pictures_without_errors_on_narrow_and_wide_screens(comm, tmp_path, request, width):
    browser.require(request)
    amrpic.Simulation(scene(tmp_path, 1)).run(log="silent")
    seen = browser.look(tmp_path, ["report.html"], width, tmp_path)
    assert seen == {"report.html": {"images": 9, "broken": [], "wide": 0}}

"""Runs as others drive them: scans, a run as a function, a class of LUME (skipped where lume-base is missing)."""

from __future__ import annotations

import csv
import json
from pathlib import Path
from typing import Any

import h5py
import pytest
from mpi4py import MPI

from amrpic.drivers import evaluate as function
from amrpic.drivers.evaluate import LOG, evaluate
from amrpic.drivers.scans import combinations, scan, values_of
from amrpic.errors import AmrpicError, InputError, SceneError
from refusals import ended, refusal

SCENE = """
[domain]
lower = -0.02
upper = 0.02
cells = 8
boundary = "open"

[[bunches]]
distribution = "gaussian"
species = "electron"
sigma = "2 mm"
charge = "-1 pC"
particles = 60

[motion]
kind = "leapfrog"
dt = "35 ps"

[schedule]
steps = 3

[output]
write = ["series", "checkpoint"]
"""
CHARGE = "bunches.0.charge"


@pytest.fixture
def scene(tmp_path, monkeypatch) -> Path:
    monkeypatch.setenv("AMRPIC_PROGRESS", "0")  # the machine may be busy
    path = tmp_path / "small.toml"
    path.write_text(SCENE, encoding="utf-8")
    return path


def table(folder: Path) -> list[dict[str, str]]:
    with open(folder / "scan.csv", encoding="utf-8", newline="") as file:
        return list(csv.DictReader(file))


def times_of_logs(folder: Path) -> dict[str, int]:
    """When each run in a folder printed last, by its name."""
    return {path.parent.name: path.stat().st_mtime_ns for path in folder.glob(f"*/{LOG}")}


# ---- scans ----
def test_values_are_separated_by_commas_outside_brackets_and_quotes():
    assert values_of("a.0=1, 2") == ("a.0", ["1", "2"])
    assert values_of("a=[1,2],{b=1,c='x,y'}") == ("a", ["[1,2]", "{b=1,c='x,y'}"])
    assert combinations({"a": ["1", "2"], "b": ["3"]}) == [{"a": "1", "b": "3"}, {"a": "2", "b": "3"}]
    for wrong in ("a", "=1", "a=", "a=1,,2"):
        with pytest.raises(InputError, match="write it as"):
            values_of(wrong)


def test_a_scan_runs_all_combinations_into_a_table_and_a_picture(scene, tmp_path):
    folder = tmp_path / "all"
    settings = ["--set", f"{CHARGE}=-1 pC,-2 pC", "--set", "solver.tolerance=1e-6", "--output", str(folder)]
    assert ended(MPI.COMM_SELF, "scan", str(scene), *settings) == (0, "")
    rows = table(folder)
    assert [row[CHARGE] for row in rows] == ["-1 pC", "-2 pC"]
    assert len({row["folder"] for row in rows}) == 2 and all((folder / row["folder"]).is_dir() for row in rows)
    charges = [float(row["charge"]) for row in rows]
    assert charges == pytest.approx([-1e-12, -2e-12])
    assert all(row["failure"] == "" and row["step"] in ("3", "3.0") for row in rows)
    assert (folder / "scan.png").stat().st_size > 0

    before = times_of_logs(folder)
    assert ended(MPI.COMM_SELF, "scan", str(scene), *settings) == (0, "")
    assert times_of_logs(folder) == before
    assert table(folder) == rows
    text = refusal(MPI.COMM_SELF, "scan", str(scene), *settings, "--show", "rms_w")
    assert "--show rms_w" in text and "rms_x" in text


def test_a_scan_that_was_cut_off_goes_on(scene, tmp_path):
    folder, values = tmp_path / "cut", {CHARGE: ["-1 pC", "-2 pC"]}
    first = next(scan(scene, values, folder))
    assert len(table(folder)) == 1
    with pytest.raises(AmrpicError, match="75"):  # the second one stops in the middle
        function.run({CHARGE: "-2 pC"}, scene, folder, timeout=1e-3)
    before = times_of_logs(folder)
    rows = list(scan(scene, values, folder))
    assert repr(rows[0]) == repr(first) and times_of_logs(folder)[first.folder] == before[first.folder]
    assert not list((folder / rows[1].folder).glob("earlier_*"))
    assert [row.numbers["step"] for row in rows] == [3, 3]
    whole = evaluate({CHARGE: "-2 pC"}, scene, tmp_path / "whole")
    assert rows[1].numbers["rms_x"] == pytest.approx(whole["rms_x"], rel=1e-12)


def test_a_run_that_fails_is_a_row_with_its_sentence(scene, tmp_path):
    folder = tmp_path / "fails"
    settings = ["--set", "solver.tolerance=1e-12", "--set", "solver.max_cycles=50,1"]  # one cycle does not do
    code, _ = ended(MPI.COMM_SELF, "scan", str(scene), *settings, "--output", str(folder))
    rows = table(folder)
    assert code == 1 and [bool(row["failure"]) for row in rows] == [False, True]
    assert "\n" not in rows[1]["failure"] and "status" in rows[1]["failure"]


@pytest.mark.parametrize(
    ("arguments", "what"),
    [
        ([], "nothing is set"),
        (["--set", "bunches.0.charg=1e-12,2e-12"], 'did you mean "charge"'),
        (["--set", f"{CHARGE}=-1 pC,-1 mm"], CHARGE),
        (["--set", f"{CHARGE}=-1 pC", "--set", f"{CHARGE}=-2 pC"], "given twice"),
        (["--set", CHARGE], "write it as"),
    ],
)
def test_what_the_scene_cannot_have_is_refused_before_the_first_run(scene, tmp_path, arguments, what):
    folder = tmp_path / "none"
    assert what in refusal(MPI.COMM_SELF, "scan", str(scene), *arguments, "--output", str(folder))
    assert not folder.exists()


# ---- a run as a function ----
def test_a_run_is_a_function_of_its_inputs(scene, tmp_path):
    numbers = evaluate({CHARGE: "-3 pC", "schedule.steps": 2}, scene, tmp_path, outputs=["charge", "rms_x"])
    assert list(numbers) == ["charge", "rms_x"] and numbers["charge"] == pytest.approx(-3e-12)
    before = times_of_logs(tmp_path)
    assert evaluate({"schedule.steps": 2, CHARGE: "-3 pC"}, scene, tmp_path)["rms_x"] == numbers["rms_x"]
    assert times_of_logs(tmp_path) == before
    with pytest.raises(InputError, match="no emittance_w"):
        evaluate({"schedule.steps": 2, CHARGE: "-3 pC"}, scene, tmp_path, outputs=["emittance_w"])


def test_a_wrong_input_is_one_sentence(scene, tmp_path):
    with pytest.raises(AmrpicError, match='did you mean "charge"') as refused:
        evaluate({"bunches.0.charg": 1e-12}, scene, tmp_path)
    assert "\n" not in str(refused.value)
    with pytest.raises(SceneError, match="check the path"):
        evaluate({}, tmp_path / "none.toml", tmp_path)


# ---- LUME ----
def test_a_scene_is_an_object_of_lume(scene, tmp_path):
    base = pytest.importorskip("lume.base")
    from amrpic.drivers.lume import Amrpic

    made: Any = Amrpic.from_yaml(f"input_file: {scene}\nfolder: {tmp_path / 'lume'}\n{CHARGE}: -1 pC\n")
    assert isinstance(made, base.Base) and made.configured and not made.finished
    assert made.scene.bunches[0].charge == pytest.approx(-1e-12)
    made.input[CHARGE] = "-2 pC"
    output = made.run()
    assert made.finished and not made.error and made.output == output
    assert output["charge"] == pytest.approx(-2e-12)
    assert len(made.fingerprint()) > 0 and made.copy().input == made.input
    assert len(made.plot().axes) > 0

    other = Amrpic()
    other.load_archive(made.archive())
    assert (other.input, other.path) == (made.input, made.path)
    same = pytest.approx(output, rel=0, abs=0, nan_ok=True)  # there is no s without a reference particle
    assert other.output == same
    with h5py.File(tmp_path / "many.h5", "w") as file:
        assert json.loads(made.archive(file.create_group("one")).attrs["output"]) == same

    made.input["bunches.0.charg"] = 1
    with pytest.raises(SceneError, match='did you mean "charge"'):
        made.run()
    assert made.error and not made.finished and made.output is None
    with pytest.raises(InputError, match="openPMD"):
        Amrpic(str(scene), initial_particles={})

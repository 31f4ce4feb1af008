"""amrpic watch shows a run until it ends."""

from __future__ import annotations

import os
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import pytest

from amrpic.commands.main import main
from amrpic.commands.watch import sparkline
from amrpic.io import time_series
from amrpic.io.provenance import Provenance
from amrpic.io.run_status import RunStatus, now
from amrpic.io.time_series import Series
from amrpic.stages.diagnostics import quantities

STATUS = RunStatus("drift [b]", "1", 2, "elsewhere", 7, now(), now(), "running", "", 30, 40, 1e-9, 5e-11, 0.25)


def written(comm, folder: Path, status: RunStatus = STATUS, rows: int = 100) -> Path:
    """A folder as of a run: its status, and a series in which rms_x is the step in mm."""
    status.write(folder)
    series = Series(comm, folder / "series.csv", quantities(2), Provenance())
    series.append(*({"step": step, "rms_x": step * 1e-3, "rms_y": float("nan"), "cycles": 3} for step in range(rows)))
    series.close()
    return folder


def status_of(arguments: list[str]) -> object:
    with pytest.raises(SystemExit) as ended:
        main(arguments)
    return ended.value.code


@pytest.mark.parametrize(("state", "code"), [("running", 0), ("finished", 0), ("stopped", 75), ("failed", 1)])
def test_one_look_shows_the_facts_and_series(comm, tmp_path, capsys, state, code):
    written(comm, tmp_path, replace(STATUS, state=state, why="signal USR1" if code else ""))
    assert status_of(["watch", str(tmp_path), "--once"]) == code
    text = capsys.readouterr().out
    assert text.splitlines()[0] == f"drift [b]: {state}" + (": signal USR1" if code else "")
    for line in ("step  30 of 40, 75 %", "pace  250 ms per step on 2 ranks", "time  1 ns, step of 50 ps"):
        assert line in " ".join(text.split(" ")).replace("       ", "  ")
    [rms] = [line.split() for line in text.splitlines() if line.startswith("rms_x")]
    assert rms[1] == sparkline(range(60, 100)) and rms[2:] == ["99", "mm"]


def test_a_run_is_watched_to_its_end(tmp_path):
    scene = Path(__file__).parents[2] / "examples" / "drift.toml"
    options = ["--set", "bunches.0.particles=2000", "--set", "schedule.steps=20", "--set", 'output.write=["series"]']
    environment = {**os.environ, "OMPI_ALLOW_RUN_AS_ROOT": "1", "OMPI_ALLOW_RUN_AS_ROOT_CONFIRM": "1"}
    begin = [sys.executable, "-m", "amrpic.commands.main"]
    code = "from amrpic.commands.main import main; main()"
    begin = [sys.executable, "-c", code]
    with subprocess.Popen([*begin, "run", str(scene), "--output", str(tmp_path), *options], env=environment) as run:
        while not (tmp_path / "status.json").exists():
            assert run.poll() is None
        watch = subprocess.run(
            [*begin, "watch", str(tmp_path), "--every", "0.1"],
            capture_output=True,
            text=True,
            timeout=60,
            env=environment,
        )
        assert run.wait() == 0
    assert watch.returncode == 0, watch.stderr
    titles = [line for line in watch.stdout.splitlines() if line.startswith("drift: ")]
    assert titles[-1] == "drift: finished" and "step       20 of 20, 100 %" in watch.stdout


def test_sparklines_reach_from_the_least_to_the_largest_value():
    assert sparkline([0, 1, 2, 3, 4, 5, 6, 7]) == "▁▂▃▄▅▆▇█"
    assert sparkline([5.0, 5.0, float("nan"), float("inf")]) == "▁▁  "
    assert sparkline([]) == ""


@pytest.mark.parametrize("count", [1, 40, 99, 100, 500])
def test_the_latest_rows_are_read_from_the_end(comm, tmp_path, count, monkeypatch):
    path = written(comm, tmp_path) / "series.csv"
    with path.open("a") as file:
        file.write("100,0.5")  # torn
    for row_bytes in (300, 2000):
        monkeypatch.setattr(time_series, "ROW_BYTES", row_bytes)
        found = time_series.latest(path, ["step", "rms_x"], count)
        assert found["step"] == list(range(100))[-count:] and found["rms_x"][-1] == 0.099


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["nowhere"], "nowhere is no folder; give that of a run"),
        (["."], "status.json cannot be read: No such file or directory; name the folder of a run"),
        ([".", "--every", "0"], "0 s is no time between two updates; give 0.1 to 3600"),
        ([".", "--every", "soon"], "invalid"),
    ],
)
def test_what_cannot_be_watched_is_one_sentence(comm, tmp_path, capfd, monkeypatch, arguments, message):
    monkeypatch.chdir(tmp_path)
    assert status_of(["watch", *arguments]) == 2
    error = capfd.readouterr().err
    assert message in error and error.count("\n") == 1

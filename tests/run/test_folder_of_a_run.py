"""The folder of a run: one run at a time, nothing of an earlier one among its files, and a file that stops it."""

from __future__ import annotations

import signal
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

import amrpic
from amrpic.io import time_series
from amrpic.io.run_status import RunStatus
from amrpic.run.folder import Claim, set_aside
from amrpic.view import draw
from amrpic.view.views import OVERVIEW, numbers


def scene(folder: Path, steps: int = 3) -> amrpic.Scene:
    return amrpic.Scene(
        domain=amrpic.Domain(-0.1, 0.1, 16),
        bunches=[amrpic.GaussianBunch(species="electron", sigma=0.01, charge="-10 pC", particles=500)],
        motion=amrpic.Leapfrog(dt="50 ps"),
        schedule={"steps": steps},
        output={"directory": str(folder), "write": ["series", "checkpoint", "fields"]},
    )


@pytest.mark.mpi(ranks=(1, 2))
def test_what_an_earlier_run_left_is_set_aside(comm, tmp_path, capfd):
    notes = tmp_path / "notes.txt"
    if comm.rank == 0:
        notes.write_text("kept")
    for steps in (3, 1):
        amrpic.Simulation(comm, scene(tmp_path, steps)).run()
    names = {path.name for path in tmp_path.iterdir() if path.name[0] != "."}
    assert {"notes.txt", "earlier_1", "checkpoint_00000001", "series.csv"} <= names
    assert not any("00000003" in name for name in names)
    assert (tmp_path / "earlier_1" / "checkpoint_00000003").is_dir()
    assert len(time_series.read(tmp_path / "earlier_1" / "series.csv")) == 4
    if comm.rank == 0:
        assert f"what an earlier run left in {tmp_path} is now in {tmp_path}/earlier_1" in capfd.readouterr().out
    comm.Barrier()
    assert "earlier_2" in str(set_aside(comm, tmp_path)) or comm.rank > 0


def test_two_runs_into_one_folder_are_refused(comm, tmp_path):
    holder = (
        "import sys; from mpi4py import MPI; from pathlib import Path; from amrpic.run.folder import Claim; "
        "held = Claim(MPI.COMM_SELF, Path(sys.argv[1])); print('held', flush=True); sys.stdin.read()"
    )
    with subprocess.Popen(
        [sys.executable, "-c", holder, str(tmp_path)], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
    ) as other:
        assert other.stdout is not None and other.stdin is not None
        assert other.stdout.readline() == "held\n"
        before = amrpic.Simulation(comm, scene(tmp_path))
        with pytest.raises(
            amrpic.OutputError, match=rf"another run writes into .* \(process {other.pid} on .*\); wait"
        ):
            before.run(log="silent")
        other.stdin.close()
        other.wait()
    with Claim(comm, tmp_path):
        pass
    (tmp_path / "series.csv").write_text("of an earlier run")
    before.run(log="silent")
    assert (tmp_path / "earlier_1" / "series.csv").read_text() == "of an earlier run"


@pytest.mark.mpi(ranks=(1, 2))
def test_a_stop_file_ends_a_run_after_a_checkpoint(comm, tmp_path, monkeypatch):
    monkeypatch.setenv("SLURM_JOB_END_TIME", "Unknown")
    simulation = amrpic.Simulation(comm, scene(tmp_path, steps=50))

    def ask(now: amrpic.Simulation) -> None:
        if now.step == 2 and comm.rank == 0:
            (tmp_path / "STOP").touch()

    simulation.on_step(ask)
    assert simulation.run(log="silent").stopped == f"the file {tmp_path}/STOP asks for it"
    assert simulation.step == 2 and (tmp_path / "checkpoint_00000002").is_dir()
    assert not (tmp_path / "STOP").exists()


@pytest.mark.mpi(ranks=(1, 2))
def test_a_signal_while_pictures_are_drawn_leaves_the_rest_for_a_restart(comm, tmp_path, monkeypatch):
    drawn = []

    def interrupted(*args: Any) -> Any:
        drawn.append(args)
        if len(drawn) == 2 and comm.rank == 0:
            signal.raise_signal(signal.SIGTERM)
        return numbers(*args)

    monkeypatch.setattr(draw, "numbers", interrupted)
    mine = scene(tmp_path, steps=1)
    mine = mine.replace(output={"directory": str(tmp_path), "write": ["series", "checkpoint", "pictures"]})
    assert amrpic.Simulation(comm, mine).run(log="silent").stopped == "signal SIGTERM"
    comm.Barrier()
    assert len(drawn) == len(list(tmp_path.glob("*.png"))) == 2
    assert RunStatus.read(tmp_path).state == "stopped"
    comm.Barrier()
    again = amrpic.Simulation.restart(comm, tmp_path / "checkpoint_00000001", mine)
    assert again.run(log="silent").stopped is None
    comm.Barrier()
    assert len(list(tmp_path.glob("*.png"))) == len(OVERVIEW)
    assert RunStatus.read(tmp_path).state == "finished"

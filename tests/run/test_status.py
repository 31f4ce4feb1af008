"""status.json says what a run does, is whole at any moment, and never stops the run."""

from __future__ import annotations

import json
import os
import subprocess
import sys
import threading
from dataclasses import replace
from datetime import datetime

import pytest

import amrpic
from amrpic.commands.main import main
from amrpic.io import run_status as status_module
from amrpic.io import time_series
from amrpic.io.run_status import FILE, RunStatus, Status, now

ROW = {
    "step": 3,
    "time": 1e-9,
    "cells_0": 1000,
    "cells_1": 24,
    "particles": 9,
    "lost_particles": 1,
    "cycles": 4,
    "residual": float("nan"),
    "memory": 2**20,
}


def scene(folder, **more):
    return amrpic.Scene(
        name="looked at",
        domain=amrpic.Domain(-0.1, 0.1, 16, boundary="dirichlet"),
        bunches=[amrpic.GaussianBunch(species="electron", sigma=0.01, charge="-10 pC", particles=500)],
        refinement={"levels": 1, "blocking_factor": 4},
        motion=amrpic.Leapfrog(dt="50 ps"),
        schedule={"steps": 4},
        output={"directory": str(folder), "write": ["series", "checkpoint"], "checkpoint_every": 2, **more},
    )


@pytest.mark.mpi(ranks=(1, 2))
def test_a_finished_run_says_where_it_ended(comm, tmp_path):
    simulation = amrpic.Simulation(comm, scene(tmp_path))
    simulation.run(log="silent")
    comm.Barrier()
    held = RunStatus.read(tmp_path)
    assert (held.state, held.why, held.scene, held.ranks) == ("finished", "", "looked at", comm.size)
    assert (held.step, held.of, held.time, held.dt) == (4, 4, simulation.time, 5e-11)
    count, lost = simulation.particles.global_count(comm), comm.allreduce(len(simulation.lost))
    assert (held.particles, held.lost_particles, held.levels) == (count, lost, simulation.hierarchy.levels)
    assert held.cells == sum(simulation.hierarchy.cells(level) for level in range(held.levels))
    assert (held.cycles, held.residual) == (simulation.report.cycles, simulation.report.residuals[-1])
    assert held.written == {"checkpoint": 4} and held.seconds_per_step is not None
    taken = time_series.read(tmp_path / "series.csv")["seconds"]  # the pace is a mean of them
    assert taken.min() <= held.seconds_per_step <= taken.max()
    started, ended = (datetime.fromisoformat(text) for text in (held.started, held.updated))
    assert started <= ended and held.estimated_end == held.updated


def test_a_run_that_is_stopped_or_fails_says_why(comm, tmp_path):
    simulation = amrpic.Simulation(scene(tmp_path))
    simulation.on_step(lambda now: (tmp_path / "STOP").touch() if now.step == 2 else None)
    simulation.run(log="silent")
    held = RunStatus.read(tmp_path)
    assert (held.state, held.step) == ("stopped", 2) and held.why == f"the file {tmp_path / 'STOP'} asks for it"

    def fail(now):
        assert RunStatus.read(tmp_path).state == "running"
        raise amrpic.InputError("enough")

    simulation = amrpic.Simulation.restart(tmp_path / "checkpoint_00000002")
    assert simulation.step == 2
    simulation.on_step(fail)
    with pytest.raises(amrpic.InputError):
        simulation.run(log="silent")
    held = RunStatus.read(tmp_path)
    assert (held.state, held.why, held.step) == ("failed", "enough", 2)


def test_it_is_written_at_most_once_a_second_and_at_the_end(comm, tmp_path, monkeypatch):
    clock, writes = [0.0], []
    monkeypatch.setattr(status_module.time, "monotonic", lambda: clock[0])
    monkeypatch.setattr(RunStatus, "write", lambda self, folder: writes.append((clock[0], self.step, self.state)))
    kept = Status(comm, scene(tmp_path), 0)
    for step in range(25):
        kept.step({**ROW, "step": step}, 0.1, 0.0, {})
        clock[0] += 0.125
    kept.end("finished", "", {})
    assert [(at, step) for at, step, _ in writes] == [(0, 0), (1, 8), (2, 16), (3, 24), (3.125, 24)]
    assert writes[-1][2] == "finished"


def test_numbers_that_are_not_finite_are_left_open_and_the_end_is_foreseen(comm, tmp_path, monkeypatch):
    monkeypatch.setattr(status_module, "EVERY", 0.0)
    kept = Status(comm, scene(tmp_path), 0)
    kept.step(ROW, 60.0, float("nan"), {"fields": 2})
    held = json.loads((tmp_path / FILE).read_text())
    assert held["residual"] is None and held["dt"] is None and held["written"] == {"fields": 2}
    left = datetime.fromisoformat(held["estimated_end"]) - datetime.fromisoformat(held["updated"])
    assert 58 <= left.total_seconds() <= 62


def test_a_reader_finds_it_whole_at_any_moment(comm, tmp_path):
    one, over = RunStatus("s", "", 1, "elsewhere", 0, now(), now(), why="x" * 5000), threading.Event()
    one.write(tmp_path)

    def write():
        try:
            for step in range(400):
                replace(one, step=step).write(tmp_path)
        finally:
            over.set()

    writer = threading.Thread(target=write)
    writer.start()
    seen = set()
    while not over.is_set():
        seen.add(RunStatus.read(tmp_path).step)
    writer.join()
    assert len(seen) > 3 and not list(tmp_path.glob("*.tmp"))


def test_a_folder_that_cannot_be_written_does_not_end_the_run(comm, tmp_path):
    kept = Status(comm, scene(tmp_path / "nowhere"), 0)
    kept.step(ROW, 1.0, 0.0, {})
    assert not (tmp_path / "nowhere").exists()


def test_a_run_whose_process_is_there_no_longer_is_gone(comm, tmp_path):
    child = subprocess.Popen([sys.executable, "-c", ""])
    child.wait()
    Status(comm, scene(tmp_path), 0)
    held = RunStatus.read(tmp_path)
    assert (held.state, held.process) == ("running", os.getpid())
    replace(held, process=child.pid).write(tmp_path)
    assert RunStatus.read(tmp_path).state == "gone"
    replace(held, process=child.pid, host="elsewhere").write(tmp_path)
    assert RunStatus.read(tmp_path).state == "running"


@pytest.mark.parametrize("content", [None, "", "{", "[]", '{"scene": 1}', "\xff"])
def test_what_is_no_status_is_one_sentence(comm, tmp_path, content):
    if content is not None:
        (tmp_path / FILE).write_text(content, encoding="latin-1")
    with pytest.raises(amrpic.InputError, match=r"status\.json cannot be read: .*; name the folder of a run"):
        RunStatus.read(tmp_path)


@pytest.mark.parametrize("earlier", [False, True])
def test_a_run_that_fails_at_its_start_says_why_unless_an_earlier_one_is_there(comm, tmp_path, capfd, earlier):
    (tmp_path / "scene.toml").write_text(SCENE)
    if earlier:
        RunStatus("s", "", 1, "elsewhere", 0, now(), now(), state="finished").write(tmp_path)
    with pytest.raises(SystemExit) as ended:
        main(["run", str(tmp_path / "scene.toml"), "--output", str(tmp_path), "--set", "solver.max_cycles=1"])
    assert ended.value.code == 1
    held = RunStatus.read(tmp_path)
    if earlier:
        assert (held.state, held.why) == ("finished", "")
    else:
        assert (held.state, held.of) == ("failed", 3) and f"amrpic: {held.why}\n" == capfd.readouterr().err


SCENE = """
[domain]
lower = -0.1
upper = 0.1
cells = 16
[[bunches]]
distribution = "gaussian"
sigma = 0.01
charge = 1e-12
particles = 500
[solver]
tolerance = 1e-10
[schedule]
solves = 4
"""

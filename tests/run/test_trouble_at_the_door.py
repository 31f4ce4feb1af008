"""Trouble that a run meets at its start: walls, bunches outside, closed and full streams, interrupts, odd environments."""

from __future__ import annotations

import itertools
import signal
import subprocess
import sys
import time
from pathlib import Path
from types import SimpleNamespace
from typing import cast

import numpy as np
import pytest
from mpi4py import MPI

import amrpic
import mpi_batch
from amrpic import failure
from amrpic.errors import InputError, SceneError
from amrpic.run.log import RunLog
from amrpic.scene.units import to_metres
from bad_inputs import SCENE

PROGRAM = str(Path(sys.executable).with_name("amrpic"))


def scene_of(folder: Path, position: np.ndarray, boundary: str, rank: int = 0) -> amrpic.Scene:
    """A scene of six or so particles at given places, in a domain from -0.1 to 0.1 m."""
    path = folder / f"places{rank}.npz"
    np.savez(path, position=position)
    singular = boundary in ("periodic", "neumann")
    return amrpic.Scene.from_dict(
        {
            "domain": {"lower": -0.1, "upper": 0.1, "cells": 16, "boundary": boundary},
            "background": "neutralizing" if singular else "none",
            "bunches": [{"distribution": "arrays", "file": str(path), "charge": 1e-12}],
            "output": {"write": []},
        }
    )


@pytest.mark.mpi(ranks=(1, 2))
@pytest.mark.parametrize("boundary", ["dirichlet", "open", "neumann", "periodic"])
def test_particles_on_any_wall_are_inside_and_those_beyond_are_not(comm, tmp_path, boundary):
    walls = 0.1 * np.concatenate([np.eye(3), -np.eye(3), np.ones((1, 3)), -np.ones((1, 3))])
    beside = np.nextafter(0.1, [0.0, 1.0])[:, None] * [1.0, 0.0, 0.0]  # a number below the wall, and one beyond
    places = np.concatenate([walls, beside, -beside])
    simulation = amrpic.Simulation(comm, scene_of(tmp_path, places, boundary, comm.rank))
    inside = sorted(np.concatenate(comm.allgather(simulation.particles.id)).tolist())
    lost = sorted(np.concatenate(comm.allgather(simulation.lost.particles.id)).tolist())
    assert lost == ([] if boundary == "periodic" else [9, 11])
    assert inside == sorted(set(range(12)) - set(lost))
    assert simulation.rho.integral() == pytest.approx(1e-12 * len(inside) / 12, rel=1e-12)
    for position in comm.allgather(simulation.particles.position):
        assert (np.abs(position) <= 0.1).all()


@pytest.mark.mpi(ranks=(1, 2))
def test_a_bunch_of_which_most_is_outside_is_refused(comm, tmp_path):
    places = np.zeros((7, 3))
    places[:4, 1] = 0.11
    with pytest.raises(InputError, match="4 of 7 particles of bunch 1 of 1 lie outside the domain; move the bunch"):
        amrpic.Simulation(comm, scene_of(tmp_path, places, "open", comm.rank))
    amrpic.Simulation(comm, scene_of(tmp_path, places, "periodic", comm.rank))
    places[3, 1] = 0.1
    amrpic.Simulation(comm, scene_of(tmp_path, places, "open", comm.rank))


def test_both_signs_for_micro_are_a_unit():
    assert to_metres("3 \u00b5m") == to_metres("3 \u03bcm") == to_metres("3 um") == 3e-6
    with pytest.raises(SceneError, match="beyond all measure"):
        amrpic.GaussianBunch(sigma="1e70 m", charge=1e-12, particles=1)


def command(tmp_path: Path, *more: str) -> list[str]:
    (tmp_path / "small.toml").write_text(SCENE)
    return [PROGRAM, *(more or ("run",)), str(tmp_path / "small.toml")]


@pytest.mark.parametrize("ranks", [1, 2])
def test_a_full_standard_output_does_not_end_a_run(tmp_path, ranks):
    """Under mpiexec it is mpiexec that writes, and that takes no notice."""
    with open("/dev/full", "w") as full:
        end = subprocess.run(
            ["mpiexec", "-n", str(ranks), *command(tmp_path), "--output", str(tmp_path / "run")][0 if ranks > 1 else 3 :],
            stdout=full, stderr=subprocess.PIPE, env=mpi_batch.ENVIRONMENT, text=True, timeout=60,
        )  # fmt: skip
    assert end.returncode == 0
    if ranks == 1:
        assert end.stderr.count("\n") == 1
        assert "the log cannot be written (No space left on device); the run goes on without it" in end.stderr
    assert (tmp_path / "run" / "checkpoint_00000001" / "state.h5").exists()


def test_a_full_standard_output_is_one_sentence_where_it_is_the_result(tmp_path):
    with open("/dev/full", "w") as full:
        end = subprocess.run(
            command(tmp_path, "check"),
            stdout=full,
            stderr=subprocess.PIPE,
            env=mpi_batch.ENVIRONMENT,
            text=True,
            timeout=60,
        )
    assert end.returncode == 1
    assert end.stderr.count("\n") == 1 and "standard output cannot be written: No space left on device; " in end.stderr


@pytest.mark.parametrize("closed", [">&-", "2>&-", "<&- >&- 2>&-"])
def test_closed_streams_do_no_harm(tmp_path, closed):
    """What is printed does not end in a file that was opened in the stream's place."""
    words = [*command(tmp_path), "--output", str(tmp_path / "run")]
    end = subprocess.run(["bash", "-c", f'exec "$@" {closed}', "bash", *words], env=mpi_batch.ENVIRONMENT, timeout=60)
    assert end.returncode == 0
    check = subprocess.run([PROGRAM, "check", str(tmp_path / "run")], env=mpi_batch.ENVIRONMENT, timeout=60)
    assert check.returncode == 0


def test_a_suspended_process_does_not_take_the_others_for_lost(monkeypatch):
    """A clock that jumps by a minute, as where a batch system suspends a job for a while."""
    minutes, looks = itertools.count(), iter([False, False, True])
    clock = SimpleNamespace(monotonic=lambda: 60.0 * next(minutes), sleep=lambda seconds: None)
    monkeypatch.setattr(failure, "time", clock)
    others = cast(MPI.Request, SimpleNamespace(Test=lambda: next(looks)))
    assert failure.is_over(others, failure.GRACE)


@pytest.mark.parametrize("after", [0.15, 0.4, 0.8, 1.5])
def test_ctrl_c_during_the_start_is_one_sentence(tmp_path, after):
    words = [*command(tmp_path), "--output", str(tmp_path / "run"), "--set", "schedule.steps=100000"]
    with subprocess.Popen(
        words, stderr=subprocess.PIPE, stdout=subprocess.PIPE, env=mpi_batch.ENVIRONMENT, text=True,
        preexec_fn=lambda: signal.signal(signal.SIGINT, signal.SIG_DFL),  # tests that run in the background ignore it
    ) as process:  # fmt: skip
        time.sleep(after)
        process.send_signal(signal.SIGINT)
        try:
            _, errors = process.communicate(timeout=60)
        finally:
            process.kill()
    assert "Traceback" not in errors and errors.count("\n") <= 1, errors
    if process.returncode == 75:  # on a fast machine it had begun, and leaves a checkpoint
        assert "go on with --restart auto" in errors
    else:
        assert process.returncode in (1, -signal.SIGINT) and errors in ("amrpic: interrupted\n", "")


@pytest.mark.parametrize("end, status", [("Unknown", 0), ("", 0), ("nan", 0), ("inf", 0), ("1", 75)])
def test_the_end_of_a_batch_job_may_be_unknown(tmp_path, end, status):
    environment = {**mpi_batch.ENVIRONMENT, "SLURM_JOB_END_TIME": end}
    words = [*command(tmp_path), "--output", str(tmp_path / "run")]
    assert subprocess.run(words, env=environment, timeout=60).returncode == status


def test_a_log_that_cannot_be_written_is_given_up_once(comm, capfd):
    with open("/dev/full", "w") as full:
        log = RunLog(comm, 3, out=full)
        log.note("one")
        log.note("two")
    assert capfd.readouterr().err.count("the log cannot be written") == 1

"""Work that takes long reports what it is, on rank 0, after three seconds of silence."""

from __future__ import annotations

import io
import threading
from types import SimpleNamespace
from typing import cast

import pytest
from mpi4py import MPI

from amrpic import progress as module
from amrpic.errors import InputError
from amrpic.progress import Progress, reported
from amrpic.run.clock import WORKS, Clock


class Time:
    def __init__(self) -> None:
        self.now = 100.0

    def __call__(self) -> float:
        return self.now


def lines_of(told: Progress, time: Time, seconds: int) -> list[tuple[float, str]]:
    """Look once a second; return what is said and when."""
    out = []
    for _ in range(seconds):
        time.now += 1.0
        if (line := told.line()) is not None:
            out.append((time.now - 100.0, line))
    return out


def test_silence_of_three_seconds_is_broken_and_then_that_of_twice_as_many_up_to_a_minute():
    time = Time()
    told = Progress(time)
    with told("making particles"):
        said = lines_of(told, time, 220)
    assert said[0] == (3.0, "still making particles, 3 s so far")
    assert [when for when, _ in said] == [3, 9, 21, 45, 93, 153, 213]


def test_what_was_said_else_counts_and_the_innermost_work_is_named():
    time = Time()
    told = Progress(time)
    with told("at work on the run"):
        assert lines_of(told, time, 2) == []
        told.spoke()
        with told("making the mesh"):
            assert lines_of(told, time, 4) == [(5.0, "still making the mesh, 3 s so far")]
        assert lines_of(told, time, 5) == [(11.0, "still at work on the run, 11 s so far")]
    assert lines_of(told, time, 100) == []  # nothing is being done


@pytest.mark.parametrize("rank", [0, 1])
def test_a_thread_of_rank_0_reports_while_the_work_goes_on(rank, monkeypatch):
    said = threading.Event()

    class Out(io.StringIO):
        def flush(self) -> None:
            said.set()

    time, out = Time(), Out()
    told = Progress(time)
    monkeypatch.setattr(module, "progress", told)
    monkeypatch.setattr(module, "PERIOD", 1e-3)
    monkeypatch.delenv(module.VARIABLE, raising=False)
    with reported(cast(MPI.Comm, SimpleNamespace(rank=rank)), out), told("solving for the potential"):
        time.now += 3.0
        if rank == 0:
            assert said.wait(60)
    assert out.getvalue() == ("" if rank else "still solving for the potential, 3 s so far\n")
    assert "progress" not in [thread.name for thread in threading.enumerate()]


@pytest.mark.parametrize("seconds", ["0", "7"])
def test_the_variable_chooses_after_which_silence(seconds, monkeypatch):
    time, out = Time(), io.StringIO()
    told = Progress(time)
    monkeypatch.setattr(module, "progress", told)
    monkeypatch.setenv(module.VARIABLE, seconds)
    with reported(MPI.COMM_SELF, out), told("making the mesh"):
        names = [thread.name for thread in threading.enumerate()]
        assert ("progress" in names) == (seconds != "0")
    if seconds != "0":  # the thread is over, the silence stays
        with told("making the mesh"):
            assert lines_of(told, time, 30) == [
                (when, f"still making the mesh, {when:.0f} s so far") for when in (7, 21)
            ]


@pytest.mark.parametrize("text", ["x", "-1", "nan", "inf", ""])
def test_what_is_no_number_of_seconds_is_refused(text, monkeypatch):
    monkeypatch.setenv(module.VARIABLE, text)
    with pytest.raises(InputError, match=f'AMRPIC_PROGRESS is "{text}"; give seconds'), reported(MPI.COMM_SELF):
        raise AssertionError("not reached")


@pytest.mark.parametrize("stage", WORKS)
def test_stages_of_a_step_are_named(stage, monkeypatch):
    time = Time()
    told = Progress(time)
    monkeypatch.setattr("amrpic.run.clock.progress", told)
    with Clock()(stage):
        assert lines_of(told, time, 3) == [(3.0, f"still {WORKS[stage]}, 3 s so far")]

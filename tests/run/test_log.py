"""The run log: what is printed while a run goes on."""

from __future__ import annotations

import io
import warnings

import pytest

from amrpic.run.log import RunLog, step_line

ROW = {
    "step": 12,
    "time": 1.2e-9,
    "cells_0": 1000,
    "cells_1": 234,
    "boxes": 21,
    "particles": 99_990,
    "lost_particles": 10,
    "cycles": 7,
    "residual": 3.14e-11,
    "seconds": 1.25,
    "memory": 412 * 2**20,
}


def test_a_step_is_one_line_with_all_that_matters():
    assert step_line(ROW, 100, 110.4) == (
        "step  12/100  t 1.2000e-09 s  2 levels 21 boxes 1234 cells  99990 particles 10 lost  "
        "7 cycles 3.1e-11  1.25 s/step  ETA 0:01:50  412 MiB"
    )


@pytest.mark.mpi(ranks=(2,))
def test_only_rank_0_prints(comm):
    out, err = io.StringIO(), io.StringIO()
    with RunLog(comm, 13, out, err) as log:
        log.step(ROW)
        log.step({**ROW, "step": 13})
        warnings.warn("something may not be meant", stacklevel=1)
    lines = out.getvalue().splitlines()
    assert len(lines) == (2 if comm.rank == 0 else 0)
    assert len(err.getvalue().splitlines()) == (1 if comm.rank == 0 else 0)
    if comm.rank == 0:
        assert "ETA 0:00:01" in lines[0]
        assert "ETA 0:00:00" in lines[1]


def test_a_terminal_changes_nothing(comm):
    class Terminal(io.StringIO):
        def isatty(self) -> bool:
            return True

    plain, terminal = io.StringIO(), Terminal()
    for stream in (plain, terminal):
        with RunLog(comm, 20, stream) as log:
            log.step(ROW)
    assert plain.getvalue() == terminal.getvalue()
    assert plain.getvalue().count("\n") == 1
    assert not set("\r\x1b") & set(plain.getvalue())


def test_each_warning_is_reported_once_and_counted_at_the_end(comm):
    err = io.StringIO()
    shown_before = warnings.showwarning
    with RunLog(comm, 20, io.StringIO(), err) as log:
        for _ in range(3):
            warnings.warn("nothing is tagged", stacklevel=1)
        log.warn("no particles")
        assert err.getvalue().splitlines() == ["warning: nothing is tagged", "warning: no particles"]
    assert err.getvalue().splitlines()[2:] == ["warning, 3 times in all: nothing is tagged"]
    assert warnings.showwarning is shown_before

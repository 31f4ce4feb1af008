"""The time series: complete rows survive, torn ones go, numbers keep every bit."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time

import numpy as np
import pytest

from amrpic.errors import InputError, OutputError
from amrpic.io import time_series
from amrpic.io.provenance import Provenance
from amrpic.io.time_series import Series
from amrpic.units import Column

COLUMNS = [
    Column("step", counts=True),
    Column("time", "s"),
    Column("particles", counts=True),
    Column("charge", "C"),
]
ABOUT = Provenance({"name": "test"}, "0.1.0", 42)


def row(step: int) -> dict[str, float]:
    return {"step": step, "time": step / 3, "particles": 2**53 + 1 - step, "charge": -0.1 * step, "more": 1}


@pytest.mark.mpi(ranks=(1, 2))
def test_numbers_read_back_bit_for_bit(comm, tmp_path):
    path = tmp_path / "run" / "series.csv"
    file = Series(comm, path, COLUMNS, ABOUT)
    for step in range(5):
        file.append(row(step) if comm.rank == 0 else {})
    file.append({"step": 5, "time": float("nan"), "particles": 0, "charge": float("inf")})
    file.sync()
    file.close()
    rows = time_series.read(path)
    assert rows.dtype.names == ("step", "time", "particles", "charge")
    assert rows["time"][:5].tolist() == [row(step)["time"] for step in range(5)]
    assert rows["particles"][:5].tolist() == [row(step)["particles"] for step in range(5)]
    assert np.isnan(rows["time"][5])
    assert np.isinf(rows["charge"][5])


@pytest.mark.mpi(ranks=(2,))
def test_a_restart_cuts_off_what_came_after_its_step_and_what_is_torn(comm, tmp_path):
    path = tmp_path / "series.csv"
    file = Series(comm, path, COLUMNS, ABOUT)
    for step in range(10):
        file.append(row(step))
    file.close()
    if comm.rank == 0:
        path.write_bytes(path.read_bytes()[:-3])
    comm.barrier()
    assert time_series.read(path)["step"].tolist() == list(range(9))
    comm.barrier()
    file = Series(comm, path, COLUMNS, ABOUT, keep_to_step=8)
    file.append(row(9))
    file.close()
    assert time_series.read(path)["step"].tolist() == list(range(10))
    comm.barrier()
    Series(comm, path, COLUMNS, ABOUT, keep_to_step=3).close()
    assert time_series.read(path)["step"].tolist() == list(range(4))
    comm.barrier()
    Series(comm, path, COLUMNS, ABOUT).close()
    assert len(time_series.read(path)) == 0


def test_a_series_of_other_columns_is_not_cut(comm, tmp_path):
    path = tmp_path / "series.csv"
    Series(comm, path, COLUMNS, ABOUT).close()
    with pytest.raises(OutputError, match="the file there has other columns"):
        Series(comm, path, COLUMNS[:2], ABOUT, keep_to_step=3)


def test_what_is_no_series_is_named(comm, tmp_path):
    path = tmp_path / "series.csv"
    with pytest.raises(InputError, match="No such file"):
        time_series.read(path)
    path.write_text("a,b\n1,2\n")
    for beside in (None, "{", "[1]", '{"format": "something else"}'):
        if beside is not None:
            (tmp_path / "series.json").write_text(beside)
        with pytest.raises(InputError, match=r"series .*series.csv cannot be read: .*; give a file that a run wrote"):
            time_series.read(path)


def test_columns_that_are_not_those_described_are_refused(comm, tmp_path):
    path = tmp_path / "series.csv"
    Series(comm, path, COLUMNS, ABOUT).close()
    path.write_text(path.read_text().replace("charge", "mass"))
    with pytest.raises(InputError, match=r"its columns are not those of series\.json"):
        time_series.read(path)


def test_pandas_reads_a_table_without_options(comm, tmp_path):
    pandas = pytest.importorskip("pandas")
    path = tmp_path / "series.csv"
    file = Series(comm, path, COLUMNS, ABOUT)
    file.append(*(row(step) for step in range(3)), {"step": 3, "charge": float("nan")})
    file.close()
    table = pandas.read_csv(path)
    assert list(table) == [column.name for column in COLUMNS]
    assert list(table.dtypes) == ["int64", "float64", "int64", "float64"]
    assert table.charge[2] == -0.2 and np.isnan(table.charge[3])
    assert time_series.units_of(path) == {"step": "", "time": "s", "particles": "", "charge": "C"}
    assert time_series.scene_of(path) == {"name": "test"}


@pytest.mark.mpi(ranks=(2,))
def test_a_folder_that_cannot_be_written_is_one_error(comm, tmp_path):
    if comm.rank == 0:
        (tmp_path / "file").write_text("")
    comm.barrier()
    with pytest.raises(OutputError, match=r"cannot write series .*: File exists; ") as caught:
        Series(comm, tmp_path / "file" / "series.csv", COLUMNS, ABOUT)
    assert len(set(comm.allgather(str(caught.value)))) == 1


WRITER = """
import sys
from pathlib import Path
from mpi4py import MPI
from amrpic.io.provenance import Provenance
from amrpic.io.time_series import Series
from amrpic.units import Column

file = Series(MPI.COMM_SELF, Path(sys.argv[1]), [Column("step", counts=True), Column("value")], Provenance())
for step in range(10**9):
    file.append({"step": step, "value": step / 3})
"""


def test_a_kill_at_any_moment_leaves_complete_rows(tmp_path):
    path = tmp_path / "series.csv"
    process = subprocess.Popen([sys.executable, "-c", WRITER, str(path)], env={**os.environ})
    while not path.exists() or path.stat().st_size < 10_000:
        assert process.poll() is None
        time.sleep(0.01)
    process.send_signal(signal.SIGKILL)
    process.wait()
    rows = time_series.read(path)
    assert len(rows) > 100
    np.testing.assert_array_equal(rows["step"], np.arange(len(rows)))
    np.testing.assert_array_equal(rows["value"], np.arange(len(rows)) / 3)

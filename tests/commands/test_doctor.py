"""The doctor passes this machine, and names what is wrong on others with a fix."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import h5py
import numpy as np
import pytest

import mpi_batch
from amrpic.commands import doctor

EXAMINE = """
from mpi4py import MPI
from amrpic.commands import doctor
print(*doctor.examine(MPI.COMM_WORLD), sep="\\n")
"""


def examined(path: str | None = None) -> list[str]:
    """The lines of an examination in a process of its own, which may have another PATH."""
    environment = {**mpi_batch.ENVIRONMENT, "PATH": path or os.environ["PATH"]}
    command = [sys.executable, "-c", EXAMINE]
    done = subprocess.run(command, env=environment, capture_output=True, text=True, timeout=100)
    assert done.returncode == 0, done.stderr
    return done.stdout.splitlines()


def test_this_machine_passes_and_the_solve_takes_two_ranks():
    lines = examined()
    assert [line.split(":")[0] for line in lines] == [
        "ok   MPI",
        "ok   HDF5",
        "ok   Trilinos",
        "ok   kernels",
        "ok   solve",
    ]
    assert lines[-1].endswith("on 2 ranks")


@pytest.mark.mpi(ranks=(2, 3))
def test_under_mpiexec_the_given_ranks_solve_and_agree(comm, ranks):
    checks = doctor.examine(comm)
    assert all(check.passed for check in checks), "\n".join(map(str, checks))
    assert checks[-1].text.endswith(f"on {ranks} ranks")
    assert len(set(comm.allgather(tuple(checks)))) == 1


@pytest.mark.mpi(ranks=2)
def test_h5py_writes_and_reads_beside_the_hdf5_that_trilinos_brings(comm, tmp_path):
    assert len(doctor.loaded("libhdf5")) >= 2, (
        "Trilinos no longer brings an HDF5 of its own: this test and a check can go"
    )
    with h5py.File(tmp_path / f"{comm.rank}.h5", "w") as file:
        file.create_dataset("values", data=np.arange(10), chunks=(5,), compression="gzip")
    with h5py.File(tmp_path / f"{comm.rank}.h5") as file:
        assert np.array_equal(file["values"], np.arange(10))


@pytest.mark.parametrize(
    ("kokkos", "there"), [("", '"matrix-free" alone'), ("Kokkos 4", '"matrix-free", and "kokkos" on Kokkos 4')]
)
def test_a_build_without_trilinos_passes_and_says_what_it_lacks(monkeypatch, kokkos, there):
    monkeypatch.setattr(doctor._native, "trilinos_version", lambda: "")
    monkeypatch.setattr(doctor._native, "kokkos_backend", lambda: kokkos)
    assert doctor.trilinos_and_backend().startswith(f"none: of the backends there is {there}, and no equations")


def fake_mpiexec(folder: Path, text: str) -> str:
    """A PATH whose first mpiexec is this script."""
    script = folder / "mpiexec"
    script.write_text(f"#!/bin/sh\n{text}\n")
    script.chmod(0o755)
    return f"{folder}:{os.environ['PATH']}"


def test_mpiexec_of_another_mpi_is_found_out(tmp_path):
    # What such a launcher comes to: each process is alone.
    last = examined(fake_mpiexec(tmp_path, 'shift 2; exec "$@"'))[-2:]
    assert last[0].startswith("FAIL solve") and "belongs to another MPI" in last[0]
    assert "fix: " in last[1]


def test_launcher_that_fails_is_quoted(tmp_path):
    last = examined(fake_mpiexec(tmp_path, 'echo "no slots here" >&2; exit 1'))[-2:]
    assert last[0] == "FAIL solve: mpiexec -n 2 failed: no slots here"


@pytest.mark.mpi(ranks=2)
def test_what_is_wrong_on_one_rank_is_reported_on_all(comm):
    here = doctor.Check("MPI", comm.rank == 0, f"found on {comm.rank}", "fix")
    assert doctor.worst(tuple(comm.allgather(here))).text == "found on 1"


def test_wrong_answer_or_exception_becomes_a_failed_check():
    def ill() -> str:
        raise ValueError("two libraries")

    assert str(doctor.check("MPI", ill, "take one away")) == "FAIL MPI: two libraries\n     fix: take one away"
    assert doctor.check("MPI", lambda: "fine", "").passed

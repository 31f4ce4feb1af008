"""How processes end: Trilinos once, whatever still holds a solver then; all of a job, where one finds it broken."""

from __future__ import annotations

import subprocess
import sys

import pytest

import mpi_batch

SOLVE = """
import sys
import amrpic
from mpi4py import MPI
domain = amrpic.Domain(lower=(0, 0, 0), upper=(1, 1, 1), cells=(16, 16, 16), boundary="dirichlet")
hierarchy = amrpic.Hierarchy(MPI.COMM_WORLD, domain, levels=[], max_grid_size=8, blocking_factor=4)
solver = amrpic.PoissonSolver(hierarchy)
rho = amrpic.Field(hierarchy).fill(lambda x, y, z: 1e-12 + 0 * x * y * z)
phi, report = solver.solve(rho)
assert report.converged
"""
ENDINGS = {
    "global": ("", 0),
    "cycle": ("holder = [solver]; holder.append(holder)", 0),
    "module": ("sys.solver = solver", 0),
    "exit code": ("sys.exit(3)", 3),
    "finalized first": ("amrpic._native.finalize(); amrpic._native.finalize(); del solver", 0),
}


@pytest.mark.parametrize("ending", ENDINGS)
@pytest.mark.parametrize("ranks", [1, 2])
def test_process_that_holds_a_solver_ends_well(ending, ranks):
    lines, status = ENDINGS[ending]
    command = ["mpiexec", "-n", str(ranks), sys.executable, "-c", SOLVE + lines]
    done = subprocess.run(command, env=mpi_batch.ENVIRONMENT, capture_output=True, text=True, timeout=60)
    assert done.returncode == status, done.stderr


def test_native_module_refuses_to_start_without_mpi():
    code = """
import mpi4py
mpi4py.rc.initialize = False
try:
    import amrpic
except RuntimeError as refused:
    print(refused)
"""
    done = subprocess.run([sys.executable, "-c", code], env=mpi_batch.ENVIRONMENT, capture_output=True, text=True)
    assert "MPI is not initialised" in done.stdout, done.stderr


BROKEN = """
import amrpic
from mpi4py import MPI
comm = MPI.COMM_WORLD
if comm.rank == 0:
    try:
        amrpic._native.fail_alone("a cell that exists has no place")
    except RuntimeError as failure:
        print(f"raised: {failure}", flush=True)
comm.Barrier()
"""


@pytest.mark.parametrize("ranks", [1, 2])
def test_promise_that_one_rank_finds_broken_ends_a_job_with_its_sentence(ranks):
    """A script that goes on after any exception would leave the other rank waiting."""
    command = ["mpiexec", "-n", str(ranks), sys.executable, "-c", BROKEN]
    done = subprocess.run(command, env=mpi_batch.ENVIRONMENT, capture_output=True, text=True, timeout=60)
    sentence = "a cell that exists has no place"
    if ranks == 1:
        assert (done.returncode, done.stdout) == (0, f"raised: {sentence}\n"), done.stderr
    else:
        assert done.returncode != 0 and "raised" not in done.stdout
        assert f"amrpic: {sentence} (on rank 0 of 2 alone)\n" in done.stderr

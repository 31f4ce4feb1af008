"""The plugin that gives a test its MPI ranks, tried on tests that pass, fail, hang and crash."""

from __future__ import annotations

import re
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

import mpi_batch

pytestmark = pytest.mark.long  # what is tested is a tool, which users do not meet: for `make verify`

HERE = Path(__file__).parent
INNER = ("batch", "processes", "rank", "server")  # what the plugin consists of


def outcomes(tmp_path: Path, text: str) -> tuple[dict[str, str], str]:
    """Outcome by test name, and all that was printed, of a file with these tests."""
    for name in ("conftest.py", "support/backends.py", *(f"support/mpi_{part}.py" for part in INNER)):
        shutil.copy(HERE / name, tmp_path)
    (tmp_path / "test_inner.py").write_text("import os, sys, time, pytest\n" + text)
    command = [sys.executable, "-m", "pytest", "-rA", "-v", "--color=no", "-p", "no:cacheprovider", "test_inner.py"]
    environment = {key: value for key, value in mpi_batch.ENVIRONMENT.items() if key != "PYTEST_CURRENT_TEST"}
    done = subprocess.run(command, cwd=tmp_path, env=environment, capture_output=True, text=True, timeout=120)
    found = re.findall(r"^test_inner.py::(\S+) (PASSED|FAILED|SKIPPED|XFAIL|ERROR)", done.stdout, re.MULTILINE)
    return dict(found), done.stdout + done.stderr


def test_each_number_of_ranks_is_a_test_of_its_own(tmp_path):
    found, _ = outcomes(tmp_path, """
@pytest.mark.mpi(ranks=(1, 2), more=(3,))
def test_size(comm, ranks, request):
    assert comm.allreduce(1) == comm.size == ranks
    assert (request.node.get_closest_marker("long") is not None) == (ranks == 3)
@pytest.mark.mpi
@pytest.mark.parametrize("a", ["x", "y"])
def test_cases(comm, a): assert comm.bcast(a) == a
def test_plain(comm): assert comm.size == 1
""")  # fmt: skip
    names = ["test_size[1r]", "test_size[2r]", "test_size[3r]", "test_plain"]
    names += [f"test_cases[{n}r-{a}]" for n in (1, 2) for a in "xy"]
    assert found == dict.fromkeys(names, "PASSED")


def test_tests_of_a_file_share_one_call_and_one_directory(tmp_path):
    found, output = outcomes(tmp_path, """
@pytest.mark.mpi(ranks=2)
def test_first(comm, tmp_path): sys.at = os.getpid()
@pytest.mark.mpi(ranks=2)
def test_second(comm, tmp_path):
    assert sys.at == os.getpid()
    assert len(set(comm.allgather(str(tmp_path)))) == 1
    assert os.listdir(tmp_path) == []
""")  # fmt: skip
    assert found == {"test_first[2r]": "PASSED", "test_second[2r]": "PASSED"}, output


def test_fixtures_of_a_class_end_with_it_though_its_last_test_ran_elsewhere(tmp_path):
    found, output = outcomes(tmp_path, """
log = []
@pytest.fixture(scope="class")
def thing(request):
    yield log.append("begin")
    log.append("end")
    if request.cls.__name__ == "TestC": raise ValueError("not ended well")
class TestA:
    def test_here(self, thing): assert log == ["begin"]
    @pytest.mark.mpi(ranks=2)
    def test_there(self, comm, thing): assert log == ["begin"]
class TestB:
    def test_here(self): assert log == ["begin", "end"]
class TestC:
    def test_here(self, thing): pass
    @pytest.mark.mpi(ranks=1)
    def test_there(self, comm): pass
def test_last(): pass
""")  # fmt: skip
    assert list(found.values()) == ["PASSED", "PASSED", "PASSED", "PASSED", "ERROR", "PASSED"], output
    assert "not ended well" in output


def test_failure_on_one_rank_is_reported_and_the_next_test_runs(tmp_path):
    found, output = outcomes(tmp_path, """
@pytest.mark.mpi(ranks=2)
def test_fails(comm):
    if comm.rank: comm.send(1, 0)
    print("said before")
    assert comm.rank == 0, "only on one"
@pytest.mark.mpi(ranks=2)
def test_fails_while_the_other_waits(comm):
    assert comm.rank == 0, "alone"
    comm.barrier()
@pytest.mark.mpi(ranks=2)
def test_next(comm): assert not comm.iprobe()
""")  # fmt: skip
    assert found == {
        "test_fails[2r]": "FAILED", "test_fails_while_the_other_waits[2r]": "FAILED", "test_next[2r]": "PASSED"
    }  # fmt: skip
    assert "rank 1 of 2: AssertionError: only on one" in output and "said before" in output
    assert "rank 1 of 2: AssertionError: alone" in output and "other ranks did not end the test" in output


def test_deadlock_is_ended_and_shows_where(tmp_path):
    found, output = outcomes(tmp_path, """
@pytest.mark.mpi(ranks=2, timeout=1)
def test_waits(comm): comm.recv(source=1 - comm.rank)
@pytest.mark.mpi(ranks=2)
def test_next(comm): assert comm.allreduce(1) == 2
""")  # fmt: skip
    assert found == {"test_waits[2r]": "FAILED", "test_next[2r]": "PASSED"}
    assert f"No end after {mpi_batch.PATIENCE:g} s" in output
    hung = re.findall(r'rank (\d) hung in ---(?s:.)*?test_inner.py", line 4 in test_waits', output)
    assert set(hung) == {"0", "1"}  # pytest repeats the text in its summary where CI is set


def test_crash_is_reported_and_the_next_test_runs(tmp_path):
    found, output = outcomes(tmp_path, """
@pytest.mark.mpi(ranks=2)
def test_segfault(comm):
    import ctypes
    if comm.rank: ctypes.string_at(0)
    comm.barrier()
@pytest.mark.mpi(ranks=2)
def test_abort(comm):
    if comm.rank: comm.Abort(3)
    comm.barrier()
@pytest.mark.mpi(ranks=2)
def test_crash_at_exit(comm):
    import atexit
    atexit.register(os._exit, 7)
""")  # fmt: skip
    assert found["test_segfault[2r]"] == found["test_abort[2r]"] == "FAILED"
    assert found["test_crash_at_exit[2r]"] == "ERROR"
    assert "status 139" in output and "in test_segfault" in output and "status 3" in output and "status 7" in output


def test_processes_may_take_their_time_to_end(tmp_path):
    """As on a busy machine, where MPI's own end alone takes many seconds."""
    found, output = outcomes(tmp_path, """
@pytest.mark.mpi(ranks=2)
def test_ends_late(comm):
    import atexit
    atexit.register(time.sleep, 11 if comm.rank else 0)
""")  # fmt: skip
    assert found == {"test_ends_late[2r]": "PASSED"}, output


def test_skips_and_expected_failures_pass_through(tmp_path):
    found, _ = outcomes(tmp_path, """
@pytest.mark.mpi(ranks=2)
def test_skipped(comm): pytest.skip("on all")
@pytest.mark.mpi(ranks=2)
def test_skipped_on_one(comm):
    if comm.rank: pytest.skip("here only")
@pytest.mark.mpi(ranks=2)
@pytest.mark.xfail(reason="known", strict=True)
def test_expected(comm): assert False
""")  # fmt: skip
    assert found == {"test_skipped[2r]": "SKIPPED", "test_skipped_on_one[2r]": "FAILED", "test_expected[2r]": "XFAIL"}


def test_file_that_cannot_be_imported_on_the_ranks_fails_its_tests(tmp_path):
    found, output = outcomes(tmp_path, """
if "AMRPIC_TEST_BATCH" in os.environ: raise ImportError("not here")
@pytest.mark.mpi(ranks=2)
def test_first(comm): pass
@pytest.mark.mpi(ranks=2)
def test_second(comm): pass
""")  # fmt: skip
    assert found == {"test_first[2r]": "FAILED", "test_second[2r]": "FAILED"}
    assert "ImportError: not here" in output


def test_pytest_under_mpiexec_is_refused():
    command = ["mpiexec", "-n", "2", sys.executable, "-m", "pytest", __file__, "--collect-only", "-q"]
    done = subprocess.run(command, env=mpi_batch.ENVIRONMENT, capture_output=True, text=True, timeout=60)
    assert done.returncode != 0 and "without mpiexec" in done.stdout + done.stderr

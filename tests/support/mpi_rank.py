"""The side of a rank: run the tests of a batch in step with the other ranks and note how each went.

A rank appends one JSON object per line to its own file, so that the launcher knows at any moment, even after a crash,
what ran.
"""

from __future__ import annotations

import faulthandler
import json
import os
import time
from collections.abc import Generator
from pathlib import Path
from typing import Any

import pytest

FOLDER = "AMRPIC_TEST_BATCH"  # environment variable: where the batch is described and the ranks write


def is_rank() -> bool:
    """True in the processes that the launcher started."""
    return FOLDER in os.environ


def from_first(value: Any) -> Any:
    """The value that the first rank passes. Collective."""
    return _own_comm().bcast(value)


_comm = None


def _own_comm() -> Any:
    """A communicator that tests cannot disturb."""
    global _comm
    if _comm is None:
        from mpi4py import MPI

        _comm = MPI.COMM_WORLD.Dup()
    return _comm


class Rank:
    """Plugin of one rank."""

    def __init__(self, config: pytest.Config) -> None:
        folder = Path(os.environ[FOLDER])
        number = _own_comm().rank
        self.config = config
        self.timeouts: dict[str, float] = json.loads((folder / "batch.json").read_text())
        self.notes = (folder / f"rank{number}.jsonl").open("w", buffering=1)
        self.stacks = (folder / f"rank{number}.stacks").open("w")
        self.failed = False
        config.option.basetemp = str(folder / f"tmp{number}")
        self.note(pid=os.getpid())

    def note(self, **entry: Any) -> None:
        self.notes.write(json.dumps(entry) + "\n")

    @pytest.hookimpl(trylast=True)
    def pytest_collection_modifyitems(self, items: list[pytest.Item]) -> None:
        chosen = {item.nodeid: item for item in items}
        items[:] = [chosen[nodeid] for nodeid in self.timeouts if nodeid in chosen]

    @pytest.hookimpl(wrapper=True)
    def pytest_runtest_protocol(self, item: pytest.Item) -> Generator[None, Any, Any]:
        self.note(start=item.nodeid)
        faulthandler.dump_traceback_later(self.timeouts[item.nodeid], file=self.stacks)
        result = yield
        faulthandler.cancel_dump_traceback_later()
        self.note(end=item.nodeid)
        if self.failed_anywhere():
            # What a failed test left behind, such as a message nobody received, must not meet the next one.
            item.session.shouldstop = "a test failed; the launcher runs the rest afresh"
        return result

    def pytest_runtest_logreport(self, report: pytest.TestReport) -> None:
        self.failed |= report.failed
        data = self.config.hook.pytest_report_to_serializable(config=self.config, report=report)
        self.note(report=data)

    def failed_anywhere(self) -> bool:
        """True if a test failed on any rank. Collective; waits without burning the processor the others need."""
        waiting = _own_comm().Ibarrier()
        while not waiting.Test():
            time.sleep(2e-4)
        return any(_own_comm().allgather(self.failed))

    @pytest.hookimpl(trylast=True)
    def pytest_sessionfinish(self, session: pytest.Session) -> None:
        # Failures are in the notes; an exit status other than 0 is left to mean a crash.
        session.exitstatus = 0

    def pytest_unconfigure(self) -> None:
        self.notes.close()
        self.stacks.close()

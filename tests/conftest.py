"""Fixtures of all tests, and the plugin that gives a test its MPI ranks.

`@pytest.mark.mpi(ranks=(1, 2), timeout=60)` runs a test once per number of ranks, on as many processes, which other files
share unless it asks for `fresh=True`.
Such a test asks for the fixture `comm`; its `tmp_path` is one directory for all ranks. `more=(4,)` adds numbers of ranks to its
long form.

A test with an argument `long` has two forms, short for False; the long ones carry the marker `long`, as do tests that have
no short form. `pytest` leaves them out unless it is given `-m`.

A build without Trilinos skips what needs it; AMRPIC_TEST_BACKEND chooses the default backend (`backends`).
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

import backends
import mpi_batch
import mpi_rank

WHOLE_RUNS = {"benchmarks", "commands", "docs", "run", "scaling", "verify"}  # folders of tests that take seconds each


def pytest_addoption(parser: pytest.Parser) -> None:
    parser.addoption("--need-browser", action="store_true", help="tests that need Chromium or mkdocs fail without")


def pytest_configure(config: pytest.Config) -> None:
    config.addinivalue_line(
        "markers",
        "mpi(ranks=(1, 2), more=(), timeout=60, fresh=False): on so many MPI ranks, and on more if long, within the timeout, "
        "in new processes",
    )
    config.addinivalue_line("markers", "browser: looks at pages in Chromium; skipped without, unless --need-browser")
    config.addinivalue_line("markers", "long: takes minutes; `pytest -m long` runs these alone, `pytest -m ''` all")
    plugin = mpi_rank.Rank(config) if mpi_rank.is_rank() else mpi_batch.Launcher(config)
    config.pluginmanager.register(plugin, "amrpic-mpi")
    backends.use_default()


def pytest_generate_tests(metafunc: pytest.Metafunc) -> None:
    if "long" in metafunc.fixturenames:
        metafunc.parametrize("long", [False, pytest.param(True, marks=pytest.mark.long)], ids=["short", "long"])
    mark = metafunc.definition.get_closest_marker("mpi")
    if mark is not None:
        metafunc.fixturenames.append("ranks")
        further = [pytest.param(n, marks=pytest.mark.long) for n in mark.kwargs.get("more", ())]
        metafunc.parametrize("ranks", [*mpi_batch.rank_counts(mark), *further], ids=lambda n: f"{n}r")


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Whole runs first: a file of few, long tests that began last would end long after all others."""
    items.sort(key=lambda item: item.path.parent.name not in WHOLE_RUNS)


@pytest.hookimpl(tryfirst=True)
def pytest_runtest_makereport(call: pytest.CallInfo[None]) -> None:
    if call.excinfo is not None and (lack := backends.lack(call.excinfo.value)):
        try:
            pytest.skip(lack)
        except pytest.skip.Exception:
            call.excinfo = pytest.ExceptionInfo.from_current()


@pytest.fixture
def comm() -> Any:
    """The communicator of all ranks of this test; outside `mark.mpi`, of this process alone."""
    from mpi4py import MPI

    return MPI.COMM_WORLD


@pytest.fixture
def tmp_path(tmp_path: Path) -> Path:
    """An empty directory, the same one on all ranks."""
    return Path(mpi_rank.from_first(str(tmp_path))) if mpi_rank.is_rank() else tmp_path

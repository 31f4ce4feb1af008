"""The launcher's side: run MPI tests on as few starts of `mpiexec` as can be, and report each test by itself.

All tests of a file with the same number of ranks make a batch, and batches of many files share their processes, for a start
takes longer than most tests. When a test fails, hangs or crashes, those after it run in new processes, so that none sees the
wreck of another. `@pytest.mark.mpi(fresh=True)` is for tests that measure their process or leave it changed.
"""

from __future__ import annotations

import json
import os
import time
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import pytest

from mpi_processes import Processes

PATIENCE = float(os.environ.get("AMRPIC_TEST_PATIENCE", "1"))  # more on slow or emulated processors
LONG = 20  # times what a short one may take
TIMEOUT = 60.0  # seconds for a test that does not say, and for start and end of the processes, which a busy machine makes long
KEPT = 2 << 30  # bytes of memory of processes that wait for the next batch
GRACE = 3.0  # seconds for the other ranks to end a test that failed on one, and for all to tell where they hang

# Taken before anything imports mpi4py, which marks the environment of this process as that of an MPI process.
ENVIRONMENT = {
    "OMP_NUM_THREADS": "1",
    **os.environ,
    "KOKKOS_DISABLE_WARNINGS": "1",  # of threads and cores; what tests print is looked at
    "AMRPIC_PROGRESS": "0",  # what a busy machine makes slow is not worth a line
    "OMPI_ALLOW_RUN_AS_ROOT": "1",
    "OMPI_ALLOW_RUN_AS_ROOT_CONFIRM": "1",
    "OMPI_MCA_rmaps_base_oversubscribe": "1",
    "OMPI_MCA_hwloc_base_binding_policy": "none",  # two jobs at once would be bound to the same cores
    "OMPI_MCA_mpi_yield_when_idle": "1",  # there may be more ranks than cores
}


def rank_counts(mark: pytest.Mark) -> tuple[int, ...]:
    """The numbers of ranks that a mark asks for."""
    ranks = mark.kwargs.get("ranks", (1, 2))
    return (ranks,) if isinstance(ranks, int) else tuple(ranks)


def ranks_of(item: pytest.Item) -> int | None:
    """Number of ranks of a test, None if it is not an MPI test."""
    if item.get_closest_marker("mpi") is None:
        return None
    assert isinstance(item, pytest.Function)
    return int(str(item.callspec.params["ranks"]))


def timeout_of(item: pytest.Item) -> float:
    """Seconds that the mark of an MPI test allows."""
    mark = item.get_closest_marker("mpi")
    factor = PATIENCE * (LONG if item.get_closest_marker("long") else 1)
    return factor * (float(mark.kwargs.get("timeout", TIMEOUT)) if mark else TIMEOUT)


def wants_fresh(item: pytest.Item) -> bool:
    """Whether a test is to have processes that ran none of another file, and run none after it."""
    mark = item.get_closest_marker("mpi")
    return mark is not None and bool(mark.kwargs.get("fresh", False))


@dataclass
class Notes:
    """What one rank has noted so far in its file."""

    path: Path
    pid: int = 0
    running: str | None = None
    reports: dict[str, list[pytest.TestReport]] = field(default_factory=dict)
    ended: set[str] = field(default_factory=set)
    read: int = 0

    def update(self, config: pytest.Config) -> None:
        """Read the lines that were added; one that is still being written waits for the next time."""
        if not self.path.exists():
            return
        text = self.path.read_bytes()[self.read :]
        whole = text[: text.rfind(b"\n") + 1]
        self.read += len(whole)
        for line in whole.splitlines():
            self.take(json.loads(line), config)

    def take(self, entry: dict[str, Any], config: pytest.Config) -> None:
        self.pid = entry.get("pid", self.pid)
        if "start" in entry:
            self.running = entry["start"]
            self.reports[entry["start"]] = []
        if "report" in entry:
            report = config.hook.pytest_report_from_serializable(config=config, data=entry["report"])
            if isinstance(report.longrepr, list):  # JSON has no tuples; the reason of a skip is one
                report.longrepr = tuple(report.longrepr)
            self.reports[report.nodeid].append(report)
        if "end" in entry:
            self.running = None
            self.ended.add(entry["end"])

    def failed(self, nodeid: str) -> bool:
        return any(report.failed for report in self.reports.get(nodeid, []))

    def memory(self) -> int | None:
        """Bytes that the rank held when it was through with its tests, None before."""
        told = self.path.with_suffix(".memory")
        return int(told.read_text()) if told.exists() else None


class Batch:
    """A list of tests of one file on some processes, and what is known of them after it."""

    def __init__(self, items: list[pytest.Item], processes: Processes, folder: Path) -> None:
        self.config = items[0].config
        self.items = items
        self.processes = processes
        self.folder = folder
        ranks = processes.ranks
        self.timeouts = {item.nodeid: timeout_of(item) for item in items}
        self.notes = [Notes(folder / f"rank{r}.jsonl") for r in range(ranks)]
        self.hung = False
        (folder / "batch.json").write_text(json.dumps(self.timeouts))
        option = self.config.option
        self.arguments = ["-q", "--color=no", "-m", ""]
        # A batch ends with one search for garbage; that plugin would add five, which take longer than most tests.
        self.arguments += ["-p", "no:cacheprovider", "-p", "no:unraisableexception"]
        self.arguments += [f"--tb={option.tbstyle}", *["-l"] * bool(option.showlocals)]
        self.arguments += ["-o", f"verbosity_assertions={max(0, option.verbose)}", str(items[0].path)]

    def run(self) -> None:
        """Run to the end, or to the moment when a test hangs."""
        try:
            self.processes.order(self.folder, self.arguments)
            self.watch()
        except BaseException:
            self.processes.kill()
            raise
        self.update()
        self.processes.pids = [notes.pid for notes in self.notes]
        self.processes.memory = sum(notes.memory() or 0 for notes in self.notes)

    def watch(self) -> None:
        """Return when the tests or processes have ended, or when they stayed longer in one stage than it may take."""
        stage, since = self.stage(), time.monotonic()
        while self.processes.status() is None and not self.hung and not self.through():
            time.sleep(0.02)
            self.update()
            if self.stage() != stage:
                stage, since = self.stage(), time.monotonic()
            self.hung = time.monotonic() - since > self.limit()

    def update(self) -> None:
        for notes in self.notes:
            notes.update(self.config)

    def through(self) -> bool:
        """True if all ranks are through with their tests."""
        return all(notes.memory() is not None for notes in self.notes)

    def is_sound(self) -> bool:
        """True if the processes can be trusted with other tests."""
        return self.through() and not any(notes.failed(item.nodeid) for notes in self.notes for item in self.items)

    def running(self) -> str | None:
        """The test in which at least one rank is."""
        return next((notes.running for notes in self.notes if notes.running), None)

    def parted(self) -> bool:
        """True if a rank is through with a test and failed in it: the others, waiting for it, may wait for ever."""
        return any(notes.failed(nodeid) for notes in self.notes for nodeid in notes.ended)

    def stage(self) -> tuple[str | None, bool]:
        return self.running(), self.parted()

    def limit(self) -> float:
        """Seconds that the present stage may take."""
        running = self.running()
        if self.parted():
            return GRACE
        return PATIENCE * TIMEOUT if running is None else self.timeouts[running] + GRACE

    def reports(self) -> dict[str, list[pytest.TestReport]]:
        """The reports of the tests that ran; at least of one."""
        found = {}
        for item in self.items:
            started = any(item.nodeid in notes.reports for notes in self.notes)
            if started and all(item.nodeid in notes.ended for notes in self.notes):
                found[item.nodeid] = self.merged(item.nodeid)
            elif started:
                found[item.nodeid] = [self.broken(item)]
        if not found:
            return {item.nodeid: [self.broken(item)] for item in self.items}
        failed = any(report.failed for reports in found.values() for report in reports)
        if not failed and not self.through():
            last = next(item for item in reversed(self.items) if item.nodeid in found)
            found[last.nodeid].append(self.broken(last, "teardown"))
        return found

    def bad_end(self, status: int | None) -> pytest.TestReport:
        """The report of processes that did not end well, after all that they were asked to do."""
        what = "did not end" if status is None else f"ended with status {status}"
        last = self.items[-1]
        text = f"The processes {what}, after all tests.\n{self.processes.said()[-8000:]}"
        return pytest.TestReport(
            last.nodeid, last.location, dict.fromkeys(last.keywords, 1), "failed", text, "teardown"
        )

    def merged(self, nodeid: str) -> list[pytest.TestReport]:
        """One report per phase of a test that ended on all ranks."""
        phases = []
        for when in ("setup", "call", "teardown"):
            pairs = [(r, report) for r, notes in enumerate(self.notes) for report in notes.reports[nodeid]]
            of_rank = {r: report for r, report in pairs if report.when == when}
            if of_rank:
                phases.append(merged_phase(when, of_rank))
        return phases

    def broken(self, item: pytest.Item, when: Any = "call") -> pytest.TestReport:
        """The report of a test that did not end on all ranks, or of the end of the processes after it."""
        pairs = [(r, report) for r, notes in enumerate(self.notes) for report in notes.reports.get(item.nodeid, [])]
        failed = {r: report for r, report in pairs if report.failed}
        if failed:
            cause = by_rank(failed, len(self.notes)) + "\nThe other ranks did not end the test."
        elif self.hung:
            cause = "The processes did not end." if when == "teardown" else f"No end after {timeout_of(item):g} s."
        else:
            cause = f"mpiexec ended with status {self.processes.status()}."
        return pytest.TestReport(
            item.nodeid, item.location, dict.fromkeys(item.keywords, 1), "failed", f"{cause}\n{self.text()}", when
        )

    def text(self) -> str:
        """What the processes printed, and where they hung."""
        parts = [("output", self.folder / "output"), ("mpiexec", self.processes.output)]
        parts += [(f"rank {r} hung in", notes.path.with_suffix(".stacks")) for r, notes in enumerate(self.notes)]
        texts = [(title, own_lines(path.read_text(errors="replace"))) for title, path in parts if path.exists()]
        return "\n".join(f"--- {title} ---\n{text}" for title, text in texts if text.strip())


def merged_phase(when: str, of_rank: dict[int, pytest.TestReport]) -> pytest.TestReport:
    """One report from those of all ranks: failed if it failed, or was skipped, on some of them only."""
    failed = {r: report for r, report in of_rank.items() if report.failed}
    report = next(iter((failed or of_rank).values()))
    outcomes = {r: report.outcome for r, report in of_rank.items()}
    if failed:
        if len(of_rank) > 1:
            report.longrepr = by_rank(failed, len(of_rank))
    elif len(set(outcomes.values())) > 1:
        report.outcome, report.longrepr = "failed", f"{when} went differently on the ranks: {outcomes}"
    return report


def own_lines(text: str) -> str:
    """The text without the stack frames of pytest itself, its end if it is long."""
    own = ("/_pytest/", "/pluggy/", "/pytest/", "/mpi4py/", "<frozen runpy>")
    lines = [line for line in text.splitlines() if not any(part in line for part in own)]
    return "\n".join(lines)[-8000:]


def headline(report: pytest.TestReport) -> str:
    """The first line of what went wrong."""
    crash = getattr(report.longrepr, "reprcrash", None)
    return (crash.message if crash else report.longreprtext).splitlines()[0]


def by_rank(failed: dict[int, pytest.TestReport], ranks: int) -> str:
    """The failures of all ranks, equal ones once."""
    where: dict[str, list[str]] = {}
    for rank, report in failed.items():
        sections = [f"{title}\n{text}" for title, text in report.sections]
        text = "\n".join([headline(report), report.longreprtext, *sections])
        where.setdefault(text, []).append(str(rank))
        report.sections = []
    return "\n".join(f"rank {', '.join(names)} of {ranks}: {text}" for text, names in where.items())


def torn_down(item: pytest.Item, nextitem: pytest.Item | None) -> list[pytest.TestReport]:
    """Finish fixtures of this process, of a module or class, that the next test has no use for; the report if that fails.

    They were left for this test by the last one that ran here.
    """
    state = item.session._setupstate
    call = pytest.CallInfo.from_call(lambda: state.teardown_exact(nextitem), when="teardown")
    return [item.ihook.pytest_runtest_makereport(item=item, call=call)] if call.excinfo else []


class Launcher:
    """Plugin of the process that the user starts."""

    def __init__(self, config: pytest.Config) -> None:
        if "OMPI_COMM_WORLD_SIZE" in ENVIRONMENT:
            raise pytest.UsageError("start pytest without mpiexec: it starts the ranks of each test itself")
        self.reports: dict[str, list[pytest.TestReport]] = {}
        self.waiting: dict[int, Batch] = {}  # the last batch of processes that can have another, by number of ranks

    @pytest.hookimpl(tryfirst=True)
    def pytest_runtest_protocol(self, item: pytest.Item, nextitem: pytest.Item | None) -> bool | None:
        ranks = ranks_of(item)
        if ranks is None:
            return None
        item.ihook.pytest_runtest_logstart(nodeid=item.nodeid, location=item.location)
        if item.nodeid not in self.reports:
            self.call(item, ranks)
        for report in [*self.reports[item.nodeid], *torn_down(item, nextitem)]:
            item.ihook.pytest_runtest_logreport(report=report)
        item.ihook.pytest_runtest_logfinish(nodeid=item.nodeid, location=item.location)
        return True

    def call(self, first: pytest.Item, ranks: int) -> None:
        """Run a test and those that may share its batch."""
        items = [first, *(item for item in first.session.items if self.may_share(item, first, ranks))]
        factory: pytest.TempPathFactory = first.config._tmp_path_factory  # type: ignore[attr-defined]
        fresh = wants_fresh(first)
        before = None if fresh else self.waiting.pop(ranks, None)
        if before is None or before.processes.status() is not None:
            processes = Processes(ranks, factory.mktemp("processes"), first.config.rootpath, ENVIRONMENT)
        else:
            processes = before.processes
        batch = Batch(items, processes, factory.mktemp("ranks"))
        batch.run()
        self.reports.update(batch.reports())
        if not batch.is_sound():
            processes.kill()
        elif fresh:
            self.reports[items[-1].nodeid] += self.ended(batch)
        else:
            self.waiting[ranks] = batch
            self.make_room(items[-1])

    def make_room(self, item: pytest.Item) -> None:
        """End the largest of the processes that wait if they hold too much memory; the test's report tells if that fails."""
        while sum(batch.processes.memory for batch in self.waiting.values()) > KEPT:
            largest = max(self.waiting, key=lambda ranks: self.waiting[ranks].processes.memory)
            self.reports[item.nodeid] += self.ended(self.waiting.pop(largest))

    def ended(self, batch: Batch) -> list[pytest.TestReport]:
        """End processes; a report if they end badly."""
        status = batch.processes.close(PATIENCE * TIMEOUT)
        return [] if status == 0 else [batch.bad_end(status)]

    @pytest.hookimpl(tryfirst=True)
    def pytest_sessionfinish(self, session: pytest.Session) -> None:
        for batch in self.waiting.values():
            for report in self.ended(batch):
                session.config.hook.pytest_runtest_logreport(report=report)
                session.exitstatus = pytest.ExitCode.TESTS_FAILED
        self.waiting.clear()

    def may_share(self, item: pytest.Item, first: pytest.Item, ranks: int) -> bool:
        same = item.path == first.path and ranks_of(item) == ranks and wants_fresh(item) == wants_fresh(first)
        return same and item is not first and item.nodeid not in self.reports

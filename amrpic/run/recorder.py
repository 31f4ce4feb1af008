"""What a run writes, and when: its series, files of its state, checkpoints, pictures, report, status, and a line per step."""

from __future__ import annotations

import time
from abc import ABC, abstractmethod
from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from typing import Generic, NamedTuple, Protocol, Self, TypeVar

from .. import isa
from ..errors import AmrpicError, InputError, OutputError
from ..io import checkpoint, checkpoint_folder, vtkhdf_writer
from ..io.checkpoint import Snapshot
from ..io.field_reader import LiveDump
from ..io.provenance import Moment, about
from ..io.run_status import FINISHED, STOPPED, Status
from ..io.time_series import Series, settle
from ..io.writer_ranks import writers_of
from ..mesh.field import Field, VectorField
from ..mesh.hierarchy import Hierarchy
from ..mpi import MPI
from ..parallel import together
from ..results.run_results import SERIES
from ..scene.any_scene import AnyScene
from ..units import Column
from ..view.draw import drawn
from ..view.views import View
from .clock import Clock
from .folder import set_aside
from .log import Log, RunLog, StepLine


class Recorded(Protocol):
    """The state of a run of any method."""

    @property
    def step(self) -> int:
        """Steps taken since the start."""


StateT = TypeVar("StateT", bound=Recorded)


class MeshFields(NamedTuple):
    """What field files and pictures show of a state."""

    hierarchy: Hierarchy
    fields: Mapping[str, Field | VectorField]
    moment: Moment


class Recorder(ABC, Generic[StateT]):
    """Writes the states of one run into its folder; a context manager. Collective to make, and in all that it does.

    Methods say what a row holds, and how each kind of file is written. `resumed`: the first state is recorded there already;
    what came after it is overwritten. `spent`: s that went by before it was made, and count for the first row.
    """

    line: StepLine
    views: Sequence[View]  # pictures at the end

    def __init__(
        self, comm: MPI.Comm, scene: AnyScene, clock: Clock, state: StateT, resumed: bool, log: Log, spent: float = 0.0
    ) -> None:
        self._comm, self._scene, self._clock = comm, scene, clock
        self._wanted, self._about, self._writers = set(scene.output.write), about(scene), writers_of(scene)
        self._keep = state.step if resumed else None
        self._kinds = {**self._files(), "checkpoint": (None, self._write_checkpoint)}
        self._written: dict[str, int] = {}  # the latest step of each kind of output
        self._warned: set[str] = set()
        self._since = time.perf_counter() - spent
        self._log = RunLog(comm, scene.schedule.last_step, how=log, line=type(self).line)
        self._log.note(f"kernels: {isa.description()}")
        self._noted = len(self._notes()) if resumed else 0
        self._say()
        if self._wanted and not resumed and (earlier := set_aside(comm, scene.directory)) is not None:
            self._log.note(earlier)
        self._series = self._open(SERIES, self._columns())
        self._status = Status(comm, scene, state.step)

    # ---- what methods say ----

    @abstractmethod
    def _columns(self) -> Sequence[Column]:
        """Return the columns of the series."""

    @abstractmethod
    def _row(self, state: StateT) -> dict[str, float]:
        """Return the row of a state, but for its step and the seconds that it took. Collective."""

    @abstractmethod
    def _mesh(self, state: StateT) -> MeshFields:
        """Return what field files and pictures show of a state. Collective."""

    @abstractmethod
    def _snapshot(self, state: StateT) -> Snapshot:
        """Return what a checkpoint of a state holds."""

    @abstractmethod
    def _files(self) -> dict[str, tuple[int | None, Callable[[StateT], None]]]:
        """Return for each kind of file but checkpoints the steps between two, 0 of those that the end alone writes and None of
        those that checkpoints go with, and what writes it, in the order in which they are written.
        """

    def _remarks(self, state: StateT) -> Iterable[str]:
        """Return what is legal in a state and yet may not be meant. Collective."""
        return self._scene.remarks()

    def _notes(self) -> Sequence[str]:
        """Return what the run chose by itself so far."""
        return ()

    def _dt(self) -> float:
        """Return the time step in s; 0 of methods without one."""
        return 0.0

    def _tables(self) -> list[Series]:
        """Return the open tables."""
        return [] if self._series is None else [self._series]

    def _add_rows(self, state: StateT) -> None:
        """Add the rows of a state to the tables besides the series; they are settled afterwards. Collective."""

    def _add_last_rows(self, state: StateT) -> None:
        """Add the rows that the last state has in any case; they are settled afterwards. Collective."""

    def _draw_more(self) -> None:
        """Draw what else the end of a run has pictures of. Collective."""

    def complete(self, state: StateT) -> StateT:
        """Return a state all of which is of its time, as its files and checkpoints hold it. Collective."""
        return state

    def failed(self, state: StateT, error: AmrpicError) -> None:
        """Write what is of interest of a run that can go no further. Collective."""

    # ---- the same for all ----

    def _open(self, name: str, columns: Sequence[Column]) -> Series | None:
        if "series" not in self._wanted:
            return None
        return Series(self._comm, self._scene.directory / name, columns, self._about, self._keep)

    def __enter__(self) -> Self:
        self._log.__enter__()
        return self

    def __exit__(self, kind: object, failure: BaseException | None, trace: object) -> None:
        for table in self._tables():
            table.close()
        self._log.__exit__(kind, failure, trace)
        if failure is not None:
            self._status.failed(failure, self._written)

    def state(self, state: StateT) -> None:
        """Record a state: its rows and line, and the files that are due."""
        with self._clock("output"):
            row = {**self._row(state), "step": state.step, "seconds": self._seconds()}
            if self._series is not None:
                self._series.add(row)
            self._add_rows(state)
            self._settle()
            self._say()
            self._log.step(row)
            for remark in self._remarks(state):
                if remark not in self._warned:
                    self._warned.add(remark)
                    self._log.warn(remark)
            interval = self._scene.output.checkpoint_every
            checkpoint_due = bool(interval) and state.step > 0 and state.step % interval == 0
            due = {
                kind
                for kind, (steps, _) in self._kinds.items()
                if kind in self._wanted and (checkpoint_due if steps is None else steps and state.step % steps == 0)
            }
            self._write(self.complete(state) if due - {"fields"} else state, due)
            self._status.says(self._notes(), self._log.warned)
            self._status.step(row, self._log.pace, self._dt(), self._written)

    def end(self, state: StateT, stop: Callable[[], str | None]) -> str | None:
        """Write what the end of a run leaves, of a state that is complete.

        Pictures come last: where `stop()`, which all ranks call before each, gives a reason, the rest is left out, and the
        reason is returned.
        """
        with self._clock("output"):
            self._add_last_rows(state)
            self._settle()
            self._write(state)
            if "pictures" in self._wanted and (reason := self._draw(state, stop)) is not None:
                self._log.warn(
                    f"stopped at step {state.step}, not all pictures drawn: {reason}; go on with --restart auto"
                )
                self._ended(STOPPED, reason)
                return reason
        self._ended(FINISHED)
        return None

    def stopped(self, state: StateT, reason: str) -> None:
        """Write what a run needs to go on later, of a state that is complete."""
        self._write(state, {kind for kind, (steps, _) in self._kinds.items() if steps is None})
        self._log.warn(f"stopped at step {state.step}: {reason}; go on with --restart auto")
        self._ended(STOPPED, reason)

    def _ended(self, how: str, why: str = "") -> None:
        """Say how the run ended, and write the report if it is wanted."""
        self._status.says(self._notes(), self._log.warned)
        self._status.end(how, why, self._written)
        if "report" in self._wanted:
            with together(self._comm, OutputError):
                if self._comm.rank == 0:
                    from ..results import report_page  # matplotlib takes long to import, and no other rank needs it

                    try:
                        report_page.write(self._scene.directory)
                    except InputError as error:  # as of a series without rows, after a restart from the last step
                        self._log.warn(str(error))

    def _seconds(self) -> float:
        """Return the time since the last row, s."""
        now = time.perf_counter()
        seconds, self._since = now - self._since, now
        return seconds

    def _settle(self) -> None:
        """Raise OutputError on all ranks if a row could not be added. Collective."""
        if tables := self._tables():
            settle(self._comm, tables)

    def _say(self) -> None:
        """Say in the log what the run has chosen by itself since the latest time."""
        notes = self._notes()
        for note in notes[self._noted :]:
            self._log.note(note)
        self._noted = len(notes)

    def _write(self, state: StateT, kinds: Collection[str] | None = None) -> None:
        """Write files of some kinds of a state, all if none are given, if they are wanted and not written yet."""
        for kind, (_, write) in self._kinds.items():
            if kind in self._wanted and (kinds is None or kind in kinds) and self._written.get(kind) != state.step:
                self._written[kind] = state.step
                write(state)

    def _write_fields(self, state: StateT) -> None:
        directory, mesh = self._scene.directory, self._mesh(state)
        path = vtkhdf_writer.path_of(directory, state.step)
        vtkhdf_writer.write(path, *mesh, self._about, self._writers)
        vtkhdf_writer.list_time(self._comm, directory, mesh.moment)

    def _write_checkpoint(self, state: StateT) -> None:
        for table in self._tables():
            table.sync()  # a restart from the checkpoint relies on the rows before it
        directory, output = self._scene.directory, self._scene.output
        path = checkpoint_folder.path_of(directory, state.step)
        checkpoint.write(self._comm, path, self._snapshot(state), self._writers)
        checkpoint_folder.prune(self._comm, directory, output.keep, output.keep_every * output.checkpoint_every)

    def _draw(self, state: StateT, stop: Callable[[], str | None]) -> str | None:
        """Draw what a field file of a state shows, or would show, until `stop()` gives a reason, which is returned."""
        directory = self._scene.directory
        path = vtkhdf_writer.path_of(directory, state.step)
        pictures = drawn(LiveDump(path, *self._mesh(state), self._about.scene_text), directory, self.views)
        for _ in self.views:
            if (reason := stop()) is not None:
                return reason
            next(pictures)
        self._draw_more()
        return None

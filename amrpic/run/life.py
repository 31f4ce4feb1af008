"""The life of a run of any method: from its first state step by step to the last, stopped early if need be."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Iterator
from pathlib import Path
from typing import Generic

from ..errors import AmrpicError
from ..io import checkpoint
from ..io.checkpoint import Snapshot
from ..io.writer_ranks import writers_of
from ..mpi import MPI
from ..results.run_results import Results
from ..scene.any_scene import AnyScene
from .folder import STOP, claimed
from .log import Log
from .recorder import Recorder, StateT
from .stop import Stop


class Run(ABC, Generic[StateT]):
    """A scene on the ranks of a communicator, whose `state` is the present one. Methods say what a step is."""

    comm: MPI.Comm
    scene: AnyScene
    state: StateT
    _begun = False  # whether the files of this run are there
    _recorded = False  # whether they hold the present state already

    @property
    @abstractmethod
    def is_over(self) -> bool:
        """Whether the scene asks for no more steps."""

    @abstractmethod
    def advance(self) -> StateT:
        """Take a step and return the state then. Collective."""

    @abstractmethod
    def _recorder(self, log: Log) -> Recorder[StateT]:
        """Return what writes the files of this run. Collective."""

    @abstractmethod
    def _snapshot(self) -> Snapshot:
        """Return what a checkpoint of the present state holds. Collective."""

    def __iter__(self) -> Iterator[StateT]:
        """Step by step to the last one of the scene; yields the state after each. Collective."""
        while not self.is_over:
            yield self.advance()

    def run(self, walltime: float | None = None, log: Log = "print") -> Results:
        """Go on to the last step of the scene, write what it asks for, and return it, to be read back. Collective.

        When a signal came or `walltime` (s since the start of the process) is nearly over, the run stops after a checkpoint,
        and `stopped` of what is returned says why. A line per step and warnings are printed, given to Python's `logging` (as
        "amrpic.run"), or left out by `log="silent"`.
        """
        return Results(self.comm, self.scene.directory, self._run(walltime, log))

    def _run(self, walltime: float | None, log: Log) -> str | None:
        with (
            claimed(self.comm, self.scene),
            Stop(self.comm, walltime, self.scene.directory / STOP) as stop,
            self._recorder(log) as record,
        ):
            self._begun = True
            if not self._recorded:
                self._record(record)
            while not self.is_over:
                if (reason := stop.reason()) is not None:
                    self.state = record.complete(self.state)
                    record.stopped(self.state, reason)
                    return reason
                try:
                    self.advance()
                except AmrpicError as error:
                    record.failed(self.state, error)
                    raise
                self._record(record)
            self.state = record.complete(self.state)
            return record.end(self.state, stop.reason)

    def _record(self, record: Recorder[StateT]) -> None:
        record.state(self.state)
        self._recorded = True

    def checkpoint(self, path: str | Path) -> None:
        """Write the whole state into the new checkpoint `path`. Collective; OutputError on all ranks."""
        checkpoint.write(self.comm, Path(path), self._snapshot(), writers_of(self.scene))

"""A run of material points: from a first state load step by load step to the last, stopped early if need be, started again."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Self

from mpi4py import MPI

from ..errors import InputError, SolverError
from ..io import checkpoint_writer
from ..parallel import world_by_default
from ..pic.restart import writers_of
from ..results.run_results import Results
from ..run.folder import STOP, claimed
from ..run.log import Log
from ..run.stop import Stop
from .limits import require_room
from .record import Recorder
from .restart import load, snapshot
from .scene import Scene
from .state import Plan, State
from .step import advance, begin


class Simulation:
    """A scene of material points on the ranks of a communicator. Collective to make: its points are made then.

    `state` is the present one; it is a value, and a later step makes a new one. `run` writes what the scene asks for;
    `advance`, and a loop over the simulation, write nothing.
    """

    @world_by_default
    def __init__(self, comm: MPI.Comm, scene: Scene) -> None:
        """`comm` may be left out: all ranks."""
        if not isinstance(scene, Scene):
            raise InputError(f"a simulation was given {scene!r:.60} to run; give an amrpic.mpm.Scene")
        require_room(comm, scene)
        plan = Plan(comm, scene)
        self._hold(plan, begin(plan))

    def _hold(self, plan: Plan, state: State) -> None:
        self.comm, self.scene, self._plan, self.state = plan.comm, plan.scene, plan, state
        self._begun = self._recorded = False

    @classmethod
    @world_by_default
    def restart(cls, comm: MPI.Comm, path: str | Path, scene: Scene | None = None) -> Self:
        """Return the run that a checkpoint holds, on any number of ranks. Collective; InputError on all ranks.

        `comm` may be left out: all ranks. `scene` takes the place of the one in the checkpoint; its domain, faces and
        names of materials must be the same. On as many ranks as wrote it, the run goes on bit by bit as it would have.
        """
        state, plan = load(comm, Path(path), scene)
        run = cls.__new__(cls)
        run._hold(plan, state)
        run._begun = run._recorded = True
        return run

    def advance(self) -> State:
        """Take a load step and return the state then. Collective; SolverError on all ranks if there is no equilibrium."""
        self.state = advance(self.state, self._plan)
        self._recorded = False
        return self.state

    def __iter__(self) -> Iterator[State]:
        """Step by step to the whole load; yields the state after each. Collective."""
        while self.state.load < 1:
            yield self.advance()

    def run(self, walltime: float | None = None, log: Log = "print") -> Results:
        """Go on to the whole load, write what the scene asks for, and return it, to be read back. Collective.

        When a signal came or `walltime` (s since the start of the process) is nearly over, the run stops after a checkpoint,
        and `stopped` of what is returned says why. Where no equilibrium is found the last state is written before SolverError
        is raised on all ranks.
        """
        return Results(self.comm, self.scene.directory, self._run(walltime, log))

    def _run(self, walltime: float | None, log: Log) -> str | None:
        with (
            claimed(self.comm, self.scene),
            Stop(self.comm, walltime, self.scene.directory / STOP) as stop,
            Recorder(self.state, self._plan, self._begun, log) as record,
        ):
            self._begun = True
            if not self._recorded:
                self._record(record)
            while self.state.load < 1:
                if (reason := stop.reason()) is not None:
                    record.stopped(self.state, reason)
                    return reason
                try:
                    self.advance()
                except (SolverError, InputError):
                    record.failed(self.state)
                    raise
                self._record(record)
            record.end(self.state)
        return None

    def _record(self, record: Recorder) -> None:
        record.state(self.state)
        self._recorded = True

    def checkpoint(self, path: str | Path) -> None:
        """Write the whole state into the new directory `path`. Collective; OutputError on all ranks."""
        checkpoint_writer.write(self.comm, Path(path), snapshot(self.state, self._plan), writers_of(self.scene))

"""A run of material points: from a first state load step by load step to the last, stopped early if need be, started again."""

from __future__ import annotations

from pathlib import Path
from typing import Self

from ..errors import InputError
from ..io.checkpoint import Snapshot
from ..mpi import MPI
from ..parallel import world_by_default
from ..run.life import Run
from ..run.log import Log
from .point_recorder import PointRecorder
from .room import require_room
from .saved_state import load, snapshot
from .scene import Scene
from .state import LoadState, Plan
from .step import advance, begin


class Simulation(Run[LoadState]):
    """A scene of material points on the ranks of a communicator. Collective to make: its points are made then.

    `state` is the present one; it is a value, and a later step makes a new one. `run` writes what the scene asks for;
    `advance`, and a loop over the simulation, write nothing. Where no equilibrium is found, `run` writes the last state before
    SolverError is raised on all ranks.
    """

    scene: Scene

    @world_by_default
    def __init__(self, comm: MPI.Comm, scene: Scene) -> None:
        """`comm` may be left out: all ranks."""
        if not isinstance(scene, Scene):
            raise InputError(f"a simulation was given {scene!r:.60} to run; give an amrpic.mpm.Scene")
        require_room(comm, scene)
        plan = Plan(comm, scene)
        self._hold(plan, begin(plan))

    def _hold(self, plan: Plan, state: LoadState) -> None:
        self.comm, self.scene, self._plan, self.state = plan.comm, plan.scene, plan, state

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

    def advance(self) -> LoadState:
        """Take a load step and return the state then. Collective; SolverError on all ranks if there is no equilibrium."""
        self.state = advance(self.state, self._plan)
        self._recorded = False
        return self.state

    @property
    def is_over(self) -> bool:
        """Whether the whole load is on."""
        return self.state.load >= 1

    def _recorder(self, log: Log) -> PointRecorder:
        return PointRecorder(self.state, self._plan, self._begun, log)

    def _snapshot(self) -> Snapshot:
        return snapshot(self.state, self._plan)

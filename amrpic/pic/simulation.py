"""The run: from a first state step by step to the last, stopped early if need be, and started again."""

from __future__ import annotations

import re
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Self

import numpy as np
from numpy.typing import ArrayLike

from ..errors import InputError
from ..io.checkpoint import Snapshot
from ..io.openpmd_writer import write as write_particles
from ..io.provenance import about
from ..io.writer_ranks import writers_of
from ..mesh.field import Field, VectorField
from ..mesh.hierarchy import Hierarchy
from ..mesh.window import Window
from ..mpi import MPI
from ..parallel import together, world_by_default
from ..particles.particles import Particles
from ..run.clock import Clock
from ..run.life import Run
from ..run.log import Log
from ..scene.scene import Scene
from ..stages.poisson import SolveReport
from ..units import quantity
from .beam_tables import Diagnostic
from .course import ReferenceParticle
from .field_functions import FieldFunction
from .leapfrog import synchronized
from .particle_recorder import ParticleRecorder
from .records import Record
from .restart import load, snapshot
from .setup import Setup
from .state import State
from .step import advance, begin, with_momenta


class Simulation(Run[State]):
    """A scene in motion on the ranks of a communicator. Collective to make: the first field is solved then.

    The attributes are those of the present state; they are values, and a later step makes new ones. `run` writes what the scene
    asks for; `advance`, and a loop over the simulation, write nothing.
    """

    scene: Scene

    @world_by_default
    def __init__(self, comm: MPI.Comm, scene: Scene, fields: Sequence[FieldFunction] = ()) -> None:
        """`comm` may be left out: all ranks. `fields` are external fields besides those of the scene's elements, functions
        (x, y, z, t) -> (E, B).

        x, y, z (n,) in m are the places of a rank's particles, t in s is their time. E in V/m and B in T have three components
        each, along x, y, z, each an array (n,) or one number. All are in the laboratory. A function is called on all ranks,
        also for n = 0, and may communicate. A window follows the elements alone. Raises InputError on all ranks if a function
        fails or gives something else.
        """
        if not isinstance(scene, Scene):
            raise InputError(
                f"a simulation was given {scene!r:.60} to run; give an amrpic.Scene, as of Scene.from_toml"
            )
        self._hold(*begin(comm, scene, fields))

    def _hold(self, state: State, setup: Setup) -> None:
        self.comm, self.scene = setup.comm, setup.scene
        self.state, self._setup = state, setup
        self._callbacks: list[Callable[[Simulation], None]] = []
        self._diagnostics: dict[str, Diagnostic] = {}

    @classmethod
    @world_by_default
    def restart(
        cls, comm: MPI.Comm, path: str | Path, scene: Scene | None = None, fields: Sequence[FieldFunction] = ()
    ) -> Self:
        """Return the run that a checkpoint holds, on any number of ranks. Collective; InputError on all ranks.

        `comm` may be left out: all ranks. `scene` takes the place of the one in the checkpoint, to go on for longer or write
        something else; its cuboid and boundary must be those of the checkpoint. With other base cells or box sizes the mesh
        is made anew and the field solved on it, from the potential carried over. `fields` are as for a new run: a checkpoint
        holds their names alone. On as many ranks as wrote it, the run goes on bit by bit as it would have.
        """
        run = cls.__new__(cls)
        run._hold(*load(comm, Path(path), scene, fields))
        run._begun = run._recorded = True
        return run

    def __repr__(self) -> str:
        levels = self.hierarchy.levels
        cells = self.hierarchy.cells()
        at = f"step {self.step}, time {quantity(self.time, 's')}"
        return f"Simulation({self.scene.name!r}: {at}, levels {levels}, cells {cells}, ranks {self.comm.size})"

    def on_step(self, callback: Callable[[Simulation], None]) -> None:
        """Have `callback` called with this simulation after each step, on all ranks, before that step is written."""
        self._callbacks.append(callback)

    def kick(self, change: ArrayLike) -> None:
        """Change the momenta of this rank's particles by `change`, (n, 3) in kg m/s, in the order of `particles`. Collective.

        It is along the axes of the mesh, as their momenta are. It acts at the time of the present positions, before the next
        step, and is part of what this step writes if called from `on_step`. Raises InputError on all ranks if the shape is
        another one, or a number not finite.
        """
        now = synchronized(self.state, self._setup)
        with together(self.comm, InputError):
            momentum = now.synchronized.momentum + _momenta(change, len(now.particles), now.step)
        self.state = with_momenta(now, momentum, self._setup)

    def diagnose(self, name: str, diagnostic: Diagnostic) -> None:
        """Have the numbers and arrays that `diagnostic` returns for a state written into `own_<name>.csv`.

        It is called on all ranks, every `diagnostics.every` steps of a run that writes its series, and may communicate; values
        are those of rank 0.
        """
        if not re.fullmatch(r"[\w+-]+", name):
            raise InputError(f'the diagnostic "{name}" names a file; use letters, digits, _, + and - alone')
        self._diagnostics[name] = diagnostic

    def advance(self, steps: int = 1) -> State:
        """Take so many steps, also beyond the last one of the scene, and return the state then. Collective."""
        for _ in range(steps):
            self.state = advance(self.state, self._setup)
            self._recorded = False
            for callback in self._callbacks:
                callback(self)
        return self.state

    @property
    def is_over(self) -> bool:
        """Whether the last step of the scene is taken."""
        return self.step >= self.scene.schedule.last_step

    def _recorder(self, log: Log) -> ParticleRecorder:
        return ParticleRecorder(self.state, self._setup, self._begun, self._diagnostics, log)

    def _snapshot(self) -> Snapshot:
        return snapshot(synchronized(self.state, self._setup), self._setup)

    def write_particles(self, path: str | Path) -> None:
        """Write all particles into the openPMD file `path` for BeamPhysics and others, in the laboratory.

        Collective; OutputError on all ranks.
        """
        state = synchronized(self.state, self._setup)
        run, writers = about(self.scene), writers_of(self.scene)
        write_particles(self.comm, Path(path), state.synchronized, state.moment, run, writers=writers)

    @property
    def clock(self) -> Clock:
        """What measures the stages of steps."""
        return self._setup.clock

    @property
    def remarks(self) -> list[str]:
        """What is legal in this run and yet may not be meant, one sentence each."""
        return [*self.scene.remarks(), *self._setup.remarks.warnings]

    @property
    def hierarchy(self) -> Hierarchy:
        """The mesh of the present fields."""
        return self.state.hierarchy

    @property
    def particles(self) -> Particles:
        """This rank's particles; momenta belong to the same time as positions. Their arrays are read-only: see `kick`.

        During a run they are made at each call and equal those of a checkpoint to rounding; at its end they are the same.
        """
        return self.state.synchronized.read_only()

    @property
    def rho(self) -> Field:
        """Charge density of the particles, C/m³."""
        return self.state.rho

    @property
    def phi(self) -> Field:
        """Potential, V; read-only, since the field follows from it."""
        return self.state.phi

    @property
    def efield(self) -> VectorField:
        """Electric field, V/m; read-only."""
        return self.state.efield

    @property
    def bfield(self) -> VectorField:
        """Magnetic field of the particles, T: that of a beam whose self-field is solved for in its own frame, else zero."""
        return self.state.solution.bfield

    @property
    def step(self) -> int:
        """Steps taken since the start."""
        return self.state.step

    @property
    def time(self) -> float:
        """Time, s."""
        return self.state.time

    @property
    def window(self) -> Window:
        """Where the mesh is in the laboratory; coordinates of particles and fields are those of the mesh."""
        return self.state.window

    @property
    def reference(self) -> ReferenceParticle | None:
        """The reference particle, in the laboratory."""
        return self.state.course.reference

    @property
    def report(self) -> SolveReport:
        """How the latest solve went, with charges and voltages of electrodes in all fields together."""
        solution = self.state.solution
        return replace(solution.report, charges=solution.charges, voltages=solution.voltages)

    @property
    def lost(self) -> Record:
        """This rank's particles that were lost: where and when they left the domain or met which aperture."""
        return self.state.lost

    @property
    def screens(self) -> Record:
        """This rank's particles as they passed screens, once for each passage."""
        return self.state.screens


def _momenta(change: ArrayLike, count: int, step: int) -> np.ndarray:
    """Return changes of momenta as an array; raises InputError unless they are (count, 3) finite numbers."""
    values = np.asarray(change, dtype=np.float64)
    if values.shape != (count, 3):
        raise InputError(
            f"a kick at step {step} has shape {values.shape} for {count} particles of a rank; give a row of x, y, z in kg m/s "
            "for each of simulation.particles"
        )
    if bad := np.flatnonzero(~np.isfinite(values).all(axis=1)).tolist():
        raise InputError(
            f"a kick at step {step} is {values[bad[0]].tolist()} kg m/s for particle {bad[0]} of {count} of a rank; "
            "give finite numbers"
        )
    return values

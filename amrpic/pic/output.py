"""What a run writes, and when: series, field dumps, particles, checkpoints, pictures, and a line per step."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from types import TracebackType

from mpi4py import MPI

from .. import isa
from ..errors import OutputError, SolverError
from ..io import checkpoint_writer, openpmd_meshes, openpmd_writer, vtkhdf_writer
from ..io.field_reader import LiveDump
from ..io.run_status import FINISHED, STOPPED
from ..io.time_series import Series, settle
from ..mesh.domain import AXES
from ..mesh.field import Field, VectorField
from ..parallel import together
from ..particles.frame import LABORATORY
from ..results.run_results import SERIES
from ..run.folder import set_aside
from ..run.log import Log, RunLog
from ..run.status import Status
from ..stages.diagnostics import measure, quantities
from ..units import Quantity, quantity
from ..view.draw import drawn
from ..view.views import OVERVIEW
from .beam_tables import BeamTables, Diagnostic
from .fills import Fills
from .leapfrog import synchronized
from .loss_files import write_losses, write_screens
from .restart import about, snapshot, writers_of
from .setup import Setup
from .state import State

RESIDUALS = "residuals.csv"
HISTORY = (  # of the solves: a row for each guess and each cycle
    Quantity("step", counts=True),
    Quantity("time", "s"),
    Quantity("solve", counts=True),  # of the step: more than one where the field decides on the mesh
    Quantity("cycle", counts=True),
    Quantity("residual"),  # in the solver's norm, relative to that of a zero potential
)


class Recorder:
    """Writes the states of one run into its folder; a context manager. Collective to make, and in all that it does.

    `resumed`: the first state is recorded there already; what came after it is overwritten. `own`: diagnostics of a script.
    """

    def __init__(
        self,
        comm: MPI.Comm,
        state: State,
        setup: Setup,
        resumed: bool,
        own: Mapping[str, Diagnostic] | None = None,
        log: Log = "print",
    ) -> None:
        scene = setup.scene
        self._comm, self._scene, self._setup, self._clock = comm, scene, setup, setup.clock
        self._wanted = set(scene.output.write)
        self._about = about(scene)
        self._levels = scene.refinement.levels + 1
        self._written: dict[str, int] = {}  # the latest step of each kind of output
        self._warned: set[str] = set()
        self._turned = False  # whether it was remarked that files show the mesh along other axes than its own
        self._since = time.perf_counter() - sum(state.seconds.values())
        self._log = RunLog(comm, scene.schedule.last_step, how=log)
        self._log.note(f"kernels: {isa.description()}")
        self._noted = (
            len(setup.remarks.notes) if resumed else 0
        )  # of what the run chose by itself, those that the log has
        self._note()
        if self._wanted and not resumed and (earlier := set_aside(comm, scene.directory)) is not None:
            self._log.note(earlier)
        self._state_is(state)
        keep = state.step if resumed else None
        self._series = self._open(SERIES, quantities(self._levels), keep)
        self._residuals = self._open(RESIDUALS, HISTORY, keep)
        self._fills = Fills(setup.remarks.remark)
        wanted = "series" in self._wanted
        self._beam = BeamTables(comm, state, scene, self._about, keep, own or {}, self._fills) if wanted else None
        self._status = Status(comm, scene, state.step)

    def _open(self, name: str, columns: Sequence[Quantity], keep_to_step: int | None) -> Series | None:
        if "series" not in self._wanted:
            return None
        return Series(self._comm, self._scene.directory / name, columns, self._about, keep_to_step)

    def __enter__(self) -> Recorder:
        self._log.__enter__()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, value: BaseException | None, trace: TracebackType | None
    ) -> None:
        if kind is not None and issubclass(kind, SolverError):  # on all ranks, and of interest most of all
            self._write_history(self._step + 1, self._next)
            settle(self._comm, self._all_series())
        for series in (self._series, self._residuals):
            if series is not None:
                series.close()
        if self._beam is not None:
            self._beam.close()
        self._log.__exit__(kind, value, trace)
        if value is not None:
            self._status.failed(value, self._written)

    def state(self, state: State, remarks: list[str]) -> None:
        """Record a state: its row and line, the solves that led to it, and the files that are due."""
        with self._clock("output"):
            row = self._row(state)
            if self._series is not None:
                self._series.add(row)
            self._state_is(state)
            self._write_history(state.step, state.time)
            if self._beam is not None:
                self._beam.record(state)
            if series := self._all_series():
                settle(self._comm, series)
            self._note()
            self._log.step(row)
            if row["particles"] == 0 and row["lost_particles"] > 0:
                self._log.warn(
                    "all particles have left the domain or met apertures; enlarge them, or shorten the run or its steps"
                )
            for remark in [*remarks, *self._setup.remarks.warnings, *self._astray(state)]:
                if remark not in self._warned:
                    self._warned.add(remark)
                    self._log.warn(remark)
            output = self._scene.output
            if "fields" in self._wanted and output.fields_every and state.step % output.fields_every == 0:
                self._write_fields(state)
            particles_due = output.particles_every and state.step % output.particles_every == 0
            checkpoint_due = output.checkpoint_every and state.step > 0 and state.step % output.checkpoint_every == 0
            if ("particles" in self._wanted and particles_due) or ("checkpoint" in self._wanted and checkpoint_due):
                state = synchronized(state, self._setup)
            if particles_due:
                self._write_particles(state)
            self._write_openpmd(state)
            if checkpoint_due:
                self._write_records(state)
                self._write_checkpoint(state)
            self._status.says(self._setup.remarks.notes, self._log.warned)
            self._status.step(row, self._log.pace, self._setup.dt, self._written)

    def _note(self) -> None:
        """Say in the log what the run has chosen by itself since the latest time."""
        for note in self._setup.remarks.notes[self._noted :]:
            self._log.note(note)
        self._noted = len(self._setup.remarks.notes)

    def _astray(self, state: State) -> Iterator[str]:
        """Remark once that files and pictures show a mesh that has turned along the axes of the laboratory."""
        domain, window = state.hierarchy.domain, state.window
        if not (self._wanted & {"fields", "pictures"} and window.is_turned) or self._turned:
            return
        if (astray := window.astray(domain)) > domain.spacing.min():
            self._turned = True
            yield (
                f"from step {state.step} on the mesh is turned so far that files and pictures, which show it along the axes of "
                f"the laboratory about the reference particle, have its corners {quantity(astray, 'm')} beside their places, "
                "more than a base cell; its axes are in the files, and files of particles are in the laboratory"
            )

    def end(self, state: State, stop: Callable[[], str | None]) -> str | None:
        """Write what the end of a run leaves; the momenta are to be of its time.

        Pictures come last: where `stop()`, which all ranks call before each, gives a reason, the rest is left out, and the
        reason is returned.
        """
        if self._beam is not None:
            self._beam.record_now(state)
            settle(self._comm, self._beam.series)
        if "fields" in self._wanted:
            self._write_fields(state)
        self._write_particles(state)
        self._write_openpmd(state)
        self._write_records(state)
        self._write_checkpoint(state)
        if "pictures" in self._wanted and (reason := self._draw(state, stop)) is not None:
            self._log.warn(f"stopped at step {state.step}, not all pictures drawn: {reason}; go on with --restart auto")
            self._ended(STOPPED, reason)
            return reason
        self._ended(FINISHED)
        return None

    def stopped(self, state: State, reason: str) -> None:
        """Write what a run needs to go on later; the momenta are to be of its time."""
        self._write_records(state)
        self._write_checkpoint(state)
        self._log.warn(f"stopped at step {state.step}: {reason}; go on with --restart auto")
        self._ended(STOPPED, reason)

    def _ended(self, state: str, why: str = "") -> None:
        """Say how the run ended, and write the report if it is wanted."""
        self._status.says(self._setup.remarks.notes, self._log.warned)
        self._status.end(state, why, self._written)
        if "report" in self._wanted:
            with together(self._comm, OutputError):
                if self._comm.rank == 0:
                    from ..results import report  # matplotlib takes long to import, and no other rank needs it

                    report.write(self._scene.directory)

    def _all_series(self) -> list[Series]:
        own = [series for series in (self._series, self._residuals) if series is not None]
        return [*own, *(self._beam.series if self._beam is not None else [])]

    def _state_is(self, state: State) -> None:
        self._step, self._next = state.step, state.time + state.staggered.flight

    def _row(self, state: State) -> dict[str, float]:
        now = time.perf_counter()
        seconds, self._since = now - self._since, now
        beam = state.moments()
        self._fills.check({"all": beam.fill})
        measured = measure(
            state.particles, beam, state.lost.particles, state.rho, state.phi, state.efield, state.seconds
        )
        residuals = state.report.residuals
        return {
            **measured,
            "step": state.step,
            "time": state.time,
            "s": state.course.path,
            **{f"window_{axis}": x for axis, x in zip(AXES, state.window.origin, strict=True)},
            "regridded": int(state.regridded),
            "cycles": state.report.cycles,
            "residual": residuals[-1] if residuals else 0.0,
            "seconds": seconds,
        }

    def _write_history(self, step: int, now: float) -> None:
        solves = enumerate(self._setup.solvers.take_reports())
        if self._residuals is not None:
            self._residuals.add(
                *(
                    {"step": step, "time": now, "solve": solve, "cycle": cycle, "residual": residual}
                    for solve, report in solves
                    for cycle, residual in enumerate(report.residuals)
                )
            )

    def _write_fields(self, state: State) -> None:
        if self._written.get("fields") == state.step:
            return
        self._written["fields"] = state.step
        path = vtkhdf_writer.path_of(self._scene.directory, state.step)
        vtkhdf_writer.write(
            path,
            state.hierarchy,
            _shown(state),
            state.step,
            state.time,
            self._about,
            writers_of(self._scene),
            state.window,
        )
        vtkhdf_writer.list_time(self._comm, path.parent, state.step, state.time)

    def _write_particles(self, state: State) -> None:
        if "particles" not in self._wanted or self._written.get("particles") == state.step:
            return
        self._written["particles"] = state.step
        path = openpmd_writer.path_of(self._scene.directory, state.step)
        openpmd_writer.write(
            self._comm,
            path,
            state.synchronized,
            state.step,
            state.time,
            self._about,
            state.window,
            writers=writers_of(self._scene),
        )

    def _write_openpmd(self, state: State) -> None:
        """Write the view of a step's fields and particles for readers of openPMD, if the fields were written."""
        step, hierarchy, directory = state.step, state.hierarchy, self._scene.directory
        boxes = sum(len(hierarchy.boxes(level)) for level in range(hierarchy.levels))
        if self._written.get("fields") != step or boxes > openpmd_meshes.LARGEST:
            return
        openpmd_meshes.write(
            openpmd_meshes.path_of(directory, step),
            hierarchy,
            _shown(state),
            vtkhdf_writer.path_of(directory, step),
            openpmd_writer.path_of(directory, step) if self._written.get("particles") == step else None,
            step,
            state.time,
            self._about,
            state.window,
        )

    def _write_records(self, state: State) -> None:
        if "losses" not in self._wanted or self._written.get("losses") == state.step:
            return
        self._written["losses"] = state.step
        write_losses(self._comm, state, self._scene, self._about)
        write_screens(self._comm, state, self._scene, self._about)

    def _draw(self, state: State, stop: Callable[[], str | None]) -> str | None:
        """Draw what a field dump of a state shows, or would show, until `stop()` gives a reason, which is returned."""
        path = vtkhdf_writer.path_of(self._scene.directory, state.step)
        pictures = drawn(
            LiveDump(path, state.hierarchy, _shown(state), state.step, state.time, window=state.window), path.parent
        )
        for _ in OVERVIEW:
            if (reason := stop()) is not None:
                return reason
            next(pictures)
        return None

    def _write_checkpoint(self, state: State) -> None:
        if "checkpoint" not in self._wanted or self._written.get("checkpoint") == state.step:
            return
        self._written["checkpoint"] = state.step
        for series in (self._series, self._residuals):
            if series is not None:
                series.sync()  # a restart from the checkpoint relies on the rows before it
        if self._beam is not None:
            self._beam.sync()
        directory, output = self._scene.directory, self._scene.output
        path = checkpoint_writer.path_of(directory, state.step)
        checkpoint_writer.write(self._comm, path, snapshot(state, self._setup), writers_of(self._scene))
        checkpoint_writer.prune(self._comm, directory, output.keep, output.keep_every * output.checkpoint_every)


def _shown(state: State) -> dict[str, Field | VectorField]:
    """Return what dumps and pictures show of a state: B where the particles have a magnetic field of their own."""
    shown: dict[str, Field | VectorField] = {"rho": state.rho, "phi": state.phi, "E": state.efield.with_components()}
    if state.solution.frames.only != LABORATORY:
        shown["B"] = state.solution.bfield
    return shown

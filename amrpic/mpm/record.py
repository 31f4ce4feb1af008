"""What a run of material points writes, and when: series, points, fields, checkpoints, pictures, and a line per step."""

from __future__ import annotations

import time
from collections.abc import Mapping, Sequence
from types import TracebackType

from mpi4py import MPI

from .. import isa
from ..errors import OutputError
from ..io import checkpoint_writer, points_writer, vtkhdf_writer
from ..io.field_reader import LiveDump
from ..io.run_status import FINISHED, STOPPED
from ..io.time_series import Series
from ..parallel import together
from ..pic.restart import about, writers_of
from ..results.run_results import SERIES
from ..run.folder import set_aside
from ..run.log import Log, RunLog, line_of
from ..run.status import Status
from ..stages.diagnostics import peak_memory
from ..view.draw import draw
from ..view.views import OF_POINTS
from .means import element_means, point_values
from .measure import STAGES, loose_weights, quantities
from .restart import snapshot
from .state import Plan, State


class Recorder:
    """Writes the states of one run into its folder; a context manager. Collective to make, and in all that it does.

    `resumed`: the first state is recorded there already; what came after it is overwritten.
    """

    def __init__(self, state: State, plan: Plan, resumed: bool, log: Log = "print") -> None:
        scene = plan.scene
        self._comm, self._scene, self._plan = plan.comm, scene, plan
        self._wanted, self._about, self._writers = set(scene.output.write), about(scene), writers_of(scene)
        self._written: dict[str, int] = {}
        self._since = time.perf_counter()
        self._log = RunLog(plan.comm, scene.schedule.last_step, how=log, line=step_line)
        self._log.note(f"kernels: {isa.description()}")
        for remark in [*scene.remarks(), *loose_weights(state.placed)]:
            self._log.warn(remark)
        if self._wanted and not resumed and (earlier := set_aside(plan.comm, scene.directory)) is not None:
            self._log.note(earlier)
        self._series: Series | None = None
        if "series" in self._wanted:
            keep = state.step if resumed else None
            self._series = Series(plan.comm, scene.directory / SERIES, quantities(scene), self._about, keep)
        self._status = Status(plan.comm, scene, state.step)

    def __enter__(self) -> Recorder:
        self._log.__enter__()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, value: BaseException | None, trace: TracebackType | None
    ) -> None:
        if self._series is not None:
            self._series.close()
        self._log.__exit__(kind, value, trace)
        if value is not None:
            self._status.failed(value, self._written)

    def state(self, state: State) -> None:
        """Record a state: its row and line, and the files that are due."""
        with self._plan.clock("output"):
            row = self._row(state)
            if self._series is not None:
                self._series.append(row)
            self._log.step(row)
            output = self._scene.output
            every = {"fields": output.fields_every, "points": output.points_every}
            every |= {"checkpoint": output.checkpoint_every if state.step > 0 else 0}
            self._write(state, [kind for kind, steps in every.items() if steps and state.step % steps == 0])
            self._status.says([], self._log.warned)
            self._status.step(row, self._log.pace, 0.0, self._written)

    def end(self, state: State) -> None:
        """Write what the end of a run leaves."""
        with self._plan.clock("output"):
            self._write(state)
        if "pictures" in self._wanted:
            self._draw(state)
        self._ended(FINISHED)

    def stopped(self, state: State, reason: str) -> None:
        """Write what a run needs to go on later."""
        self._write(state, ["checkpoint"])
        self._log.warn(f"stopped at step {state.step}: {reason}; go on with --restart auto")
        self._ended(STOPPED, reason)

    def failed(self, state: State) -> None:
        """Write the last state of a run that can go no further."""
        self._write(state)

    def _ended(self, how: str, why: str = "") -> None:
        self._status.says([], self._log.warned)
        self._status.end(how, why, self._written)

    def _row(self, state: State) -> dict[str, float]:
        now = time.perf_counter()
        seconds, self._since = now - self._since, now
        spent = self._plan.clock.take()
        return {
            **state.measured,
            "step": state.step,
            "last_step": state.step + state.loads.steps_left,
            "load": state.load,
            "time": state.load,
            **{f"seconds_{stage}": spent[stage].seconds for stage in STAGES if stage in spent},
            "seconds": seconds,
            "memory": self._comm.allreduce(peak_memory(), MPI.MAX),
        }

    def _write(self, state: State, kinds: Sequence[str] = ("fields", "points", "checkpoint")) -> None:
        """Write files of these kinds of a state, if they are wanted and not written yet."""
        writers = {"fields": self._write_fields, "points": self._write_points, "checkpoint": self._write_checkpoint}
        for kind in kinds:
            if kind in self._wanted and self._written.get(kind) != state.step:
                self._written[kind] = state.step
                writers[kind](state)

    def _write_fields(self, state: State) -> None:
        directory = self._scene.directory
        path = vtkhdf_writer.path_of(directory, state.step)
        hierarchy, means = state.placed.mesh.hierarchy, element_means(state, self._scene)
        vtkhdf_writer.write(path, hierarchy, means, state.step, state.load, self._about, self._writers)
        vtkhdf_writer.list_time(self._comm, directory, state.step, state.load)

    def _write_points(self, state: State) -> None:
        directory, kind = self._scene.directory, points_writer.KIND
        path = vtkhdf_writer.path_of(directory, state.step, kind)
        place, (values, units) = state.placed.points.position, point_values(state)
        points_writer.write(self._comm, path, place, values, units, state.step, state.load, self._about, self._writers)
        vtkhdf_writer.list_time(self._comm, directory, state.step, state.load, kind)

    def _write_checkpoint(self, state: State) -> None:
        if self._series is not None:
            self._series.sync()  # a restart from the checkpoint relies on the rows before it
        directory, output = self._scene.directory, self._scene.output
        path = checkpoint_writer.path_of(directory, state.step)
        checkpoint_writer.write(self._comm, path, snapshot(state, self._plan), self._writers)
        checkpoint_writer.prune(self._comm, directory, output.keep, output.keep_every * output.checkpoint_every)

    def _draw(self, state: State) -> None:
        """Draw what a field dump of a state shows, or would show, and forces over travel."""
        path = vtkhdf_writer.path_of(self._scene.directory, state.step)
        hierarchy, means = state.placed.mesh.hierarchy, element_means(state, self._scene)
        dump = LiveDump(path, hierarchy, means, state.step, state.load, self._about.scene_text)
        draw(dump, path.parent, OF_POINTS)
        with together(self._comm, OutputError):
            if self._comm.rank == 0 and self._series is not None:
                from .pictures import draw_forces  # matplotlib takes long to import, and no other rank needs it

                draw_forces(path.parent, path.parent)


def step_line(row: Mapping[str, float], last_step: int, seconds_left: float) -> str:
    """Return the line of a step of material points: the load, the points, how the equilibrium was found."""
    return line_of(
        row,
        last_step,
        seconds_left,
        f"load {100 * row['load']:6.2f} %",
        f"{row['points']:.0f} points",
        f"J {row['j_min']:.3f} to {row['j_max']:.3f}",
        f"damage {row['damage_max']:.2f}",
        f"{row.get('turns', 0):.0f} turns",
        f"{row.get('newton_iterations', 0):.0f} Newton {row.get('cg_iterations', 0):.0f} CG",
        f"{row.get('cuts', 0):.0f} cuts",
    )

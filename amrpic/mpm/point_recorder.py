"""What a run of material points writes: series, points, fields, checkpoints, pictures, and a line per step."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence

from ..errors import AmrpicError, InputError, OutputError, SolverError
from ..io import points_writer, vtkhdf_writer
from ..io.checkpoint import Snapshot
from ..mpi import MPI
from ..parallel import together
from ..run.log import Log, line_of
from ..run.recorder import MeshFields, Recorder
from ..stages.diagnostics import peak_memory
from ..units import Column
from ..view.views import OF_POINTS
from .means import element_means, point_values
from .rows import STAGES, loose_weights, quantities
from .saved_state import snapshot
from .scene import Scene
from .state import LoadState, Plan


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


class PointRecorder(Recorder[LoadState]):
    """Writes the states of a run of material points into its folder."""

    _scene: Scene
    line = staticmethod(step_line)
    views = OF_POINTS

    def __init__(self, state: LoadState, plan: Plan, resumed: bool, log: Log = "print") -> None:
        self._plan = plan
        self._loose = loose_weights(state.placed)
        super().__init__(plan.comm, plan.scene, plan.clock, state, resumed, log)

    def failed(self, state: LoadState, error: AmrpicError) -> None:
        if isinstance(error, SolverError | InputError):
            self._write(state)

    def _columns(self) -> Sequence[Column]:
        return quantities(self._scene)

    def _remarks(self, state: LoadState) -> Iterable[str]:
        return [*super()._remarks(state), *self._loose]

    def _row(self, state: LoadState) -> dict[str, float]:
        spent = self._clock.take()
        return {
            **state.measured,
            "last_step": state.step + state.loads.steps_left,
            "load": state.load,
            "time": state.load,
            **{f"seconds_{stage}": spent[stage].seconds for stage in STAGES if stage in spent},
            "memory": self._comm.allreduce(peak_memory(), MPI.MAX),
        }

    def _mesh(self, state: LoadState) -> MeshFields:
        return MeshFields(state.placed.mesh.hierarchy, element_means(state, self._scene), state.moment)

    def _snapshot(self, state: LoadState) -> Snapshot:
        return snapshot(state, self._plan)

    def _files(self) -> dict[str, tuple[int | None, Callable[[LoadState], None]]]:
        output = self._scene.output
        return {
            "fields": (output.fields_every, self._write_fields),
            "points": (output.points_every, self._write_points),
        }

    def _write_points(self, state: LoadState) -> None:
        directory, kind = self._scene.directory, points_writer.KIND
        path = vtkhdf_writer.path_of(directory, state.step, kind)
        place, (values, units) = state.placed.points.position, point_values(state)
        points_writer.write(self._comm, path, place, values, units, state.moment, self._about, self._writers)
        vtkhdf_writer.list_time(self._comm, directory, state.moment, kind)

    def _draw_more(self) -> None:
        """Draw forces over travel."""
        with together(self._comm, OutputError):
            if self._comm.rank == 0 and self._series is not None:
                from .point_pictures import draw_forces  # matplotlib takes long to import, and no other rank needs it

                draw_forces(self._scene.directory, self._scene.directory)

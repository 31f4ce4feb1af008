"""What a run of particles writes: series, tables of the beam, field dumps, particles, losses, checkpoints, pictures."""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterable, Iterator, Mapping, Sequence

from ..conductors.refined import remembered_insides
from ..errors import AmrpicError, OutputError, SolverError
from ..io import openpmd_meshes, openpmd_writer, surface_files, time_series, vtkhdf_writer
from ..io.checkpoint import Snapshot
from ..io.time_series import Series
from ..mesh.domain import AXES
from ..mesh.field import Field, VectorField
from ..parallel import together
from ..particles.frame import LABORATORY
from ..run.log import Log, step_line
from ..run.recorder import MeshFields, Recorder
from ..scene.scene import Scene
from ..stages import tag
from ..stages.diagnostics import measure, quantities
from ..units import Column, quantity
from ..view.views import OVERVIEW, WITH_ELECTRODES
from .beam_tables import BeamTables, Diagnostic, Fills
from .driven_electrodes import Currents, columns_of
from .leapfrog import synchronized
from .loss_files import write_losses, write_screens
from .restart import snapshot
from .setup import Setup
from .state import State
from .tallies import EMISSION_MAP, MAP_COLUMNS, SOURCES, TABLE

RESIDUALS = "residuals.csv"
HISTORY = (  # of the solves: a row for each guess and each cycle
    Column("step", counts=True),
    Column("time", "s"),
    Column("solve", counts=True),  # of the step: more than one where the field decides on the mesh
    Column("cycle", counts=True),
    Column("residual"),  # in the solver's norm, relative to that of a zero potential
)


class ParticleRecorder(Recorder[State]):
    """Writes the states of a run of particles into its folder. `own`: diagnostics of a script."""

    _scene: Scene
    line = staticmethod(step_line)

    def __init__(
        self,
        state: State,
        setup: Setup,
        resumed: bool,
        own: Mapping[str, Diagnostic] | None = None,
        log: Log = "print",
    ) -> None:
        self._setup = setup
        self.views = WITH_ELECTRODES if setup.electrodes else OVERVIEW
        self._turned = False  # whether it was remarked that files show the mesh along other axes than its own
        scene = setup.scene
        super().__init__(setup.comm, scene, setup.clock, state, resumed, log, sum(state.seconds.values()))
        if scene.conductors and "fields" in self._wanted:
            with together(setup.comm, OutputError):
                if setup.comm.rank == 0:
                    surface_files.write(scene.directory / surface_files.FILE, setup.electrodes, scene.domain.value)
        self._residuals = self._open(RESIDUALS, HISTORY)
        self._sources = self._open(SOURCES, TABLE) if scene.sources else None
        self._since_sources = state.time  # s, of their latest row
        self._next_dt = state.staggered.dt  # s
        self._currents = Currents(state, setup.electrodes)
        self._fills, self._beam = Fills(setup.remarks.remark), None
        if "series" in self._wanted:
            self._beam = BeamTables(setup.comm, state, scene, self._about, self._keep, own or {}, self._fills)

    def complete(self, state: State) -> State:
        return synchronized(state, self._setup)

    def failed(self, state: State, error: AmrpicError) -> None:
        if isinstance(error, SolverError):  # on all ranks, and of interest most of all
            self._add_history(state.step + 1, state.time + state.staggered.flight)
            self._settle()

    def _columns(self) -> Sequence[Column]:
        return [*quantities(self._scene.refinement.levels + 1), *columns_of(self._setup.electrodes)]

    def _notes(self) -> Sequence[str]:
        return self._setup.remarks.notes

    def _dt(self) -> float:
        return self._next_dt

    def _tables(self) -> list[Series]:
        tables = [table for table in (self._residuals, self._sources) if table is not None]
        return [*super()._tables(), *tables, *(self._beam.series if self._beam is not None else [])]

    def _add_rows(self, state: State) -> None:
        self._next_dt = state.staggered.dt
        self._add_history(state.step, state.time)
        if self._sources is not None:
            at = {"step": state.step, "time": state.time}
            rows = state.tallies.rows(self._scene, state.time - self._since_sources)
            self._sources.add(*({**at, **row} for row in rows))
            self._since_sources = state.time
        if self._beam is not None:
            self._beam.record(state)

    def _add_last_rows(self, state: State) -> None:
        if self._beam is not None:
            self._beam.record_now(state)
        if self._sources is not None:
            rows = state.tallies.map_rows(self._scene, self._setup.emitters)
            path = self._scene.directory / EMISSION_MAP
            time_series.write(self._comm, path, MAP_COLUMNS, list(rows), self._about)

    def _remarks(self, state: State) -> Iterable[str]:
        yield from super()._remarks(state)
        yield from self._setup.remarks.warnings
        yield from self._astray(state)

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

    def _row(self, state: State) -> dict[str, float]:
        beam = state.moments()
        self._fills.check({"all": beam.fill})
        electrodes = self._setup.drive(state.time, state.window, state.lost).electrodes
        in_metal = tag.at_electrodes(state.hierarchy, electrodes, remembered_insides) if electrodes else ()
        lost = len(state.lost), float(state.lost.charges.sum())
        measured = measure(state.particles, beam, lost, state.rho, state.phi, state.efield, state.seconds, in_metal)
        if measured["particles"] == 0 and measured["lost_particles"] > 0:
            self._setup.remarks.remark(
                "all particles have left the domain or met apertures; enlarge them, or shorten the run or its steps"
            )
        residuals = state.report.residuals
        return {
            **measured,
            "time": state.time,
            "s": state.course.path,
            **{f"window_{axis}": x for axis, x in zip(AXES, state.window.origin, strict=True)},
            "regridded": int(state.regridded),
            "cycles": state.report.cycles,
            "residual": residuals[-1] if residuals else 0.0,
            **self._currents.row(state),
        }

    def _add_history(self, step: int, now: float) -> None:
        solves = enumerate(self._setup.solvers.take_reports())
        if self._residuals is not None:
            self._residuals.add(
                *(
                    {"step": step, "time": now, "solve": solve, "cycle": cycle, "residual": residual}
                    for solve, report in solves
                    for cycle, residual in enumerate(report.residuals)
                )
            )

    def _mesh(self, state: State) -> MeshFields:
        return MeshFields(state.hierarchy, _shown(state), state.moment)

    def _snapshot(self, state: State) -> Snapshot:
        return snapshot(state, self._setup)

    def _files(self) -> dict[str, tuple[int | None, Callable[[State], None]]]:
        output = self._scene.output
        return {
            "fields": (output.fields_every, self._write_fields),
            "particles": (output.particles_every, self._write_particles),
            "losses": (None, self._write_losses),
        }

    def _write(self, state: State, kinds: Collection[str] | None = None) -> None:
        super()._write(state, kinds)
        if kinds is None or {"fields", "particles"} & {*kinds}:
            self._write_openpmd(state)

    def _write_particles(self, state: State) -> None:
        path = openpmd_writer.path_of(self._scene.directory, state.step)
        openpmd_writer.write(self._comm, path, state.synchronized, state.moment, self._about, writers=self._writers)

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
            state.moment,
            self._about,
        )

    def _write_losses(self, state: State) -> None:
        write_losses(self._comm, state, self._scene, self._about, self._setup.electrodes)
        write_screens(self._comm, state, self._scene, self._about)


def _shown(state: State) -> dict[str, Field | VectorField]:
    """Return what dumps and pictures show of a state: B where the particles have a magnetic field of their own."""
    fields: dict[str, Field | VectorField] = {"rho": state.rho, "phi": state.phi, "E": state.efield.with_components()}
    if state.solution.frames.only != LABORATORY:
        fields["B"] = state.solution.bfield
    return fields

"""What the steps of a run take as given."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from functools import partial

import numpy as np

from .. import _native
from ..errors import InputError
from ..external import ExternalFields, Maps, read_maps
from ..mesh.window import Window
from ..mpi import MPI
from ..parallel import from_rank_0, own
from ..particles.clouds import EQUAL_PARTICLES, PAYING, Clouds, compensation_pays, matched_pays
from ..particles.particles import Particles
from ..run.clock import Clock
from ..scene.electrodes import Electrode
from ..scene.elements import MapElement
from ..scene.scene import Scene
from ..space_charge.drive import NO_ELECTRODES, Drive
from ..space_charge.solvers import Solvers
from ..stages.diagnostics import moments
from ..stages.encounters import native_screen
from .driven_electrodes import collected, electrodes_of, obstacles_of
from .emitters import Emitter, emitters_of
from .emitting_walls import EmittingWalls
from .field_functions import FieldFunction, FieldFunctions
from .movers import Mover, mover_of
from .records import Record
from .remarks import Remarks


@dataclass(frozen=True, eq=False)
class Setup:
    """What steps need that does not change with them. Made by `set_up`; `resolved` gives it the clouds of its bunches, and
    `time_step.with_time_step` its time step.
    """

    comm: MPI.Comm
    scene: Scene
    dt: float  # s; nan as long as it is to be chosen, 0 where motion follows no field
    external: ExternalFields  # of the scene's elements
    fields: FieldFunctions  # from Python
    electrodes: tuple[Electrode, ...]  # what the field ends on, in the laboratory
    obstacles: list[_native.Aperture | Electrode]  # what stops particles, likewise
    screens: list[_native.Screen]
    move: Mover
    solvers: Solvers
    emitters: tuple[Emitter, ...]  # the scene's sources
    emitting_walls: EmittingWalls
    remarks: Remarks
    clock: Clock = field(default_factory=Clock)
    compensation_by_auto: bool = False  # whether the run chose it by itself

    @property
    def clouds(self) -> Clouds:
        """The clouds of the particles."""
        return replace(
            self.scene.particles.clouds, kernels="kokkos" if self.scene.solver.backend == "kokkos" else "vectors"
        )

    def drive(self, time: float, window: Window, lost: Record) -> Drive:
        """Return the electrodes at a time, s, as a window shows them, with the charge of the `lost` particles. Collective."""
        if not self.electrodes:
            return NO_ELECTRODES
        return Drive.of(self.electrodes, time, window, collected(self.comm, lost, self.electrodes))

    @property
    def needs_balance(self) -> bool:
        """Whether a net charge has no potential."""
        return self.scene.fixes_no_potential and self.scene.background == "none"


def set_up(comm: MPI.Comm, scene: Scene, fields: Sequence[FieldFunction] = ()) -> Setup:
    """Return the set-up of a scene and fields from Python. Collective; InputError on all ranks."""
    comm, remarks, motion = own(comm), Remarks(), scene.motion
    electrodes, gaps = electrodes_of(comm, scene)
    if fields and not motion.follows_fields:
        remarks.remark(f'fields from Python act on nothing, since motion.kind is "{motion.kind}"; set it to "leapfrog"')
    for sentence in gaps:
        remarks.remark(sentence)
    return Setup(
        comm,
        scene,
        math.nan if motion.dt == "auto" else motion.dt,
        ExternalFields.of_scene(scene, _maps(comm, scene)),
        FieldFunctions(comm, fields),
        electrodes,
        obstacles_of(comm, scene, electrodes),
        [native_screen(screen) for screen in scene.screens],
        mover_of(scene),
        Solvers(
            scene.solver,
            None if scene.background == "none" else scene.background,
            scene.domain.wall_functions(),
            remarks.remark,
        ),
        emitters_of(comm, scene),
        EmittingWalls(scene, electrodes),
        remarks,
    )


def _maps(comm: MPI.Comm, scene: Scene) -> Maps:
    """Return the field maps of the scene, which rank 0 reads. Collective; InputError on all ranks."""
    if not any(isinstance(element, MapElement) for element in scene.elements):
        return {}
    return from_rank_0(comm, partial(read_maps, scene.elements), InputError)


# ---- what "auto" means for clouds ----


def resolved(setup: Setup, bunches: Sequence[Particles]) -> Setup:
    """Return the set-up with what "auto" means for these bunches, in interface and compensation, and note it. Collective."""
    scene = _with_compensation(_with_interface(setup, bunches), bunches, setup)
    by_auto = setup.scene.particles.compensation == "auto"
    return replace(setup, scene=scene, compensation_by_auto=by_auto or setup.compensation_by_auto)


def _with_interface(setup: Setup, bunches: Sequence[Particles]) -> Scene:
    scene, levels = setup.scene, setup.scene.refinement.levels
    if scene.particles.interface != "auto":
        return scene
    few = levels > 0 and any(_holds(bunch, matched_pays, setup) for bunch in bunches)
    kind = "matched" if few else "own-level"
    if levels > 0:
        why = "a bunch has at most" if few else "every bunch has more than"
        setup.remarks.note(f"particles.interface: {kind} clouds, because {why} {EQUAL_PARTICLES} (σ/h)² particles")
    return scene.with_clouds(interface=kind)


def _with_compensation(scene: Scene, bunches: Sequence[Particles], setup: Setup) -> Scene:
    if scene.particles.compensation != "auto":
        return scene
    shape, moves = scene.particles.shape, scene.motion.follows_fields

    def loses(number: float, sizes: np.ndarray) -> bool:
        return not compensation_pays(number, sizes, shape)

    pays = not [bunch for bunch in bunches if _holds(bunch, loses, setup)] and moves
    kind = "clouds" if pays else "none"
    if moves:
        why = "every bunch has more than" if pays else "a bunch has at most"
        setup.remarks.note(
            f"particles.compensation: {kind}, because {why} {PAYING[shape]} (σ/h)² particles per cell where it is densest"
        )
    return scene.with_clouds(compensation=kind)


def _holds(bunch: Particles, law: Callable[[float, np.ndarray], bool], setup: Setup) -> bool:
    """Whether law(equal particles, rms sizes in cells of the finest level) holds for a bunch with charge. Collective."""
    comm, domain = setup.comm, setup.scene.domain.value
    largest = comm.allreduce(bunch.weight.max(initial=0.0), MPI.MAX) or 1.0
    weight = bunch.weight / largest  # so that no square underflows
    total, square = comm.allreduce(np.array([weight.sum(), weight @ weight]))
    widths = domain.spacing / 2**setup.scene.refinement.levels
    return bool(total > 0) and law(total**2 / square, moments(comm, bunch, domain=domain).rms / widths)

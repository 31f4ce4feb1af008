"""What steps need that does not change with them: the scene, the solver of the present mesh, and a clock."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial

import numpy as np
from mpi4py import MPI

from ..errors import InputError, SolverError
from ..external import ExternalFields, Maps, read_maps
from ..mesh.field import Field, VectorField
from ..mesh.hierarchy import Hierarchy
from ..mesh.mirror import Mirror
from ..mesh.window import AT_REST, Window, vector
from ..parallel import from_rank_0, own
from ..particles.clouds import EQUAL_PARTICLES, PAYING, Clouds, compensation_pays, matched_pays
from ..particles.energy_bins import ONE_FRAME, Frames, frames_of
from ..particles.frame import LABORATORY, STATIC, Frame
from ..particles.motion_of_charge import charges
from ..particles.particles import Particles
from ..run.clock import Clock
from ..scene.elements import MapElement
from ..scene.motion import Leapfrog
from ..scene.scene import Scene
from ..stages.diagnostics import moments
from ..stages.encounters import native_aperture
from ..stages.gather import compensate
from ..stages.poisson import PoissonSolver, SolveReport
from .field_functions import FieldFunction, FieldFunctions
from .images import mirrored

FEW = 0.1  # share of the charge of a run that has no say in the frame any more where the frame of the rest does not fit it
LARGE = 0.01  # estimated error of the self-field's force that draws a remark


class Plan:
    """The scene and the fields from Python, and a solver that is kept as long as its hierarchy."""

    def __init__(self, comm: MPI.Comm, scene: Scene, fields: Sequence[FieldFunction] = ()) -> None:
        self.comm = own(comm)
        self.scene = scene
        dt = scene.motion.dt if isinstance(scene.motion, Leapfrog) else 0.0
        self.dt: float = math.nan if dt == "auto" else dt  # s; `settle_time_step` chooses it for "auto"
        self.clock = Clock()
        self.remarks: list[str] = []
        self.long_for: set[str] = set()  # kinds of what `dt` was remarked to be long for
        self.notes: list[str] = []  # what the run chose by itself, for its log
        self.compensation_by_auto = False  # whether the run chose it by itself
        self._told, self._warned = (1, 0.0), 0.0  # frames and error of the self-field that log and remarks have
        self._solves: list[SolveReport] = []
        self._solvers: dict[tuple[Frame, bool], PoissonSolver] = {}
        self.external = ExternalFields.of_scene(scene, self._maps())
        self.apertures = [native_aperture(aperture) for aperture in scene.apertures]
        self.fields = FieldFunctions(self.comm, fields)
        if fields and not isinstance(scene.motion, Leapfrog):
            self.remark(
                f'fields from Python act on nothing, since motion.kind is "{scene.motion.kind}"; set it to "leapfrog"'
            )
        self._walls: tuple[Field, VectorField] | None = None
        self._potential, self._slope = scene.domain.wall_functions()

    def _maps(self) -> Maps:
        """Return the field maps of the scene, which rank 0 reads. Collective; InputError on all ranks."""
        if not any(isinstance(element, MapElement) for element in self.scene.elements):
            return {}
        return from_rank_0(self.comm, partial(read_maps, self.scene.elements), InputError)

    def frames(
        self,
        particles: Particles,
        last: Frames = ONE_FRAME,
        lost: Particles | None = None,
        turn: np.ndarray | None = None,
        window: Window = AT_REST,
    ) -> Frames:
        """Return the frames in which to solve for the field of particles that move. Collective; InputError on all ranks.

        `last` are those of the step before, whose energy bins stay while they fit. Where no frame fits them, a single particle
        and the last few of which the others are `lost` keep them. `turn`: see `Frames`. `window`: where the mesh is, and so the
        walls that it leaves.
        """
        if not isinstance(self.scene.motion, Leapfrog):
            return ONE_FRAME
        return mirrored(self._frames(self.scene.motion, particles, last, lost, turn), last, self.scene, window)

    def _frames(
        self,
        motion: Leapfrog,
        particles: Particles,
        last: Frames,
        lost: Particles | None,
        turn: np.ndarray | None,
    ) -> Frames:
        bins = None if motion.energy_bins == "auto" else motion.energy_bins
        last = replace(last, turn=None if turn is None else tuple(map(vector, turn)))
        try:
            found = frames_of(self.comm, last.straight(particles), self.scene.domain.value, motion.frame, bins, last)
        except InputError:
            if particles.global_count(self.comm) > 1 and self._share_left(particles, lost) > FEW:
                raise
            self.remark(
                f"the particles that are left, one or at most {FEW:g} of the charge, have a mean momentum that fits no frame "
                "of their self-field, which is solved for as if they moved on as before"
            )
            return last
        self.say_what_is_left(found)
        return replace(found, turn=last.turn)

    def say_what_is_left(self, frames: Frames) -> None:
        """Note in how many frames the self-field is solved for and the estimated error, again where either grew by much."""
        count, error = len(frames.members), frames.error
        if (count > 1 or error > STATIC) and (count != self._told[0] or error > 2 * self._told[1]):
            self._told = (count, max(error, STATIC))
            self.note(
                f"motion.energy_bins: {count} for the self-field; the motion that they leave out makes an error of about "
                f"{error:.1%} of its force"
            )
        if error > max(LARGE, 2 * self._warned):
            self._warned = error
            motion = self.scene.motion
            chosen = isinstance(motion, Leapfrog) and (motion.frame, motion.energy_bins) != ("auto", "auto")
            if chosen and error > 2 * frames.across:
                remedy = 'set motion.frame and motion.energy_bins to "auto"'
            else:
                remedy = "momenta of the charge in its own frame make it so; codes that solve Maxwell's equations follow them"
            self.remark(
                f"the self-field is solved for in {count} frame{'s' * (count > 1)} (motion.energy_bins), and its force may be "
                f"off by about {error:.1%}; {remedy}"
            )

    def _share_left(self, particles: Particles, lost: Particles | None) -> float:
        """Return the charge of particles over that of theirs and the lost ones together, without its sign. Collective."""
        sums = [0.0 if some is None else charges(some).sum() for some in (particles, lost)]
        left, gone = self.comm.allreduce(np.array(sums))
        return float(left / (left + gone)) if gone > 0 else 1.0

    def pusher(self, frames: Frames) -> str:
        """Return how magnetic fields turn momenta of particles whose self-field is solved for in these frames.

        Boris's angle counts what E alone would change: of a beam's own E and B, which cancel up to 1/γ² of either, it leaves
        more than that.
        """
        motion = self.scene.motion
        assert isinstance(motion, Leapfrog)
        if motion.pusher == "boris" and frames.only != LABORATORY:
            self.note("motion.pusher: higuera-cary while the particles have a magnetic field of their own")
            return "higuera-cary"
        return motion.pusher

    def poisson(
        self, hierarchy: Hierarchy, frame: Frame = LABORATORY, part: bool = False, mirror: Mirror | None = None
    ) -> PoissonSolver:
        """Return the solver of a hierarchy in a frame, set up at the first call. Collective.

        That of a part of the charge leaves the mean of it out where no wall fixes φ: those of all parts cancel.
        """
        options = self.scene.solver
        if frame != LABORATORY:
            options = options.model_copy(update={"stretch": frame.stretch})
        solver = self._solvers.get((frame, part))
        if solver is not None and solver.hierarchy is hierarchy and solver.mirror == mirror:
            return solver
        kept = solver.base_setup if solver is not None and options.reuse else None
        # the old operators go before the new ones come
        solver = None
        self._solvers.pop((frame, part), None)
        self._solvers = {of: made for of, made in self._solvers.items() if made.hierarchy is hierarchy}
        self._solvers[frame, part] = PoissonSolver(
            hierarchy,
            options=options,
            background="neutralizing" if part else self._background,
            mirror=mirror,
            reuse=kept,
        )
        return self._solvers[frame, part]

    @property
    def _background(self) -> str | None:
        return None if self.scene.background == "none" else self.scene.background

    @property
    def needs_balance(self) -> bool:
        """Whether a net charge has no potential."""
        scene = self.scene
        return scene.domain.value.singular and scene.solver.screening == 0 and scene.background == "none"

    def keep_solvers(self, frames: Frames) -> None:
        """Free the solvers of other frames."""
        self._solvers = {of: made for of, made in self._solvers.items() if of[0] in frames.members}

    def solve(
        self,
        rho: Field,
        guess: Field | None,
        frame: Frame = LABORATORY,
        part: bool = False,
        last: SolveReport | None = None,
        deposited: float = 0.0,
        mirror: Mirror | None = None,
        image: bool = False,
    ) -> tuple[Field, SolveReport]:
        """Return the potential of a charge density and how the solve went. Collective; SolverError if it does not converge.

        It is that of the laboratory. What the walls hold counts in the laboratory's frame alone, and not for a `part` of the
        charge. `last`: of the solve in this frame and on this hierarchy that found the guess. `deposited`: Σ |w q|, C.
        `mirror`, `image`: see `PoissonSolver`.
        """
        at_rest = frame == LABORATORY and not part
        phi, report = self.poisson(rho.hierarchy, frame, part, mirror).solve(
            rho,
            guess=guess,
            boundary_values=self._potential if at_rest else None,
            boundary_flux=self._slope if at_rest else None,
            last=last,
            deposited=deposited,
            image=image,
        )
        self._solves.append(report)
        self._require_converged(report)
        if report.floor > 0:
            self.remark(
                f"solver.tolerance {self.scene.solver.tolerance} lies below what rounding leaves of the residual, about "
                f"{max(report.residuals[-1], report.floor):.0e}; solves stop there"
            )
        return phi, report

    def walls(self, hierarchy: Hierarchy, frames: Frames) -> tuple[Field, VectorField] | None:
        """Return φ and E of what the walls hold where a solution in these frames is without it, being of others. Collective.

        It is solved for once on each mesh, in the laboratory. Raises SolverError if its flux has no potential.
        """
        if frames.only == LABORATORY or (self._potential is None and self._slope is None):
            return None
        if self._walls is None or self._walls[0].hierarchy is not hierarchy:
            with self.clock("solve"):
                solver = PoissonSolver(hierarchy, options=self.scene.solver, background=self._background)
                try:
                    phi, report = solver.solve(Field(hierarchy), None, self._potential, self._slope)
                except SolverError as refused:
                    raise SolverError(
                        f"domain.slope, whose field is solved for apart from charge that moves: {refused}"
                    ) from None
                self._require_converged(report)
                self._walls = phi, solver.deferred_field(phi, covered=self.clouds.covered)
        return self._walls

    def take_solves(self) -> list[SolveReport]:
        """Return how the solves since the latest call went, and forget them."""
        solves, self._solves = self._solves, []
        return solves

    def _require_converged(self, report: SolveReport) -> None:
        if report.converged:
            return
        reached = report.residuals[-1] if report.residuals else float("nan")
        raise SolverError(
            f"residual {reached:.1e} after {report.cycles} cycles instead of {self.scene.solver.tolerance} "
            f"({report.reason}); {report.remedy}"
        )

    @property
    def clouds(self) -> Clouds:
        """The clouds of the particles."""
        return replace(
            self.scene.particles.clouds, kernels="kokkos" if self.scene.solver.backend == "kokkos" else "vectors"
        )

    def compensate(self, efield: VectorField, rho: Field, frame: Frame) -> None:
        """Let particles feel the field of a density, solved for in a frame, without what their clouds smooth."""
        compensate(efield, rho, self.clouds, self.scene.solver.stretch if frame == LABORATORY else frame.stretch)

    def go_without_compensation(self) -> None:
        """Note that several energy bins go without it: a remark if the scene asks for it, a note if the run chose it."""
        reason = "several energy bins, whose magnetic field it would not fit"
        if self.clouds.compensation == "none":
            return
        if self.compensation_by_auto:
            self.note(f"particles.compensation: none as long as there are {reason}")
        else:
            self.remark(
                f"particles.compensation does not act in {reason}; set motion.energy_bins to 1, or particles.compensation "
                'to "none"'
            )

    def settle_clouds(self, bunches: Sequence[Particles]) -> None:
        """Put into the scene what "auto" means for these bunches, in interface and compensation, and note it. Collective."""
        self.settle_interface(bunches)
        self.settle_compensation(bunches)

    def settle_compensation(self, bunches: Sequence[Particles]) -> None:
        """Put into the scene what `compensation = "auto"` means for these bunches, and note it. Collective."""
        scene = self.scene
        if scene.particles.compensation != "auto":
            return
        self.compensation_by_auto = True
        widths = scene.domain.value.spacing / 2**scene.refinement.levels
        shape = scene.particles.shape
        moves = isinstance(scene.motion, Leapfrog)

        def loses(number: float, sizes: np.ndarray) -> bool:
            return not compensation_pays(number, sizes, shape)

        few = [bunch for bunch in bunches if self._has(bunch, widths, loses)]
        pays = moves and not few
        self.scene = scene.with_compensation("clouds" if pays else "none")
        if moves:
            why = "every bunch has more than" if pays else "a bunch has at most"
            self.note(
                f"particles.compensation: {self.scene.particles.compensation}, because {why} {PAYING[shape]} (σ/h)² particles "
                "per cell where it is densest"
            )

    def settle_interface(self, bunches: Sequence[Particles]) -> None:
        """Put into the scene what `interface = "auto"` means for these bunches, and note it. Collective."""
        scene, levels = self.scene, self.scene.refinement.levels
        if scene.particles.interface != "auto":
            return
        widths = scene.domain.value.spacing / 2**levels
        few = levels > 0 and any(self._has(bunch, widths, matched_pays) for bunch in bunches)
        self.scene = scene.with_interface("matched" if few else "own-level")
        if levels > 0:
            why = "a bunch has at most" if few else "every bunch has more than"
            taken = self.scene.particles.interface
            self.note(f"particles.interface: {taken} clouds, because {why} {EQUAL_PARTICLES} (σ/h)² particles")

    def _has(self, bunch: Particles, widths: np.ndarray, law: Callable[[float, np.ndarray], bool]) -> bool:
        """Whether law(equal particles, rms sizes in cells of these widths (m)) holds for a bunch with charge. Collective."""
        largest = self.comm.allreduce(bunch.weight.max(initial=0.0), MPI.MAX) or 1.0
        weight = bunch.weight / largest  # so that no square underflows
        total, square = self.comm.allreduce(np.array([weight.sum(), weight @ weight]))
        size = moments(self.comm, bunch, domain=self.scene.domain.value).rms
        return bool(total > 0) and law(total**2 / square, size / widths)

    def note(self, sentence: str) -> None:
        """Note for the log what the run chose by itself, once."""
        if sentence not in self.notes:
            self.notes.append(sentence)

    def remark(self, sentence: str) -> None:
        """Note something that is legal and yet may not be meant, once."""
        if sentence not in self.remarks:
            self.remarks.append(sentence)

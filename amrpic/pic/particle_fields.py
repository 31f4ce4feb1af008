"""Fields of the particles on a mesh (ρ, φ, E, particles per cell), each made when it is first asked for."""

from __future__ import annotations

from dataclasses import replace
from functools import cached_property
from typing import Any

from ..errors import SolverError
from ..mesh.field import Field, VectorField
from ..mesh.hierarchy import Hierarchy
from ..parallel import global_sum
from ..particles.energy_bins import Frames
from ..particles.frame import LABORATORY, Frame
from ..particles.motion_of_charge import charges
from ..particles.particles import Particles
from ..stages.deposit import Deposition, deposit
from ..stages.migrate import migrate, shared_out_by_work
from ..stages.poisson import SolveReport
from ..stages.regrid import carry_over
from ..stages.tag import count
from .plan import Plan
from .solution import Part, Solution, superposed

BALANCED = 1e-10  # share of the charge by which that of both signs may differ, as in the solver


class ParticleFields:
    """Fields of particles that are sorted on a hierarchy. All ranks ask for the same ones: the first time is collective.

    Potential and field are carried over from `known`, those of the step before; without it they are solved for, in `frames`, by
    default those of the particles. `deposition`: of these particles, if it has begun. Collective to make.
    """

    def __init__(
        self,
        particles: Particles,
        hierarchy: Hierarchy,
        plan: Plan,
        known: Solution | None = None,
        frames: Frames | None = None,
        deposition: Deposition | None = None,
    ) -> None:
        self.particles, self.hierarchy, self.plan, self.known = particles, hierarchy, plan, known
        self.frames = frames if frames is not None else plan.frames(particles)
        self._deposition = deposition

    def on(self, hierarchy: Hierarchy) -> ParticleFields:
        """Return the fields of the same particles on another hierarchy. Collective."""
        with self.plan.clock("migrate"):
            particles, _ = migrate(self.particles, hierarchy, shared_out_by_work(self.particles, hierarchy))
        return ParticleFields(particles, hierarchy, self.plan, self.known, self.frames)

    @cached_property
    def rho(self) -> Field:
        """Charge density, C/m³."""
        with self.plan.clock("deposit"):
            begun, self._deposition = self._deposition, None  # its memory goes with it
            return (begun or Deposition(self.particles, self.hierarchy, self.plan.clouds)).density()

    @cached_property
    def solution(self) -> Solution:
        """What is solved for of the particles, from the potentials that are known. Collective; SolverError if a solve fails."""
        plan, frames, known = self.plan, self.frames, self.known
        plan.keep_solvers(frames)
        if frames.only != LABORATORY:
            self._require_balance()
        if (only := frames.only) is not None:
            return self._of_one_frame(only)
        plan.go_without_compensation()
        guesses = self._guesses(known, frames), self._guesses(None if known is None else known.images, frames.images)
        parts: list[Part] = []
        images: list[Part] = []
        for frame, part in zip(frames.members, frames.parts(self.particles), strict=True):
            with plan.clock("deposit"):
                rho = deposit(part, self.hierarchy, plan.clouds)
            parts.append((frame, *self._solved(rho, guesses[0][len(parts)], frame, part=True)))
            if frames.reflects(frame):
                of_images = self._solved(rho, guesses[1][len(images)], frame, part=True, image=True)
                images.append((frame.reversed, *of_images))
        with plan.clock("solve"):
            found = superposed(self.rho, parts, frames, plan.walls(self.hierarchy, frames))
            reflected = frames.images
            return found if reflected is None else replace(found, images=superposed(self.rho, images, reflected))

    def _of_one_frame(self, frame: Frame) -> Solution:
        """Return what is solved for where all charge has one frame."""
        plan, rho, known, deposited = self.plan, self.rho, self.known, self._deposited
        guess, last = self.guess, self._last_report(known, frame)
        phi, efield, report = self._solved(rho, guess, frame, last=last, deposited=deposited)
        plan.compensate(efield, rho, frame)
        images, reflected = None, self.frames.images
        if reflected is not None:
            known_images = None if known is None else known.images
            last = self._last_report(known_images, frame.reversed)
            of_images = self._solved(rho, self._guesses(known_images, reflected)[0], frame, image=True, last=last)
            images = Solution(rho, *of_images, reflected)
        before = self._before if plan.scene.extrapolates_potential else None
        walls = plan.walls(self.hierarchy, self.frames)
        return Solution(rho, phi, efield, report, self.frames, before=before, walls=walls, images=images)

    def _solved(
        self, rho: Field, guess: Field | None, frame: Frame, **of_solve: Any
    ) -> tuple[Field, VectorField, SolveReport]:
        """Return φ and E of a density that rests in a frame, or of its images, and how the solve went."""
        plan, mirror, part = self.plan, self.frames.mirror_of(frame), of_solve.get("part", False)
        with plan.clock("solve"):
            phi, report = plan.solve(rho, guess, frame, mirror=mirror, **of_solve)
            solver = plan.poisson(self.hierarchy, frame, part, mirror)
            return phi, solver.deferred_field(phi, covered=plan.clouds.covered), report

    def _guesses(self, known: Solution | None, frames: Frames | None) -> list[Field | None]:
        """Return a potential to start the solve of each part from, as far as they are known."""
        count = 0 if frames is None else len(frames.members)
        parts = () if known is None else known.parts or (known.phi,)
        return [self._carried(part) for part in parts] if len(parts) == count else [None] * count

    @cached_property
    def _deposited(self) -> float:
        """Σ |w q| in C where a net charge would have no solution, else 0. Collective."""
        return global_sum(self.plan.comm, charges(self.particles).sum()) if self.plan.needs_balance else 0.0

    def _require_balance(self) -> None:
        """Raise SolverError on all ranks if charge that is solved for apart from walls has no potential. Collective."""
        net = self.rho.integral() if self.plan.needs_balance else 0.0
        if abs(net) > BALANCED * self._deposited:
            apart = " and no domain.slope, whose field is solved for apart from charge that moves,"
            raise SolverError(
                f"all faces are periodic or Neumann, but the net charge is {net:.3g} C, which no potential"
                f"{apart if self.plan.scene.domain.slope else ''} can balance; make it zero, ask for background = "
                '"neutralizing", or give one face a potential'
            )

    @cached_property
    def phi(self) -> Field:
        """Potential, V, with that of what walls hold."""
        if self.known is None or self._before is None:
            return self.solution.potential
        return self._before if self.known.potential is self.known.phi else self._carried(self.known.potential)

    @cached_property
    def efield(self) -> VectorField:
        """Electric field, V/m, with that of what walls hold."""
        if self.known is None:
            return self.solution.electric
        x, y, z = map(self._carried, self.known.electric.components)
        return VectorField(x, y, z)

    @cached_property
    def _before(self) -> Field | None:
        """The potential of the step before that was solved for, on this mesh, V; None without one."""
        return None if self.known is None else self._carried(self.known.phi)

    @cached_property
    def particles_per_cell(self) -> Field:
        """Macroparticles in each cell, in covered cells those of their children."""
        return count(self.particles, self.hierarchy)

    @property
    def guess(self) -> Field | None:
        """A potential to start a solve from, if one is known."""
        if self.known is not None and self.known.rho.hierarchy is self.hierarchy:
            return self.known.guess
        with self.plan.clock("regrid"):
            return self._before

    def _last_report(self, known: Solution | None, frame: Frame) -> SolveReport | None:
        """Return how the solve before went, if it was of the same equations."""
        same = known is not None and known.phi.hierarchy is self.hierarchy and known.frames.only == frame
        return known.report if known is not None and same else None

    def _carried(self, field: Field) -> Field:
        if field.hierarchy is self.hierarchy:
            return field
        if field.hierarchy.domain != self.hierarchy.domain:  # of a checkpoint of another base
            return field.remap(self.hierarchy)
        return carry_over(field, self.hierarchy)

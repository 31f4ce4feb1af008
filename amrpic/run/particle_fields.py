"""Fields of the particles on a mesh (ρ, φ, E, particles per cell), each made when it is first asked for."""

from __future__ import annotations

from functools import cached_property

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
from .solution import Solution, superposed

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
        plan, frames = self.plan, self.frames
        plan.keep_solvers(frames)
        if frames.only != LABORATORY:
            self._require_balance()
        if (only := frames.only) is not None:
            rho, guess = self.rho, self.guess
            with plan.clock("solve"):
                phi, report = plan.solve(rho, guess, only, last=self._last_report(only), deposited=self._deposited)
                efield = plan.poisson(self.hierarchy, only).deferred_field(phi, covered=plan.clouds.covered)
                plan.compensate(efield, rho, only)
            before = self._before if plan.scene.extrapolates_potential else None
            return Solution(rho, phi, efield, report, frames, before=before, walls=plan.walls(self.hierarchy, frames))
        plan.go_without_compensation()
        known = self.known.parts if self.known is not None else ()
        guesses = [self._carried(part) for part in known] if len(known) == len(frames.members) else None
        parts = []
        for number, (frame, part) in enumerate(zip(frames.members, frames.parts(self.particles), strict=True)):
            with plan.clock("deposit"):
                rho = deposit(part, self.hierarchy, plan.clouds)
            with plan.clock("solve"):
                phi, report = plan.solve(rho, guesses[number] if guesses else None, frame, part=True)
                efield = plan.poisson(self.hierarchy, frame, part=True).deferred_field(phi, covered=plan.clouds.covered)
            parts.append((frame, phi, efield, report))
        with plan.clock("solve"):
            return superposed(self.rho, parts, frames, plan.walls(self.hierarchy, frames))

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
        return self._before if self.known.walls is None else self._carried(self.known.potential)

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

    def _last_report(self, frame: Frame) -> SolveReport | None:
        """Return how the solve before went, if it was of the same equations."""
        known = self.known
        same = known is not None and known.phi.hierarchy is self.hierarchy and known.frames.only == frame
        return known.report if known is not None and same else None

    def _carried(self, field: Field) -> Field:
        if field.hierarchy is self.hierarchy:
            return field
        if field.hierarchy.domain != self.hierarchy.domain:  # of a checkpoint of another base
            return field.remap(self.hierarchy)
        return carry_over(field, self.hierarchy)

"""The self-field of particles on a mesh: one solve for each frame, and one for the images of its charge."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

from ..errors import SolverError
from ..mesh.field import Field, VectorField
from ..mesh.hierarchy import Hierarchy
from ..parallel import global_sum
from ..particles.energy_bins import Frames
from ..particles.frame import LABORATORY, Frame
from ..particles.motion_of_charge import charges
from ..particles.particles import Particles
from ..space_charge.self_field import self_field
from ..stages.deposit import deposit
from ..stages.poisson import SolveReport
from ..stages.regrid import carry_over
from .meshed import MeshedParticles
from .setup import Setup
from .solution import Part, Solution, superposed

BALANCED = 1e-10  # share of the charge by which that of both signs may differ, as in the solver


def solve(beam: MeshedParticles, rho: Field, last: Solution | None, setup: Setup) -> Solution:
    """Return the self-field of particles with charge density ρ, unless a rule has asked for it already. Collective.

    Solves start from the `last` solution. Raises SolverError on all ranks if one does not converge.
    """
    if beam.solution is not None:
        return beam.solution
    setup.solvers.keep(beam.frames)
    setup.solvers.drive = beam.drive
    # Σ |w q|, C, where a net charge would have no solution
    deposited = global_sum(setup.comm, charges(beam.particles).sum()) if setup.needs_balance else 0.0
    if beam.frames.only != LABORATORY:
        _require_balance(rho, deposited, setup)
    if beam.frames.only is not None:
        solution = _in_one_frame(beam.frames.only, beam, rho, last, deposited, setup)
    else:
        solution = _in_many_frames(beam, rho, last, setup)
    return with_layers(solution, beam.particles, setup)


def with_layers(solution: Solution, particles: Particles, setup: Setup) -> Solution:
    """Return a solution of particles with the layers at walls that emit. Collective."""
    if not setup.emitting_walls:
        return solution
    with setup.clock("solve"):
        return replace(solution, layers=setup.emitting_walls.layers(solution, particles))


def _in_one_frame(
    frame: Frame, beam: MeshedParticles, rho: Field, last: Solution | None, deposited: float, setup: Setup
) -> Solution:
    """Return the field where all charge has one frame."""
    hierarchy, frames = beam.hierarchy, beam.frames
    before = None if last is None else carried(last.phi, hierarchy, setup)
    guess = last.guess if last is not None and last.rho.hierarchy is hierarchy else before
    report_before = _last_report(last, frame, hierarchy)
    phi, efield, report = _solved(rho, guess, frame, frames, setup, last=report_before, deposited=deposited)
    images, reflected = None, frames.images
    if reflected is not None:
        last_images = None if last is None else last.images
        report_before = _last_report(last_images, frame.reversed, hierarchy)
        guess = _guesses(last_images, reflected, hierarchy, setup)[0]
        images = Solution(rho, *_solved(rho, guess, frame, frames, setup, image=True, last=report_before), reflected)
    with setup.clock("solve"):
        walls = setup.solvers.walls(hierarchy, frames, setup.clouds.covered)
    previous = before if setup.scene.extrapolates_potential else None
    return Solution(rho, phi, efield, report, frames, before=previous, walls=walls, images=images)


def _in_many_frames(beam: MeshedParticles, rho: Field, last: Solution | None, setup: Setup) -> Solution:
    """Return the sum of the fields of several parts of the charge, each solved for in its frame."""
    hierarchy, frames = beam.hierarchy, beam.frames
    go_without_compensation(setup)
    guesses = _guesses(last, frames, hierarchy, setup)
    guesses_of_images = _guesses(None if last is None else last.images, frames.images, hierarchy, setup)
    parts: list[Part] = []
    images: list[Part] = []
    for frame, part in zip(frames.members, frames.parts(beam.particles), strict=True):
        with setup.clock("deposit"):
            density = deposit(part, hierarchy, setup.clouds)
        parts.append((frame, *_solved(density, guesses[len(parts)], frame, frames, setup, part=True)))
        if frames.reflects(frame):
            guess = guesses_of_images[len(images)]
            images.append((frame.reversed, *_solved(density, guess, frame, frames, setup, part=True, image=True)))
    with setup.clock("solve"):
        solution = superposed(rho, parts, frames, setup.solvers.walls(hierarchy, frames, setup.clouds.covered))
        reflected = frames.images
        return solution if reflected is None else replace(solution, images=superposed(rho, images, reflected))


def _solved(
    rho: Field, guess: Field | None, frame: Frame, frames: Frames, setup: Setup, **of_solve: Any
) -> tuple[Field, VectorField, SolveReport]:
    """Return φ and E of a density that rests in a frame, or of its images, and how the solve went."""
    with setup.clock("solve"):
        return self_field(setup.solvers, rho, guess, setup.clouds, frame, mirror=frames.mirror_of(frame), **of_solve)


def go_without_compensation(setup: Setup) -> None:
    """Note that several energy bins go without it: a remark if the scene asks for it, a note if the run chose it."""
    reason = "several energy bins, whose magnetic field it would not fit"
    if setup.clouds.compensation == "none":
        return
    if setup.compensation_by_auto:
        setup.remarks.note(f"particles.compensation: none as long as there are {reason}")
    else:
        setup.remarks.remark(
            f"particles.compensation does not act in {reason}; set motion.energy_bins to 1, or particles.compensation "
            'to "none"'
        )


# ---- what solves start from ----


def carried(field: Field, hierarchy: Hierarchy, setup: Setup) -> Field:
    """Return a field of the step before on the mesh of this one. Collective where that is another."""
    if field.hierarchy is hierarchy:
        return field
    with setup.clock("regrid"):
        if field.hierarchy.domain != hierarchy.domain:  # of a checkpoint of another base
            return field.remap(hierarchy)
        return carry_over(field, hierarchy)


def _guesses(last: Solution | None, frames: Frames | None, hierarchy: Hierarchy, setup: Setup) -> list[Field | None]:
    """Return a potential to start the solve of each part from, as far as they are known."""
    count = 0 if frames is None else len(frames.members)
    parts = () if last is None else last.parts or (last.phi,)
    return [carried(part, hierarchy, setup) for part in parts] if len(parts) == count else [None] * count


def _last_report(last: Solution | None, frame: Frame, hierarchy: Hierarchy) -> SolveReport | None:
    """Return how the solve before went, if it was of the same equations."""
    return last.report if last is not None and last.phi.hierarchy is hierarchy and last.frames.only == frame else None


def _require_balance(rho: Field, deposited: float, setup: Setup) -> None:
    """Raise SolverError on all ranks if charge that is solved for apart from walls has no potential. Collective."""
    net = rho.integral() if setup.needs_balance else 0.0
    if abs(net) > BALANCED * deposited:
        also = " and no domain.slope, whose field is solved for apart from charge that moves,"
        raise SolverError(
            f"all faces are periodic or Neumann, but the net charge is {net:.3g} C, which no potential"
            f"{also if setup.scene.domain.slope else ''} can balance; make it zero, ask for background = "
            '"neutralizing", or give one face a potential'
        )

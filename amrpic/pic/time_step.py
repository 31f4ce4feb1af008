"""How long a time step may be: what goes on in a run, the time that it takes, and how many steps that wants."""

from __future__ import annotations

import itertools
import math
import sys
from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np

from ..errors import InputError
from ..external import fields_between, slopes
from ..mesh.domain import AXES
from ..mesh.hierarchy import Hierarchy
from ..mesh.window import axes
from ..mpi import MPI
from ..parallel import from_rank_0
from ..particles.clouds import Clouds
from ..particles.energy_bins import Frames
from ..particles.frame import Frame
from ..particles.particles import Particles
from ..scene.electrodes import Electrode
from ..scene.elements import SolenoidElement
from ..scene.motion import Leapfrog
from ..scene.sources import GivenSource
from ..stages.deposit import deposit
from ..stages.push import IN_CACHE
from ..units import SPEED_OF_LIGHT, VACUUM_PERMITTIVITY, falls_short
from .course import Course
from .element_strengths import Strength, strength
from .leapfrog import felt
from .meshed import MeshedParticles
from .setup import Setup
from .solution import Solution
from .state import State

# Steps per time: what "auto" takes, and what a step that is given should not fall below.
PER_CELL, LEAST_PER_CELL = 2.0, 1.0
PER_PLASMA_PERIOD, LEAST_PER_PLASMA_PERIOD = 60.0, 2 * math.pi / 0.5
# Momenta that change by a part a of m c in a step, in the beam's frame, have an error of a² / 24 of the change.
PER_GAIN, LEAST_PER_GAIN = 40.0, 4.0
# So many that passages through elements are exact to 1e-5: docs/reports/verification.md.
PER_PERIOD, LEAST_PER_PERIOD = 1000.0, 20.0
PER_RF_PERIOD = 640.0
# How fast voltages swing is looked at in so many steps, at so many times, by what changes in this part of all of it.
SWING, LOOKS, INSTANT = 2000.0, 1000, 1e-10
PER_LENGTH, LEAST_PER_LENGTH = 80.0, 4.0  # four places sum up the profile of a gap, a fringe or a coil to 0.5 %
PER_NODE, LEAST_PER_NODE = 1.0, 0.25
# One step per cell at the anode is enough for the current of a diode: docs/emission.md.
PER_PASSAGE, LEAST_PER_PASSAGE = 1.5, 0.9
PER_PULSE, LEAST_PER_PULSE = 50.0, 5.0


EVERY = 100  # steps from one look at whether the step has become long to the next
# Where steps grow: steps from one look at how long they may be to the next, and how many are enough for any process, to 1e-4.
EVERY_GROWTH, PER_GROWN = 10, 100.0


@dataclass(frozen=True)
class Process:
    """Something that steps have to resolve."""

    kind: str  # of those of one kind, a remark is on the fastest
    what: str
    time: float  # s, that it takes
    steps: float  # in this time, with "auto"
    least: float = 0.0  # fewer get a remark


@dataclass(frozen=True)
class Fastest:
    """The largest values over all particles, of a charge q and mass m with velocity v."""

    along: np.ndarray  # (3,) |v| along the axes of the mesh, relative to it, m/s
    speed: float  # |v| in the laboratory, m/s
    charge_per_mass: float  # |q| / (γ m), C/kg
    current_per_mass: float  # |q v| / (γ m), C m/(kg s)


def with_time_step(setup: Setup, beam: MeshedParticles, solution: Solution | None, course: Course) -> Setup:
    """Return the set-up with its time step, chosen where the scene leaves that to the run and it is not known yet.

    A note says which rule it follows from, and a remark of a step that the scene gives if it is long. Without a `solution` the
    self-field does not count. Collective; InputError on all ranks if nothing in the run has a time of its own.
    """
    motion = setup.scene.motion
    if not motion.follows_fields:
        return setup
    all_ = processes(beam, solution, setup, course)
    if motion.dt != "auto":
        _remark(setup, motion.dt, all_, 'shorten it, or set it to "auto"')
    return replace(setup, dt=_longest_step(all_, setup)) if math.isnan(setup.dt) else setup


def _longest_step(all_: list[Process], setup: Setup) -> float:
    """Return the longest time step, s, that resolves all processes, and note which of them asks for it."""
    scene = setup.scene
    if not all_:
        raise InputError(
            f'{scene.name}: motion.dt is "auto", but no particle moves, has charge or feels an element; give a time'
        )
    first = min(all_, key=lambda process: process.time / process.steps)
    dt = first.time / first.steps
    if not dt > 0:
        raise InputError(
            f'{scene.name}: motion.dt is "auto", and the {first.what} is {first.time:g} s; correct the strength of '
            "that, or give a time"
        )
    setup.remarks.note(f"motion.dt: {dt:.4g} s, {first.steps:g} steps per {first.what}")
    return dt


def next_step(
    state: State, beam: MeshedParticles, solution: Solution, course: Course, setup: Setup
) -> tuple[float, float]:
    """Return how long the step after the next state is, and may be as was looked at last, s. Collective.

    It grows with the time that the fastest of all processes takes, and is never shorter than the first one.
    """
    motion = setup.scene.motion
    if not isinstance(motion, Leapfrog) or motion.growth == 0:
        return setup.dt, setup.dt
    longest = state.longest
    if (state.step + 1) % EVERY_GROWTH == 0:
        time = state.time + state.staggered.flight
        ahead = _ahead(state, course, time, setup)
        all_ = processes(beam, solution, setup, course, time, ahead, state.staggered.dt)
        of_all = min((process.time / min(process.steps, PER_GROWN) for process in all_), default=math.inf)
        longest = min(max(of_all, setup.dt), motion.longest or math.inf)
    return min(longest, state.staggered.dt * (1 + motion.growth)), longest


def _ahead(state: State, course: Course, time: float, setup: Setup) -> float:
    """Return how far particles may fly until steps are looked at again, m: anywhere where elements repeat with space, or
    sources are still at work."""
    repeats = course.goes == "nowhere" and any(setup.scene.domain.value.periodic)
    if repeats or any(emitter.stop_time > time for emitter in setup.emitters):
        return math.inf
    return SPEED_OF_LIGHT * EVERY_GROWTH * state.staggered.dt * (1 + setup.scene.motion.growth) ** EVERY_GROWTH


def check_time_step(beam: MeshedParticles, solution: Solution, step: int, dt: float, setup: Setup) -> None:
    """Remark if the time step has become long for charge or field at a later step, once for each kind. Collective."""
    if setup.scene.motion.follows_fields and step % EVERY == 0:
        remedy = "go on from an earlier checkpoint with a shorter one"
        _remark(setup, dt, processes(beam, solution, setup, dt=dt), remedy, f" at step {step}")


def _remark(setup: Setup, dt: float, all_: list[Process], remedy: str, when: str = "") -> None:
    for kind in dict.fromkeys(process.kind for process in all_):
        same = (process for process in all_ if process.kind == kind)
        worst = max(same, key=lambda process: process.least / process.time if process.time > 0 else math.inf)
        if falls_short(worst.time / dt, worst.least):
            setup.remarks.remark(
                f"motion.dt of {dt:.4g} s is long{when}: {worst.time / dt:.3g} steps per {worst.what}, where at "
                f"least {worst.least:.3g} are advisable; {remedy}",
                f"motion.dt, {kind}",
            )


def processes(
    beam: MeshedParticles,
    solution: Solution | None,
    setup: Setup,
    course: Course | None = None,
    time: float = -math.inf,
    ahead: float = math.inf,
    dt: float = math.nan,
) -> list[Process]:
    """Return what goes on in a run and takes a time: what charge and own field do, voltages that vary, and with a course
    motion, elements that a particle meets within `ahead` m, and sources that have not ended at a time, s. Collective.

    Voltages are looked at over many steps of about `dt` s, by default what all else asks for. Fields from Python are not
    looked at.
    """
    fast = None if course is None else fastest(setup.comm, beam.particles, course)
    all_ = itertools.chain(
        _of_motion(setup, fast) if fast else (),
        _of_charge(beam, solution, setup),
        _of_elements(setup, fast, _away(setup, beam.particles, course, ahead)) if fast and course else (),
        _of_sources(solution, setup, time) if fast and solution and setup.emitters else (),
    )
    out = [process for process in all_ if process.time < math.inf]
    if math.isnan(dt):
        dt = (
            min((process.time / process.steps for process in out), default=math.inf)
            if math.isnan(setup.dt)
            else setup.dt
        )
    return out + [process for process in _of_voltages(beam, dt) if process.time < math.inf]


def _of_voltages(beam: MeshedParticles, dt: float) -> Iterator[Process]:
    """Yield how fast the voltages of electrodes swing in the next steps of about dt, s."""
    for electrode in beam.drive.electrodes:
        if electrode.varies and 0 < dt < math.inf:
            time = swing(electrode, beam.drive.time, SWING * dt)
            yield Process("voltage", f"swing of the voltage of {electrode.name}", time, PER_RF_PERIOD, LEAST_PER_PERIOD)


def _of_motion(setup: Setup, fast: Fastest) -> Iterator[Process]:
    widths = setup.scene.domain.value.spacing / 2**setup.scene.refinement.levels
    for axis, width, speed in zip(AXES, widths, fast.along, strict=True):
        process = f"passage of a particle through a cell of the finest level along {axis}"
        yield Process("cell", process, _time(width, speed), PER_CELL, LEAST_PER_CELL)


def _of_charge(beam: MeshedParticles, solution: Solution | None, setup: Setup) -> Iterator[Process]:
    clouds, hierarchy = setup.clouds, beam.hierarchy
    particles, frames = beam.frames.straight(beam.particles), replace(beam.frames, turn=None)
    of_all, single = (law(particles, hierarchy, clouds, frames) for law in (plasma_frequency, oscillation))
    process = "plasma period" if single < 1.1 * of_all else "oscillation of a particle in the charge of all"
    period = _time(2 * math.pi, max(of_all, single))
    yield Process("plasma", process, period, PER_PLASMA_PERIOD, LEAST_PER_PLASMA_PERIOD)
    if solution is not None:
        gain, across = own_changes(particles, solution, clouds)
        for process, rate in (("gain of γ m c", gain), ("gain of m c across the motion", across)):
            process += " in the particles' own field"
            yield Process("own", process, _time(1.0, rate), PER_GAIN, LEAST_PER_GAIN)


def _of_elements(setup: Setup, fast: Fastest, away: list[float]) -> Iterator[Process]:
    """Yield what happens in elements so far away, m: nothing, but that the field of a thin coil changes over the distance."""
    of_all = zip(setup.external.elements, _strengths(setup), away, strict=True)
    for number, (element, of, far) in enumerate(of_all):
        if far == 0 or (isinstance(element, SolenoidElement) and element.radius is not None):
            near = replace(of, length=max(of.length, far))
            yield from _processes_in(near, element.name or f"elements.{number}", fast)


def _strengths(setup: Setup) -> list[Strength]:
    """Return how strong the elements are, of which rank 0 reads the maps. Collective; InputError on all ranks."""
    return from_rank_0(setup.comm, lambda: [strength(element) for element in setup.external.elements], InputError)


def _away(setup: Setup, particles: Particles, course: Course, ahead: float) -> list[float]:
    """Return how far, in m, all particles stay from each element in the next `ahead` m of their way. Collective."""
    elements = setup.external.elements
    if math.isinf(ahead):
        return [0.0] * len(elements)
    between = from_rank_0(setup.comm, lambda: fields_between(elements), InputError)  # reads maps
    places, unlimited = course.window.places(particles.position), sys.float_info.max
    out = np.zeros((len(elements), 2))
    for far, element, (first, last) in zip(out, elements, between, strict=True):
        x, _, z = ((places - element.centre) @ np.array(axes(element.direction, element.roll)).T).T
        rise = np.abs(slopes(element)).max() * np.abs(x).max(initial=0.0)
        far[:] = z.min(initial=unlimited) - last - rise, first - rise - z.max(initial=-unlimited)
    setup.comm.Allreduce(MPI.IN_PLACE, out, MPI.MIN)
    return np.maximum(out.max(axis=1, initial=0.0) - ahead, 0.0).tolist()


def _of_sources(solution: Solution, setup: Setup, time: float) -> Iterator[Process]:
    """Yield what particles do that are not born yet: pass a cell after a fall through all of the potential, and fly from rest
    through the first cell; and the pulse that they come in. Collective."""
    drop = solution.potential.max() - solution.potential.min()
    drop += sum(of.electric * of.length for of in _strengths(setup) if math.isfinite(of.length))
    spacing, levels = setup.scene.domain.value.spacing, setup.scene.refinement.levels
    for emitter, name in zip(setup.emitters, setup.scene.source_names, strict=True):
        if emitter.stop_time <= time:
            continue
        source, face = emitter.source, emitter.source.face_number
        energy, mass = abs(source.species.charge) * drop + emitter.largest_energy(), source.species.mass
        gamma = 1 + energy / (mass * SPEED_OF_LIGHT**2)
        width = float(spacing.min() if face is None else spacing[face // 2])
        passage = _time(width, SPEED_OF_LIGHT * math.sqrt(1 - 1 / gamma**2))
        yield Process(
            "source",
            f"passage of the fastest particle of {name} through a base cell",
            passage,
            PER_PASSAGE,
            LEAST_PER_PASSAGE,
        )
        if layer := solution.layers.get(-1 if source.surface is None else source.surface):
            pull = abs(source.species.charge) / mass * np.abs(layer.at_wall).max(initial=0.0)
            first = math.sqrt(_time(2 * width / 2**levels, pull))
            yield Process(
                "source", f"flight from {name} through the first cell of the finest level", first, PER_PASSAGE
            )
        if isinstance(source, GivenSource):
            yield Process("pulse", f"pulse of {name}", source.pulse.duration, PER_PULSE, LEAST_PER_PULSE)


def _processes_in(of: Strength, name: str, fast: Fastest) -> Iterator[Process]:
    for process, omega in (("betatron", betatron(of, fast)), ("cyclotron", cyclotron(of, fast))):
        period = _time(2 * math.pi, omega)
        yield Process("element", f"{process} period in {name}", period, PER_PERIOD, LEAST_PER_PERIOD)
    yield Process("element", f"gain of γ m c in {name}", _time(1.0, acceleration(of, fast)), PER_PERIOD, LEAST_PER_GAIN)
    yield Process("rf", f"RF period of {name}", _time(1.0, of.frequency), PER_RF_PERIOD, LEAST_PER_PERIOD)
    least = LEAST_PER_LENGTH if of.smooth else 0.0
    yield Process("length", f"passage through {name} or its fringe", _time(of.length, fast.speed), PER_LENGTH, least)
    yield Process("node", f"passage between nodes of {name}", _time(of.node, fast.speed), PER_NODE, LEAST_PER_NODE)


def _time(amount: float, rate: float) -> float:
    return amount / rate if rate > 0 else math.inf


# ---- formulas ----


def swing(electrode: Electrode, start: float, span: float) -> float:
    """Return in which time, s, a voltage swings once: the period of one that oscillates, however fast; long beside the span of
    time from `start`, s, if it changes evenly or jumps."""
    # the median of |V'| is ω A / √2, the range 2 A; random times see all phases
    time = start + span * np.random.default_rng(0).random(LOOKS)
    later = time + INSTANT * span
    volts = electrode.voltages_at(time)
    rate = np.median(abs((electrode.voltages_at(later) - volts) / (later - time)))
    return _time(math.pi / math.sqrt(2) * float(np.ptp(volts)), float(rate))


def betatron(of: Strength, fast: Fastest) -> float:
    """Return the angular frequency in 1/s of oscillations in linear fields: ω² = |q| (v G + g) / (γ m), G of B and g of E."""
    return math.sqrt(fast.current_per_mass * of.magnetic_gradient + fast.charge_per_mass * of.electric_gradient)


def cyclotron(of: Strength, fast: Fastest) -> float:
    """Return the angular frequency in 1/s of the turn in a magnetic field: ω = |q| B / (γ m)."""
    return fast.charge_per_mass * of.magnetic


def acceleration(of: Strength, fast: Fastest) -> float:
    """Return at which rate (1/s) an electric field changes momenta, relative to γ m c: |q| E / (γ m c)."""
    return fast.charge_per_mass * of.electric / SPEED_OF_LIGHT


def plasma_frequency(particles: Particles, hierarchy: Hierarchy, clouds: Clouds, frames: Frames) -> float:
    """Return the largest angular plasma frequency on the mesh in 1/s: ω² = Σ s q² n / (ε0 m), over all particles, each with
    its `stiffness` s in the charge of its energy bin: 1/γ³ if it goes along. Along the motion the mass is γ³ m. Collective.
    """
    parts = zip(frames.members, frames.parts(particles), strict=True)
    weight = sum(part.weight * stiffness(particles, frame) for frame, part in parts)
    table = particles.species
    kinds = tuple(replace(kind, charge=kind.charge**2 / kind.mass) for kind in table.kinds)
    weighed = replace(particles.with_weight(np.asarray(weight)), species=replace(table, kinds=kinds))
    density = deposit(weighed, hierarchy, clouds).max_abs()  # C²/(kg m³)
    return math.sqrt(density / VACUUM_PERMITTIVITY)


def oscillation(particles: Particles, hierarchy: Hierarchy, clouds: Clouds, frames: Frames) -> float:
    """Return the largest angular frequency of a particle in the charge of all, in 1/s, which may be much lighter or slower
    than most: ω² = |q| / (ε0 m) Σ |ρ| s over energy bins, with the stiffness s of the particle in each. Collective.
    """
    square = np.zeros(len(particles))
    for frame, part in zip(frames.members, frames.parts(particles), strict=True):
        square += stiffness(particles, frame) * deposit(part, hierarchy, clouds).max_abs()
    square *= np.abs(particles.charge) / (particles.mass * VACUUM_PERMITTIVITY)
    return math.sqrt(hierarchy.comm.allreduce(square.max(initial=0.0), MPI.MAX))


def stiffness(particles: Particles, frame: Frame) -> np.ndarray:
    """Return (1 - v·V/c²) / γ (n,) of particles with velocities v in charge that moves with V: 1/γ³ for those that go along.

    Of the electric force across V its magnetic field leaves the first factor, for a mass γ m.
    """
    per_mc = 1 / (particles.mass * SPEED_OF_LIGHT)
    gamma_square = 1 + sum(np.square(particles.momentum[:, axis] * per_mc) for axis in range(3))
    # γ of the particle in the frame
    relative = np.sqrt(gamma_square) * frame.gamma - particles.momentum[:, frame.axis] * per_mc * frame.momentum
    return np.maximum(relative, 1.0) / (gamma_square * frame.gamma)


def own_changes(particles: Particles, solution: Solution, clouds: Clouds) -> tuple[float, float]:
    """Return at which rates (1/s) the particles' own field changes their momenta, at most. Collective.

    Relative to γ m c: |q (E + v × B)| / (γ m c), where E and v × B nearly cancel in a fast beam. And how fast v × B, and so
    the force, follows such changes: |q| √(B²/γ² + (v·B/c)²) / (γ m), which is the gain of m c where E and v × B cancel.
    """
    electric, magnetic = felt(solution, particles, clouds)
    most = np.zeros(2)
    for first in range(0, len(particles), IN_CACHE):
        chunk = slice(first, first + IN_CACHE)
        mass, b = particles.mass[chunk], magnetic[chunk]
        u = particles.momentum[chunk] / (mass * SPEED_OF_LIGHT)[:, None]
        gamma = np.sqrt(1 + (u**2).sum(axis=1))
        beta = u / gamma[:, None]
        force = np.linalg.norm(electric[chunk] / SPEED_OF_LIGHT + np.cross(beta, b), axis=1)
        turn = np.hypot(np.linalg.norm(b, axis=1) / gamma, (beta * b).sum(axis=1))
        per_mass = np.abs(particles.charge[chunk]) / (mass * gamma)
        most = np.maximum(most, [(per_mass * force).max(), (per_mass * turn).max()])
    solution.rho.comm.Allreduce(MPI.IN_PLACE, most, MPI.MAX)
    gain, across = most.tolist()
    return gain, across


def fastest(comm: MPI.Comm, particles: Particles, course: Course) -> Fastest:
    """Return the largest velocities, and what makes a particle turn most. Collective."""
    per_mc = 1 / (particles.mass * SPEED_OF_LIGHT)
    u_square = sum(np.square(particles.momentum[:, axis] * per_mc) for axis in range(3))
    per_gamma = 1 / np.sqrt(1 + u_square)
    speed = SPEED_OF_LIGHT * np.sqrt(u_square) * per_gamma
    turns = np.abs(particles.charge) / particles.mass * per_gamma
    per_mass = per_gamma / particles.mass
    along = [
        np.abs(particles.momentum[:, axis] * per_mass - velocity).max(initial=0.0)
        for axis, velocity in enumerate(course.velocity)
    ]
    own = np.array([*along, *(values.max(initial=0.0) for values in (speed, turns, turns * speed))])
    most = np.empty_like(own)
    comm.Allreduce(own, most, MPI.MAX)
    return Fastest(most[:3], *most[3:].tolist())

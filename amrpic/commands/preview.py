"""amrpic preview: mesh, bunches, memory, time and pictures of a scene, and what may not be meant."""

from __future__ import annotations

import argparse
import itertools
import math
import time
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from ..errors import AmrpicError
from ..io import vtkhdf_writer
from ..io.field_reader import LiveDump
from ..io.provenance import Moment, about
from ..io.writer_ranks import writers_of
from ..mesh.domain import AXES
from ..mesh.field import Field
from ..mesh.hierarchy import Hierarchy
from ..mesh.window import Window
from ..mpi import MPI
from ..particles.particles import Particles, concatenate
from ..pic.adapt import follow, make_base
from ..pic.course import Course
from ..pic.cut_metal import cut_cells, describe
from ..pic.forecast import forecast
from ..pic.frames import first_frames
from ..pic.initial_particles import make_bunches, start_of
from ..pic.memory import run_memory
from ..pic.meshed import MeshedParticles, deposit
from ..pic.setup import Setup, resolved, set_up
from ..pic.time_step import with_time_step
from ..progress import progress
from ..run.folder import prepare
from ..run.machine import MIB, machine_memory
from ..scene.refinement_rules import (
    CallableRule,
    ChargeDensityRule,
    FieldStrengthRule,
    PotentialRule,
    RuleCombination,
    RuleKind,
)
from ..scene.scene import Scene
from ..space_charge.drive import Drive
from ..stages.diagnostics import moments
from ..stages.migrate import migrate
from ..stages.push import random_walk
from ..stages.tag import count as number_per_cell
from ..stages.tag import living
from ..tables import columns
from ..units import quantity
from ..view.draw import draw
from ..view.views import View
from .arguments import Commands, command, count, scene_arguments, scene_on_all_ranks, seconds
from .preview_warnings import warnings_of

FILE = "preview.vtkhdf"
IN_PLACE = 1e-3  # relative density that stands for rules that ask for the field: as by default
FORESEEN = 1000  # steps of a random walk that are gone through for its last mesh


def preview(comm: MPI.Comm, scene: Scene, ranks: int, seconds: float = 0.0) -> str:
    """Return the text of a preview; pictures go into the folder of the scene's run. Collective.

    `ranks` are those that the run is meant for. In about so many `seconds` it is tried out how long it will take; with 0
    nothing is solved. Raises what making particles and mesh may raise, and OutputError.
    """
    prepare(comm, scene)
    setup, notes = _setup_without_solves(comm, scene)
    base, course = make_base(setup.comm, scene), Course.of_scene(scene, setup.emitters)
    begun = time.perf_counter()
    with progress("making particles"):
        bunches = [bunch.seen_from(course.window) for bunch in make_bunches(comm, scene)]
    made_in = comm.allreduce(time.perf_counter() - begun, op=MPI.MAX)
    start, of_start = start_of(comm, scene)
    notes += of_start
    setup = resolved(setup, bunches)
    particles, outside = migrate(concatenate(bunches), base)
    drive = Drive.of(setup.electrodes, start, course.window, {})
    beam = follow(MeshedParticles(particles, base, first_frames(particles, setup), drive=drive), None, setup)
    lost = outside.global_count(comm)
    count = beam.particles.global_count(comm) + lost
    if lost:
        notes.append(f"{lost} of {count} particles lie outside the domain and would be lost")
    known, unknown = _births(setup, start)
    born = sum(known)
    notes += [f"sources give {born} particles of given charge until the last step"] if known else []
    notes += [f"what {', '.join(unknown)} gives is known in the run alone, and not counted"] if unknown else []
    if scene.motion.dt == "auto" and scene.sources:
        notes.append("motion.dt is chosen once the first field is known, which decides on particles of sources")
    else:
        with_time_step(setup, beam, None, course)
    if scene.motion.dt == "auto":
        notes.append("the particles' own field, which a preview does not solve for, may ask for a shorter motion.dt")
    particles_per_cell = number_per_cell(beam.particles, beam.hierarchy)
    notes += warnings_of(scene, particles_per_cell, bunches[1:])
    paragraphs = [
        [scene.summary()],
        _levels(particles_per_cell),
        _bunches(comm, scene, bunches[1:], beam.hierarchy),
        describe(setup.electrodes, beam.hierarchy),
        _memory(beam, count + born, ranks, setup),
        _time(comm, scene, beam.hierarchy, ranks, made_in, seconds) if seconds > 0 else [],
        [f"note: {note}" for note in [*scene.remarks(), *setup.remarks.warnings, *setup.remarks.notes, *notes]],
        list(map(str, _pictures(scene, deposit(beam, setup), start, course.window))),
    ]
    return "\n\n".join("\n".join(lines) for lines in paragraphs if lines)


def _setup_without_solves(comm: MPI.Comm, scene: Scene) -> tuple[Setup, list[str]]:
    """Return the set-up of a scene whose rule asks for nothing that must be solved for, and what was changed for that."""
    kinds: list[str] = []
    rule = _without_field(scene.refinement.rule, kinds)
    if not kinds:
        return set_up(comm, scene), []
    refinement = scene.refinement.model_copy(update={"rule": rule})
    note = (
        f"refinement.rule asks for the field ({', '.join(kinds)}), which a preview does not solve for; in its place cells "
        f"are refined by charge-density, relative = {IN_PLACE:g}"
    )
    return set_up(comm, scene.model_copy(update={"refinement": refinement})), [note]


def _without_field(rule: RuleKind, kinds: list[str]) -> RuleKind:
    """Return a rule with charge density in place of what needs a solve; `kinds` grows by the kinds of these."""
    match rule:
        case RuleCombination():
            return rule.model_copy(update={"of": [_without_field(part, kinds) for part in rule.of]})
        case PotentialRule() | FieldStrengthRule():
            pass
        case CallableRule() if {"phi", "efield"} & set(rule.arguments):
            pass
        case _:
            return rule
    kinds.append(rule.kind)
    return ChargeDensityRule(relative=IN_PLACE, levels=rule.levels)


# ---- tables ----

LEVELS = ("level", "boxes", "cells", "cell width", "particles", "mean in a cell", "median", "most")


def _levels(particles_per_cell: Field) -> list[str]:
    """Return the table of levels; mean, median and most are over the cells that hold particles. Collective."""
    hierarchy = particles_per_cell.hierarchy
    rows: list[Sequence[object]] = [LEVELS]
    for level, numbers in enumerate(living(particles_per_cell)):
        total, mean, median, most = statistics(hierarchy.comm, numbers[numbers > 0].astype(np.int64))
        boxes, cells = len(hierarchy.boxes(level)), hierarchy.cells(level)
        rows.append([level, boxes, cells, hierarchy.width_text(level), total, f"{mean:.3g}", median, most])
    return columns(rows)


def statistics(comm: MPI.Comm, numbers: np.ndarray) -> tuple[int, float, int, int]:
    """Return sum, mean, lower median and largest of the whole numbers of all ranks, zeros of none. Collective."""
    parts = comm.allgather(np.unique(numbers, return_counts=True))
    values, place = np.unique(np.concatenate([part for part, _ in parts]), return_inverse=True)
    if len(values) == 0:
        return 0, 0.0, 0, 0
    below = np.cumsum(np.bincount(place, np.concatenate([times for _, times in parts])).astype(np.int64))
    total = int(values @ np.diff(below, prepend=0))
    return total, total / below[-1], int(values[np.searchsorted(below, (below[-1] + 1) // 2)]), int(values[-1])


def _bunches(comm: MPI.Comm, scene: Scene, particles: Sequence[Particles], hierarchy: Hierarchy) -> list[str]:
    """Return the table of bunches, with their size over the cell width on each level along their narrowest axis. Collective.

    `particles` are the bunches one by one, in the order of the scene.
    """
    levels = range(hierarchy.levels)
    rows: list[Sequence[object]] = [
        ("bunches", "number", "particles of each", "charge of each", "sigma x, y, z", *(f"sigma/h {l}" for l in levels))
    ]
    copies_left = iter(particles)
    for number, bunch in enumerate(scene.bunches):
        copies = list(itertools.islice(copies_left, bunch.copies))
        size = np.sqrt(
            np.mean([moments(comm, copy, domain=hierarchy.domain).rms ** 2 for copy in copies], axis=0)
        )  # nan of an empty bunch
        is_finite = bool(np.isfinite(size).all())
        rows.append(
            [
                f"{number} {bunch.name or bunch.distribution}",
                len(copies),
                copies[0].global_count(comm),
                quantity(copies[0].total_charge(comm), "C"),
                ", ".join(quantity(float(sigma), "m", float(size.max())) for sigma in size) if is_finite else "none",
                *(f"{(size / hierarchy.spacing(level)).min():.2g}" if is_finite else "none" for level in levels),
            ]
        )
    return columns(rows) if scene.bunches else []


def _births(setup: Setup, start: float) -> tuple[list[int], list[str]]:
    """Return how many macroparticles sources give in a run whose time step is known, and the names of those that tell none."""
    scene, dt = setup.scene, setup.scene.motion.dt
    if not isinstance(dt, float):
        return [], []
    stop = start + _duration(scene, dt)
    numbers = {
        name: emitter.expected(start, stop, dt)
        for name, emitter in zip(scene.source_names, setup.emitters, strict=True)
    }
    numbers_known = [number for number in numbers.values() if number is not None]
    return numbers_known, [name for name, number in numbers.items() if number is None]


def _duration(scene: Scene, dt: float) -> float:
    """Return how long all steps take of which the first is `dt` s, if they grow as fast as they may, s."""
    growth, longest = scene.motion.growth, getattr(scene.motion, "longest", None) or math.inf
    return float(np.minimum(dt * (1 + growth) ** np.arange(scene.schedule.last_step), longest).sum())


def _memory(beam: MeshedParticles, particles: int, ranks: int, setup: Setup) -> list[str]:
    """Return how much memory a run takes, and by what. Collective."""
    hierarchy, mesh = _last_mesh(beam, setup)
    boxes = [hierarchy.boxes(level) for level in range(hierarchy.levels)]
    parts = run_memory(setup.scene, boxes, particles, ranks, cut_cells(beam.drive.electrodes, hierarchy))
    of = "1 rank" if ranks == 1 else f"{ranks} ranks"
    return [
        f"memory of a run on {of}: about {sum(parts.values()) / MIB:.0f} MiB at its fullest, {mesh}; "
        f"{machine_memory(setup.comm) / MIB:.0f} MiB are free here",
        *columns([(f"  {name}", f"{size / MIB:.0f}", "MiB") for name, size in parts.items()]),
    ]


def _time(comm: MPI.Comm, scene: Scene, hierarchy: Hierarchy, ranks: int, making: float, seconds: float) -> list[str]:
    """Return how long a run will take, whose particles were made in so many s. Collective."""
    cells = hierarchy.cells()
    try:
        with progress("measuring how long a step takes"):
            forecasted = forecast(comm, scene, cells, making, seconds)
    except AmrpicError as failure:
        return [f"time: a trial of the run ended with: {failure}"]
    if forecasted is None:
        return [f"time: not known after {seconds:g} s; give a trial more of them by --seconds"]
    start, step = (value * comm.size / ranks for value in (forecasted.start, forecasted.step))
    steps = scene.schedule.last_step
    shared = "" if ranks == comm.size else f", if {ranks} ranks share the work of {comm.size} evenly"
    steps_text = (
        f", then {quantity(step, 's')} per step, {quantity(start + steps * step, 's')} for all" if steps else ""
    )
    source = f"from {forecasted.source}{shared}; files and pictures at its end come on top"
    return [f"time: {quantity(start, 's')} to the end of the first solve{steps_text}; {source}"]


def _last_mesh(beam: MeshedParticles, setup: Setup) -> tuple[Hierarchy, str]:
    """Return the mesh of the last regrid, or else the first one, and which of them it is. Collective.

    A random walk can be foreseen; in one leap, so that particles leave the domain and coarse cells behind only there.
    """
    scene, motion, particles = setup.scene, setup.scene.motion, beam.particles
    end, refinement = scene.schedule.last_step, scene.refinement
    regrids = [step for step in range(1, end + 1) if refinement.regrids_at(step)]
    if motion.kind != "random-walk" or not regrids or regrids[-1] > FORESEEN:
        moves = end > 0 and refinement.follows
        return beam.hierarchy, f"on this mesh{'; more if it grows' if moves else ''}"
    for step in range(1, regrids[-1] + 1):
        particles = random_walk(particles, motion.amplitude, scene.seed, step)
    particles, _ = migrate(particles, beam.hierarchy)
    on_last = MeshedParticles(particles, beam.hierarchy, beam.frames, drive=beam.drive)
    last = follow(on_last, None, setup, refinement.hysteresis).hierarchy
    return last, f"on the mesh of step {regrids[-1]}, of {last.cells()} cells"


# ---- pictures ----


def _pictures(scene: Scene, rho: Field, start: float, window: Window) -> list[Path]:
    """Write mesh and charge density as a field file, draw them along the three axes, and return the paths. Collective."""
    path, mesh = scene.directory / FILE, (rho.hierarchy, {"rho": rho}, Moment(0, start, window))
    vtkhdf_writer.write(path, *mesh, about(scene), writers_of(scene))
    dump = LiveDump(path, *mesh, about(scene).scene_text)
    kinds = ("projection", "slice") if scene.conductors else ("projection",)
    with progress("drawing pictures"):
        return [
            path,
            *draw(dump, path.parent, [View("rho", kind, axis) for kind in kinds for axis in range(len(AXES))]),
        ]


# ---- the command ----


def add(commands: Commands) -> None:
    """Add the command to the parser."""
    added = command(
        commands,
        "preview",
        _preview,
        "show mesh, bunches, memory, time and pictures of a scene before it is run",
        "making the preview",
    )
    scene_arguments(added)
    added.add_argument(
        "--seconds",
        type=seconds("time for a trial", 0),
        default=5.0,
        metavar="S",
        help="how long to try out what a step takes; default 5, 0: solve nothing",
    )
    added.add_argument("--ranks", type=count, metavar="N", help="ranks of the run; default those of the preview")
    added.add_argument("--output", metavar="DIR", help="where to put the pictures; default runs/<scene>")


def _preview(chosen: argparse.Namespace) -> int:
    comm = MPI.COMM_WORLD
    scene = scene_on_all_ranks(comm, chosen)
    if isinstance(scene, Scene):
        text = preview(comm, scene, chosen.ranks or comm.size, chosen.seconds)
    else:
        from ..mpm.point_preview import preview as preview_points  # no other scene needs its imports

        text = preview_points(comm, scene)
    if comm.rank == 0:
        print(text)
    return 0

"""A state into a checkpoint, and back out of it on any number of ranks."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

import numpy as np

from ..errors import InputError
from ..io.checkpoint import Header, Snapshot, read, read_contents
from ..io.provenance import about
from ..mesh.domain import Domain
from ..mesh.field import Field, VectorField
from ..mesh.hierarchy import Hierarchy
from ..mesh.mirror import Mirror
from ..mesh.window import vector
from ..mpi import MPI
from ..particles.arrays import repeated
from ..particles.energy_bins import Charge, Frames
from ..particles.frame import Frame
from ..particles.particles import Particles
from ..particles.species import SpeciesTable
from ..scene.differences import differences, require_same, setting_text
from ..scene.domain_section import DomainSection
from ..scene.scene import Scene
from ..scene.solver_options import SolverOptions
from ..stages.gather import compensate
from ..stages.migrate import migrate
from ..stages.poisson import SolveReport
from ..stages.regrid import carry_over
from .adapt import follow, make_base
from .charge_images import mirrored
from .course import Course
from .field_functions import FieldFunction
from .leapfrog import gather_and_push
from .limits import require_room
from .meshed import MeshedParticles, deposit
from .records import Record
from .setup import Setup, set_up
from .solution import Solution
from .solve import go_without_compensation, solve, with_layers
from .state import State
from .tallies import Tallies, with_sources
from .time_step import with_time_step

FIELDS = ("rho", "phi", "efield_x", "efield_y", "efield_z")
MAGNETIC = ("bfield_x", "bfield_y", "bfield_z")  # where parts have frames of their own
OF_CHARGE = "_of_charge"  # behind a name: without images and what walls hold, where these are solved for by themselves
OF_IMAGES = "_of_images"  # behind a name: of images of the charge in walls across its motion
BEFORE = "phi_before"  # that of the step before, where solves start from both
UNITS = {"rho": "C/m^3", "phi": "V", "efield": "V/m", "bfield": "T"}
COLUMNS = ("position", "momentum", "weight", "id")
RECORDED = ("time", "direction", "cause")  # beside them, of particles in a record
# Parts of a scene that a restart follows from the next step on.
FOLLOWED = (
    "seed",
    "domain",
    "background",
    "sources",
    "refinement",
    "particles",
    "solver",
    "motion",
    "apertures",
    "electrodes",
    "screens",
)


def snapshot(state: State, setup: Setup) -> Snapshot:
    """Return the whole state as a checkpoint takes it: arrays shared, not copied; of fields from Python the
    names. Collective.
    """
    hierarchy, particles, report, scene = state.hierarchy, state.synchronized, state.report, setup.scene
    columns = _columns(particles)
    lag = state.staggered.lag_to_keep
    if lag > 0:  # kept as they are, since what follows from those of the state's own time differs by rounding
        columns["lagging_momentum"] = state.particles.momentum
    header = Header(
        step=state.step,
        time=state.time,
        domain=scene.domain.model_dump(mode="json"),
        boxes=[hierarchy.boxes(level) for level in range(hierarchy.levels)],
        owners=[hierarchy.owners(level) for level in range(hierarchy.levels)],
        about=about(scene),
        extra={
            "species": particles.species.to_dict(),
            "report": vars(report),
            "report_of_images": None if state.solution.images is None else vars(state.solution.images.report),
            "frames": asdict(state.solution.frames),
            "lag": lag,
            "dt": setup.dt,
            "next_dt": state.staggered.dt,
            "longest_dt": state.longest,
            "course": state.course.to_dict(),
            "fields": list(setup.fields.names),
            "sources": state.tallies.to_list(),
            "compensation_by_auto": setup.compensation_by_auto,
            "servers": state.particles.sorted_on(hierarchy).servers.tolist(),
            "names": {"lost": state.lost.names, "screens": state.screens.names},
            "lost_charges": setup.comm.allgather(state.lost.charges.tolist()),  # of each rank, to the last bit
        },
    )
    fields = {name: [field.array(level) for level in range(hierarchy.levels)] for name, field in _fields(state).items()}
    tables = {"particles": columns, "lost": _table(state.lost), "screens": _table(state.screens)}
    return Snapshot(header, fields, tables)


def load(
    comm: MPI.Comm, path: Path, scene: Scene | None = None, fields: Sequence[FieldFunction] = ()
) -> tuple[State, Setup]:
    """Return the state in a checkpoint and the set-up to go on with, on any number of ranks.

    Collective; InputError on all ranks.

    `scene` may replace that of the checkpoint if its cuboid and boundary are the same. On another base, or with boxes of
    other sizes, the mesh is made anew by its rule, and the field solved there from the potential carried over.
    """
    contents = read_contents(comm, path)
    header = contents.header
    if "method" in header.about.scene:
        raise InputError(
            f"checkpoint {path} holds material points; go on from it by a scene of theirs, or start afresh"
        )
    by_auto = header.extra["compensation_by_auto"] if scene is None else scene.particles.compensation == "auto"
    scene = scene if scene is not None else Scene.from_dict(header.about.scene, source=f"the scene in {path}")
    for key in ("interface", "compensation"):
        if getattr(scene.particles, key) == "auto":
            scene = scene.with_clouds(**{key: header.about.scene["particles"][key]})
    _require_same_domain(scene, header, path)
    require_room(comm, scene, header.boxes, sum(contents.rows["particles"]), f"checkpoint {path}")
    domain, sizes = _mesh_of(header)
    stored = Hierarchy(comm, domain, list(header.boxes[1:]), *sizes, base=header.boxes[0])
    owners = [stored.owners(level) for level in range(stored.levels)]
    snapshot = read(comm, path, lambda _: owners, contents)
    setup = replace(set_up(comm, scene, fields), compensation_by_auto=by_auto)
    for remark in _remarks(scene, header) + _remarks_on_fields(setup.fields.names, header.extra["fields"]):
        setup.remarks.remark(remark)
    if _mesh_is_another(scene, header):
        hierarchy = make_base(setup.comm, scene)
    elif contents.ranks != comm.size:  # boxes are halved for as many ranks as wrote them
        hierarchy = Hierarchy(comm, domain, list(header.boxes[1:]), *sizes)
    else:
        hierarchy = stored
    return _state(setup, snapshot, stored, hierarchy)


def _mesh_of(header: Header) -> tuple[Domain, tuple[int, int]]:
    """Return the domain of a checkpoint, and the largest extent of its boxes and their blocking factor."""
    refinement = header.about.scene["refinement"]
    domain = DomainSection.model_validate(header.domain).value
    return domain, (refinement["max_grid_size"], refinement["blocking_factor"])


def _mesh_is_another(scene: Scene, header: Header) -> bool:
    """Whether a scene has another base or boxes of other sizes than a checkpoint."""
    refinement = scene.refinement
    return (scene.domain.value, (refinement.max_grid_size, refinement.blocking_factor)) != _mesh_of(header)


def _state(setup: Setup, snapshot: Snapshot, stored: Hierarchy, hierarchy: Hierarchy) -> tuple[State, Setup]:
    extra = snapshot.header.extra
    species = with_sources(SpeciesTable.from_dict(extra["species"]).runs, setup.scene)
    columns, lag = snapshot.tables["particles"], extra["lag"]
    if lag > 0 and setup.scene.motion.follows_fields:
        columns = {**columns, "momentum": columns["lagging_momentum"]}
    else:
        lag = 0.0
    servers = np.array(extra["servers"], dtype=np.int64)  # of the ranks that wrote the checkpoint
    same_ranks = len(servers) == setup.comm.size + 1
    another = _mesh_is_another(setup.scene, snapshot.header)
    particles, _ = migrate(_particles(columns, species), hierarchy, servers if same_ranks and not another else None)
    fields = {name: Field(stored, UNITS[name.split("_")[0]]) for name in snapshot.fields}
    options = SolverOptions(order=snapshot.header.about.scene["solver"]["order"])
    for name, field in fields.items():
        field.holds = options.potential_holds if name.startswith("phi") else "points"
        for level, values in enumerate(snapshot.fields[name]):
            field.array(level)[:] = values
    if hierarchy is not stored and not another:
        fields = {name: carry_over(field, hierarchy) for name, field in fields.items()}
    course = Course.from_dict(extra["course"]).on_base_of(setup.scene, setup.emitters)
    step, time = snapshot.header.step, snapshot.header.time
    lost, screens = (_recorded(snapshot.tables[of], species, extra["names"][of]) for of in ("lost", "screens"))
    if len(of_ranks := extra.get("lost_charges", ())) == setup.comm.size:
        lost = replace(lost, charges=np.array(of_ranks[setup.comm.rank]))
    drive = setup.solvers.drive = setup.drive(time, course.window, lost)
    last = _solution(setup, fields, extra)
    beam, solution = MeshedParticles(particles, hierarchy, last.frames, drive=drive), last
    if another:
        beam = replace(beam, frames=mirrored(last.frames, last.frames, setup.scene, course.window))
        beam = follow(beam, last, setup)
        solution = solve(beam, deposit(beam, setup), last, setup)
    else:
        solution = with_layers(solution, particles, setup)
    if snapshot.header.about.scene["motion"].get("dt") == "auto" and math.isnan(setup.dt):
        setup = replace(setup, dt=extra["dt"])
    if setup.dt != extra["dt"]:
        setup = with_time_step(setup, beam, solution, course)
    dt, longest = (
        extra.get(key, setup.dt) if setup.scene.motion.growth else setup.dt for key in ("next_dt", "longest_dt")
    )
    staggered = gather_and_push(solution, beam.particles, lag, dt, step, time, course, setup)
    spent = setup.clock.take()
    tallies = Tallies.of_scene(setup.scene, extra.get("sources", ()))
    return State(staggered, solution, lost, screens, tallies, course, step, time, longest, spent=spent), setup


def _solution(setup: Setup, fields: Mapping[str, Field], extra: Mapping[str, Any]) -> Solution:
    """Return what was solved for, as a checkpoint holds it. Collective."""
    frames, images = _frames(extra), None
    setup.remarks.on_frames(
        frames, setup.scene.motion
    )  # so that what the log has up to the checkpoint does not come again
    solution = _part(fields, frames, extra["report"], OF_CHARGE)
    if frames.only is not None:
        stretch = setup.solvers.stretch(frames.only)
        compensate(solution.efield, solution.rho, setup.clouds, stretch)
    else:
        go_without_compensation(setup)
    if (reflected := frames.images) is not None:
        images = _part(fields, reflected, extra["report_of_images"], OF_IMAGES, OF_IMAGES)
    walls = setup.solvers.walls(solution.rho.hierarchy, frames, setup.clouds.covered)
    return replace(solution, before=fields.get(BEFORE), walls=walls, images=images)


def _part(
    fields: Mapping[str, Field], frames: Frames, report: Mapping[str, Any], of: str, of_bins: str = ""
) -> Solution:
    """Return the field of the charge or of its images, whose names end so, as those of its bins do."""
    rho, phi, *efield = (fields.get(name + of, fields[name]) for name in FIELDS)
    names = [f"phi_{number}{of_bins}" for number in range(len(frames.members))]
    if names[0] not in fields:
        return Solution(rho, phi, VectorField(*efield), SolveReport(**report), frames)
    magnetic = VectorField(*(fields.get(name + of, fields[name]) for name in MAGNETIC))
    parts = tuple(fields[name] for name in names)
    return Solution(rho, phi, VectorField(*efield), SolveReport(**report), frames, parts, magnetic)


def _fields(state: State) -> dict[str, Field]:
    solution, images = state.solution, state.solution.images
    # E is kept although it follows from φ: at open walls that takes the charge of the latest solve as well.
    out = _by_name(state.rho, state.phi, state.efield, None if solution.magnetic is None else solution.bfield)
    out |= {f"phi_{number}": part for number, part in enumerate(solution.parts)}
    # A run goes on from what is without images and walls, to the last bit.
    if solution.walls is not None or images is not None:
        magnetic = None if images is None else solution.magnetic
        of_charge = _by_name(state.rho, solution.phi, solution.efield, magnetic)
        out |= {name + OF_CHARGE: field for name, field in of_charge.items() if name != "rho"}
    if images is not None:
        of_images = _by_name(state.rho, images.phi, images.efield, images.magnetic)
        of_images |= {f"phi_{number}": part for number, part in enumerate(images.parts)}
        out |= {name + OF_IMAGES: field for name, field in of_images.items() if name != "rho"}
    if solution.before is not None:
        out[BEFORE] = solution.before
    return out


def _by_name(rho: Field, phi: Field, efield: VectorField, magnetic: VectorField | None) -> dict[str, Field]:
    out = dict(zip(FIELDS, (rho, phi, *efield.with_components().components), strict=True))
    if magnetic is not None:
        out |= dict(zip(MAGNETIC, magnetic.components, strict=True))
    return out


def _frames(extra: Mapping[str, Any]) -> Frames:
    stored = extra["frames"]
    members = tuple(Frame(**member) for member in stored["members"])
    of = tuple(tuple(Charge(*charge) for charge in part) for part in stored["of"])
    turn = None if stored["turn"] is None else tuple(map(vector, stored["turn"]))
    mirror = None if stored["mirror"] is None else Mirror.from_dict(stored["mirror"])
    errors, motion = (stored["error"], stored["across"], vector(stored["moves"])), tuple(map(tuple, stored["motion"]))
    edges = tuple(stored["edges"])
    return Frames(members, stored["axis"], edges, of, *errors, motion, turn, mirror, stored["leaves"])


def _recorded(table: Mapping[str, np.ndarray], species: SpeciesTable, names: Sequence[str]) -> Record:
    return Record.of(_particles(table, species), table["time"], table["direction"], table["cause"], names)


def _table(record: Record) -> dict[str, np.ndarray]:
    return {**_columns(record.particles), **{name: getattr(record, name) for name in RECORDED}}


def _columns(particles: Particles) -> dict[str, np.ndarray]:
    return {name: getattr(particles, name) for name in COLUMNS}


def _particles(columns: Mapping[str, np.ndarray], species: SpeciesTable) -> Particles:
    position, momentum, weight, number = (columns[name] for name in COLUMNS)
    return Particles(position, momentum, repeated(weight), number, species)


def _remarks(scene: Scene, header: Header) -> list[str]:
    """Return what a restart cannot follow of a scene, and what it follows from now on."""
    now, made_from, out = scene.to_dict(), header.about.scene, []
    if _mesh_is_another(scene, header):
        out.append("the mesh is made anew, and the field solved on it: the base or the sizes of boxes are other ones")
        if header.extra["frames"]["leaves"]:
            out.append(
                "the wall that the window left behind is taken up to a quarter of a base cell off its place for the field at "
                "the restart, and in its place from the next step on"
            )
    if now["bunches"] != made_from["bunches"]:
        out.append("bunches of the scene differ from those of the checkpoint, whose particles go on as they are")
    if scene.schedule.start is not None and scene.schedule.start != made_from["schedule"].get("start"):
        out.append(f"schedule.start has no effect: the run goes on at the {header.time:.6g} s of the checkpoint")
    if any("map" not in tally for tally in header.extra.get("sources", ())):
        out.append("maps of what sources gave begin at the checkpoint, whose earlier version kept none")
    changed = [
        f"{path} is {setting_text(value)}, before {setting_text(before)}"
        for part in FOLLOWED
        for path, value, before in differences(now.get(part), made_from.get(part, []), part)
    ]
    if changed:
        out.append(f"the run goes on otherwise than up to the checkpoint: {'; '.join(changed)}")
    return out


def _remarks_on_fields(names: Sequence[str], before: Sequence[str]) -> list[str]:
    """Return that fields from Python are others than before, if they are."""
    if names == before:
        return []
    now, earlier = (", ".join(texts) or "none" for texts in (names, before))
    return [
        f"fields from Python are {now}, and were {earlier} up to the checkpoint; give Simulation.restart the same ones to go "
        "on as before"
    ]


def _require_same_domain(scene: Scene, header: Header, path: Path) -> None:
    """Raise InputError unless a scene has the cuboid and the boundary of a checkpoint; base cells may be others."""
    now = scene.domain.model_dump(mode="json")
    require_same(scene.name, path, differences(now, {**header.domain, "cells": now["cells"]}, "domain"))

"""Time of the particle stages on one uniform level: `python benchmarks particles`."""

from __future__ import annotations

import importlib
import importlib.util
import time
from collections.abc import Callable, Iterator
from statistics import median
from typing import Annotated, Any, TypeVar

import numpy as np
from mpi4py import MPI

import amrpic
from amrpic.mesh.field import VectorField
from amrpic.mesh.hierarchy import Hierarchy
from amrpic.particles.arrays import empty_columns
from amrpic.particles.clouds import SHAPES, Clouds, Shape
from amrpic.particles.particles import Particles
from amrpic.particles.species import SPECIES, SpeciesTable
from amrpic.stages.deposit import deposit
from amrpic.stages.diagnostics import moments
from amrpic.stages.gather import gather
from amrpic.stages.migrate import migrate
from amrpic.stages.push import push
from measuring import Record, Runs, in_turns, reset_peak, resident, watched, work_unit
from plain_particles import PlainStages

Result = TypeVar("Result")
ELECTRON = SpeciesTable((SPECIES["electron"],))
DT = 1e-12  # s
MOVE = 0.3  # cell widths
OWN_B, SOLENOID = "gather+push with own B", "gather+push in a solenoid"
BY_KOKKOS = ("deposit", "gather+push")  # are compared with the loops over vectors
STAGES = ("deposit", "field", "gather", "gather+push", OWN_B, SOLENOID, "migrate", "moments")


def measure(particles: int, cells: int, box: int, shape: Shape = "cloud-in-cell", repeats: int = 5) -> dict[str, float]:
    """Return the time of each particle stage in ns per particle, the median of `repeats`; see `timings`."""
    found = timings(particles, cells, box, shape, repeats)
    return {stage: 1e9 * median(found[stage]) / particles for stage in STAGES}


def timings(
    particles: int, cells: int, box: int, shape: Shape = "cloud-in-cell", repeats: int = 5
) -> dict[str, list[float]]:
    """Return the seconds of each of `stages` in each repeat, on this rank alone.

    Of clouds in cells also those of plain loops, `plain_name` of a stage, which take turns with it in CPU time.
    """
    ours, out = stages(particles, cells, box, shape), {}
    plain = plain_stages(particles, cells, box).works if shape == "cloud-in-cell" else {}
    for name, stage in ours.items():
        if name in plain:
            works = (stage, plain[name])
            for work in works:
                work()  # makes the tables that a hierarchy needs once
            out[name], out[plain_name(name)] = in_turns(works, repeats)
        else:
            out[name] = _seconds(stage, repeats)
    return out


def plain_stages(particles: int, cells: int, box: int) -> PlainStages:
    """Return the plain loops over particles like those of `stages`, in the same order."""
    rng = np.random.default_rng(1)
    domain = amrpic.Domain((0, 0, 0), (1, 1, 1), (cells, cells, cells), "periodic")
    homes = _sorted_particles(rng, particles, amrpic.Hierarchy(MPI.COMM_SELF, domain, max_grid_size=box))
    step = rng.normal(size=(particles, 3))
    step *= MOVE / cells / np.linalg.norm(step, axis=1)[:, None]
    (kind,) = homes.species.kinds
    return PlainStages(
        cells, homes.position, homes.momentum, homes.position + step, homes.weight, kind.charge, kind.mass, DT
    )


def beside_kokkos(particles: int, cells: int, box: int, repeats: int) -> Iterator[Record]:
    """Yield what Kokkos' kernels take and the loops over vectors, in turns with each other, in CPU time."""
    kinds = {kernels: stages(particles, cells, box, kernels=kernels) for kernels in ("kokkos", "vectors")}
    for stage in BY_KOKKOS:
        works = [of_kind[stage] for of_kind in kinds.values()]
        for work in works:
            work()
        for kernels, seconds in zip(kinds, in_turns(works, repeats), strict=True):
            yield Record(kernels_name(stage, particles, kernels), seconds, particles=particles)


def stages(
    particles: int, cells: int, box: int, shape: Shape = "cloud-in-cell", **of_clouds: Any
) -> dict[str, Callable[[], object]]:
    """Return the particle stages, ready to be run again and again, on this rank alone; `of_clouds`: more of theirs.

    Equal particles fill a periodic cube of `cells`³ cells in boxes of `box`³ evenly and at random, and are sorted.
    Keys: "deposit"; "field", what the two next ones read, from the potential, which takes the same for any number of
    particles; "gather", the field at the particles alone; "gather+push", all of a leapfrog step's motion: the field, two half
    kicks and the drift, and the same with the magnetic field of a fast bunch, or of a solenoid around all of them, with the
    momenta between; "migrate", after each particle has moved by 0.3 cell widths in a direction of its own, so that about
    two in five change their cell; "moments", what a row of the time series tells of them. A stage's result is dropped before
    the next repeat, as a run drops the step before.
    """
    rng = np.random.default_rng(1)
    domain = amrpic.Domain((0, 0, 0), (1, 1, 1), (cells, cells, cells), "periodic")
    hierarchy = amrpic.Hierarchy(MPI.COMM_SELF, domain, max_grid_size=box)
    homes = _sorted_particles(rng, particles, hierarchy)
    solver, phi = amrpic.PoissonSolver(hierarchy, background="neutralizing"), _smooth_potential(hierarchy)
    efield = solver.deferred_field(phi)
    clouds = Clouds(shape, **of_clouds)
    step = rng.normal(size=(3, particles))
    step *= MOVE / cells / np.sqrt((step**2).sum(axis=0))
    moved = homes.replace(position=homes.position + step.T)
    pushed = push(efield, homes, DT / 2, DT / 2, DT, clouds)
    del step

    return {
        "deposit": lambda: deposit(homes, hierarchy, clouds),
        "field": lambda: solver.deferred_field(phi),
        "gather": lambda: gather(efield, homes, clouds),
        "gather+push": lambda: push(efield, homes, DT / 2, DT / 2, DT, clouds),
        **_stages_with_magnetic_fields(efield, homes, clouds),
        "migrate": lambda: migrate(moved, hierarchy),
        "moments": lambda: moments(hierarchy.comm, homes, pushed, 0.5),
    }


def _stages_with_magnetic_fields(
    efield: VectorField, homes: Particles, clouds: Clouds
) -> dict[str, Callable[[], object]]:
    """Return two of `stages`; none for revisions before there were magnetic fields, which `compare.py` runs too."""
    if importlib.util.find_spec("amrpic.external") is None:
        return {}
    external = importlib.import_module("amrpic.external")
    elements = importlib.import_module("amrpic.scene.elements")
    coil = elements.SolenoidElement(kind="solenoid", centre=(0.5, 0.5, 0.5), length=2.0, field=1e-3)
    native, between = external.ExternalFields([coil]).native, empty_columns(len(homes))
    return {
        OWN_B: lambda: push(efield, homes, DT / 2, DT / 2, DT, clouds, beta=(0, 0, 0.5), between=between),
        SOLENOID: lambda: push(efield, homes, DT / 2, DT / 2, DT, clouds, external=native, between=between),
    }


def memory_of(particles: int, cells: int, box: int) -> Record:
    """Return what particles take, and what migrating them takes at its peak, in bytes each. For a process of its own."""
    domain = amrpic.Domain((0, 0, 0), (1, 1, 1), (cells, cells, cells), "periodic")
    hierarchy = amrpic.Hierarchy(MPI.COMM_SELF, domain, max_grid_size=box)
    rng = np.random.default_rng(1)
    _sorted_particles(rng, 1000, hierarchy)  # libraries are loaded, the hierarchy's tables made
    before = resident("VmRSS")
    homes = _sorted_particles(rng, particles, hierarchy)
    held = resident("VmRSS") - before
    reset_peak()
    start = time.perf_counter()
    moved = migrate(homes, hierarchy)
    seconds = time.perf_counter() - start
    peak = resident("VmHWM") - before
    del moved
    facts = {"bytes per particle, held": held / particles, "bytes per particle, peak": peak / particles}
    return Record(f"memory, {particles:.0e} particles", [seconds], particles=particles, facts=facts)


def _sorted_particles(rng: np.random.Generator, count: int, hierarchy: Hierarchy) -> Particles:
    momentum = 1e-24 * rng.normal(size=(3, count)).T
    made = Particles(rng.random((3, count)).T, momentum, np.broadcast_to(1.0, count), np.arange(count), ELECTRON)
    return migrate(made, hierarchy)[0]


def _smooth_potential(hierarchy: Hierarchy) -> amrpic.Field:
    wave = 2 * np.pi
    return amrpic.Field(hierarchy, unit="V").fill(lambda x, y, z: np.sin(wave * x) * np.cos(wave * (y + 2 * z)))


def _seconds(stage: Callable[[], Result], repeats: int) -> list[float]:
    taken = []
    for _ in range(repeats + 1):  # the first one makes the tables that a hierarchy needs once
        start = time.perf_counter()
        result = stage()
        taken.append(time.perf_counter() - start)
        del result
    return taken[1:]


def run(
    particles: tuple[float, ...] = (1e6, 1e7),
    cells: Annotated[int, "along each axis"] = 128,
    box: Annotated[int, "cells along each axis of a box"] = 32,
    shape: Annotated[tuple[Shape, ...], "of clouds", SHAPES] = tuple(SHAPES),
    repeats: Runs = 5,
    memory: Annotated[bool, "measure the memory of the first number of particles alone"] = False,
    by_kokkos: Annotated[bool, "compare Kokkos' kernels with the loops over vectors alone"] = False,
) -> Iterator[Record]:
    """All stages, for each number of particles."""
    if memory:
        yield memory_of(int(particles[0]), cells, box)
        return
    for count in map(int, particles):
        if by_kokkos:
            yield from beside_kokkos(count, cells, box, repeats)
            continue
        for one in shape:
            facts: dict[str, Any] = {}
            with watched(facts):
                found = timings(count, cells, box, one, repeats)
            unit = work_unit(MPI.COMM_SELF, cells**3)
            for stage, taken in found.items():
                name = record_name(stage, count, one)
                yield Record(name, taken, unit.seconds, particles=count, facts=facts)


def printed(record: Record) -> str:
    if not record.particles:
        return f"{record.name}: {record.facts}"
    return f"{record.name}: {1e9 * record.median / record.particles:.1f} ns/particle"


def plain_name(stage: str) -> str:
    return f"plain {stage}"


def kernels_name(stage: str, particles: int, kernels: str) -> str:
    return f"{stage} by {kernels}, {particles:.0e} particles"


def record_name(stage: str, particles: int, shape: str) -> str:
    return f"particles, {stage}, {particles:.0e}, {shape}"

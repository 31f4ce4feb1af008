"""Test particles that a breathing core drives into a halo."""

from __future__ import annotations

import itertools
from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np
from mpi4py import MPI

from amrpic.pic.state import State
from amrpic.pic.step import advance, begin
from amrpic.scene.scene import Scene
from amrpic.verify.table import Goal, Table, picture
from exact.channel import DEPRESSION, FOCUSING, LENGTH, OMEGA, PERIOD, RADIUS, Envelope, constant, matched, slab
from exact.runs import collected

MISMATCH = 0.62
CORE = 100_000
TESTS = 2000
FURTHEST = 1.5  # start of the outermost test particle, matched radii
PERIODS = 20
STEPS = 100  # a period
FINER = 4  # steps of the equation in one of the run
LEVELS = 3


def table(comm: MPI.Comm) -> Table:
    """Largest radii of test particles against those of the particle-core equation. Collective."""
    beam = matched()
    core = replace(beam, start=(MISMATCH * beam.start[0],) * 2)
    times = np.arange(PERIODS * STEPS * FINER + 1) * PERIOD / (STEPS * FINER)
    radius = 2 * core.at(times, constant)[0]
    start = np.linspace(0, FURTHEST, TESTS + 1)[1:] * RADIUS
    reached, exact = _reached(comm, core, start, radius[::FINER]), particle_core(start, radius, times[1])
    found, wanted = (float(values.max() / RADIUS) for values in (reached, exact))
    return Table(
        "Halo of a breathing core",
        f"Weightless electrons that start at rest, at up to {FURTHEST} matched radii and at all angles, in constant focusing "
        "and in the field of a uniform round core of tune depression 0.5 whose radius follows the envelope equation from "
        f"{MISMATCH} of the matched one; {CORE} particles make the core, {LEVELS} levels are refined, {PERIODS} periods of "
        f"{STEPS} steps. Largest radius that any of them reaches, in matched radii, and that of the particle-core equation "
        "(R. L. Gluckstern, Phys. Rev. Lett. 73 (1994) 1247; T. P. Wangler et al., Phys. Rev. ST Accel. Beams 1 (1998) "
        "084201).",
        ("largest radius", "by the equation", "error"),
        [[found, wanted, Goal(abs(found / wanted - 1), 0.02)]],
        upwards="largest radius over radius at the start",
        picture=partial(_draw, start / RADIUS, reached / RADIUS, exact / RADIUS),
    )


def particle_core(start: np.ndarray, radius: np.ndarray, dt: float) -> np.ndarray:
    """Largest distances, m, of particles at rest at `start` (m) that pass through the middle of a uniform core.

    `radius` (m) is that of the core after each step of `dt` s, by leapfrog.
    """
    x, v, largest = start.copy(), np.zeros_like(start), start.copy()
    for before, after in itertools.pairwise(radius):
        v += dt / 2 * _force(x, before)
        x += dt * v
        v += dt / 2 * _force(x, after)
        np.maximum(largest, np.abs(x), out=largest)
    return largest


def _force(x: np.ndarray, radius: float) -> np.ndarray:
    """Focusing and the field of the core, m/s²."""
    own = (1 - DEPRESSION**2) * (RADIUS / np.maximum(radius, np.abs(x))) ** 2
    return OMEGA**2 * (own - 1) * x


def _reached(comm: MPI.Comm, core: Envelope, start: np.ndarray, radius: np.ndarray) -> np.ndarray:
    """Largest distances of test particles from the axis on the mesh, m; the core has a prescribed radius (m) at each step."""
    angle = np.pi * (3 - np.sqrt(5)) * np.arange(len(start))
    place = np.stack(
        [start * np.cos(angle), start * np.sin(angle), np.linspace(-0.49, 0.49, len(start)) * LENGTH], axis=1
    )
    tests = {"distribution": "arrays", "species": "electron", "position": place, "charge": 1e-15 * core.charge * LENGTH}
    scene = Scene.from_dict(slab([core.bunch(CORE), tests], [FOCUSING], PERIOD / STEPS, len(radius) - 1, LEVELS))
    (state, setup), largest = begin(comm, scene), start.copy()
    for before, after in itertools.pairwise(radius):
        state = advance(_breathing(state, after / before), setup)
        position, _ = collected(comm, state.particles.select(state.particles.id >= CORE))
        np.maximum(largest, np.hypot(position[:, 0], position[:, 1]), out=largest)
    return largest


def _breathing(state: State, factor: float) -> State:
    """Return the state whose core goes to where it is now, times a factor across the beam, whatever drives it."""
    particles, staggered = state.particles, state.staggered
    moved = np.where(particles.id[:, None] < CORE, particles.position * (factor, factor, 1.0), staggered.moved.position)
    return replace(state, staggered=replace(staggered, moved=staggered.moved.replace(position=moved)))


def _draw(start: np.ndarray, reached: np.ndarray, exact: np.ndarray, path: Path) -> None:
    with picture(
        path, "Halo of a breathing core", "radius at the start / matched radius", "largest radius / matched radius"
    ) as axes:
        axes.plot(start, reached, ".", markersize=2, label="test particles")
        axes.plot(start, exact, "k", linewidth=0.7, label="particle-core equation")

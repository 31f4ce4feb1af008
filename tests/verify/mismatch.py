"""A mismatched thermal beam makes a halo, and a mesh that follows it keeps its radius."""

from __future__ import annotations

import math
import time
from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from mpi4py import MPI

from amrpic.pic.beam_tables import groups_of
from amrpic.pic.setup import Setup
from amrpic.pic.state import State
from amrpic.pic.step import advance, begin
from amrpic.scene.scene import Scene
from amrpic.stages.beam_diagnostics import FRACTIONS, group_moments, group_quantiles
from amrpic.verify.table import Cell, Goal, Table, picture
from exact.channel import DEPRESSION, FOCUSING, PERIOD, RADIUS, constant, matched, slab, thermal

from .halo import particle_core
from .lengths import in_full

MISMATCH = 1.5
PIPE = 8 * RADIUS  # half width: 16 matched rms sizes
STEPS = 20  # a period of the focusing
LEVELS = 2
BREATHING = PERIOD / math.sqrt(2 + 2 * DEPRESSION**2)  # of a small one
LAST = 10  # breathings over which radii are averaged
FOLLOWS = {"kind": "particles-per-cell", "at_least": 1}


@dataclass(frozen=True)
class Form:
    """How much of it is measured."""

    base: int  # cells across the pipe
    particles: int
    periods: int
    fraction: float  # of the particles within the radius that goals are about

    @property
    def name(self) -> str:
        return f"{100 * self.fraction:g} %"


SHORT = Form(96, 100_000, 60, 0.999)
FULL = Form(256, 1_000_000, 100, 0.9999)


@dataclass(frozen=True)
class Course:
    """What a run gives: radii of the `FRACTIONS` (n, fractions), m, after each step, and its processor time in s a step."""

    radii: np.ndarray
    seconds: float
    cells: int

    def last(self, fraction: float) -> float:
        """Radius of a fraction of the particles, averaged over the last breathings."""
        steps = round(LAST * BREATHING / PERIOD * STEPS)
        return float(self.radii[-steps:, FRACTIONS.index(fraction)].mean())


def table(comm: MPI.Comm) -> Table:
    """Radius of the halo with refinement and on a fine mesh everywhere, against the particle-core equation. Collective."""
    form = FULL if in_full() else SHORT
    factor = 2**LEVELS
    follows = run(comm, form, scene(form, form.base, LEVELS))
    uniform = run(comm, form, scene(form, form.base * factor, 0, deep=factor))
    exact = largest_radius()
    rows: list[list[Cell]] = []
    for name, course in (("follows the halo", follows), ("fine everywhere", uniform)):
        reached = course.last(form.fraction)
        radii = (course.last(fraction) / RADIUS for fraction in (0.999, 0.9999))
        within = (Goal(reached / exact, 0.8, least=True), Goal(reached / exact, 1.1))
        rows.append([name, course.cells, "", *radii, *within, "", course.seconds, ""])
    rows[0][2] = Goal(follows.cells / uniform.cells, 0.25)
    rows[0][7] = Goal(abs(follows.last(form.fraction) / uniform.last(form.fraction) - 1), 0.03)
    part = follows.seconds / uniform.seconds
    rows[0][9] = Goal(part, 0.25) if in_full() else part  # short runs take too little time for that
    more = f" In full it follows {FULL.particles} over {FULL.periods} periods, on a base of {FULL.base} cells."
    return Table(
        "Halo of a mismatched thermal beam",
        f"Slab of {form.particles} electrons, in thermal equilibrium with constant focusing and their own field at a tune "
        f"depression of {DEPRESSION}, but {MISMATCH} times as wide at the start, in a square grounded pipe of a half width of "
        f"16 matched rms sizes, over {form.periods} periods of the focusing in steps of 1/{STEPS} of one. {LEVELS} levels "
        f"are refined where there are particles, on a base of {form.base} cells across the pipe; beside a mesh as fine "
        f"everywhere. Radii within which 99.9 % and 99.99 % of the particles lie, in matched radii, averaged over the last "
        f"{LAST} breathings; that of {form.name} over the largest radius by the particle-core equation for the same breathing, "
        f"{exact / RADIUS:.3f} matched radii, against both of its bounds, and its difference from that on the fine mesh; "
        f"processor time of a step of a rank, and over that on the fine mesh.{'' if in_full() else more}",
        (
            *("mesh", "cells", "part of them", "99.9 %", "99.99 %", "of the equation's", "same", "difference"),
            *("s a step", "part of that"),
        ),
        rows,
        upwards="radius over matched radius",
        picture=partial(_draw, {"fine everywhere": uniform, "follows the halo": follows}, exact, form),
    )


def largest_radius() -> float:
    """Largest distance from the axis, m, of particles that a core of the same breathing drives, by its equation."""
    beam, finer = matched(), 10 * STEPS
    core = replace(beam, start=(MISMATCH * beam.start[0],) * 2)
    times = np.arange(40 * finer + 1) * PERIOD / finer
    radius = 2 * core.at(times, constant)[0]
    begins = int(np.argmin(radius[: 2 * finer]))  # smallest there, so that particles inside are driven outwards
    return float(particle_core(np.linspace(0.01, 1.5, 300) * RADIUS, radius[begins:], times[1]).max())


def scene(form: Form, cells: int, levels: int, deep: int = 1, rule: Mapping[str, Any] = FOLLOWS) -> dict[str, Any]:
    """A scene of the beam on so many base cells across the pipe, and two times `deep` along it; all are cubes."""
    length = 4 * deep * PIPE / cells
    bunch = thermal(form.particles, length, MISMATCH)
    reach = (PIPE, PIPE, length / 2)
    made = slab([bunch], [FOCUSING], PERIOD / STEPS, STEPS * form.periods, levels)
    made["domain"] |= {"lower": [-a for a in reach], "upper": list(reach), "cells": [cells, cells, 2 * deep]}
    made["refinement"] |= {"regrid_every": STEPS, "rule": dict(rule)}
    return made


def run(comm: MPI.Comm, form: Form, of: Mapping[str, Any]) -> Course:
    """Run a scene to its end. Collective."""
    (state, setup), radii, spent = begin(comm, Scene.from_dict(of)), [], 0.0
    for _ in range(STEPS * form.periods):
        start = time.process_time()
        state = advance(state, setup)
        spent += time.process_time() - start
        radii.append(_radii(comm, state, setup))
    seconds = comm.allreduce(spent, MPI.MAX) / len(radii)
    cells = state.hierarchy.cells()
    return Course(np.array(radii), seconds, cells)


def _radii(comm: MPI.Comm, state: State, setup: Setup) -> np.ndarray:
    """Radii across the beam within which the `FRACTIONS` of the particles lie, m. Collective."""
    groups = groups_of(state, setup.scene)
    moments = group_moments(comm, state.beam, groups)
    (found,) = group_quantiles(comm, state.beam, groups, moments).values()
    return found.transverse


def _draw(courses: Mapping[str, Course], exact: float, form: Form, path: Path) -> None:
    title = f"Radius within which {form.name} of a mismatched beam lie"
    with picture(path, title, "periods", "radius over matched radius") as axes:
        for (name, course), width in zip(courses.items(), (1.6, 0.6), strict=True):
            radii = course.radii[:, FRACTIONS.index(form.fraction)] / RADIUS
            axes.plot(np.arange(1, len(radii) + 1) / STEPS, radii, linewidth=width, label=name)
        for bound, label in ((1.0, "particle-core equation"), (0.8, "bounds"), (1.1, None)):
            style = "-" if bound == 1 else ":"
            axes.axhline(bound * exact / RADIUS, color="k", linestyle=style, linewidth=0.8, label=label)

"""A matched thermal beam keeps its emittance."""

from __future__ import annotations

from collections.abc import Mapping
from functools import partial
from pathlib import Path

import numpy as np
from mpi4py import MPI

from amrpic.verify.table import Cell, Goal, Table, picture
from exact.channel import CELLS, DEPRESSION, FOCUSING, PERIOD, PIPE, RADIUS, slab, thermal
from exact.runs import states

PARTICLES = 200_000
PERIODS = 100
STEPS = 40  # a period
LEVELS = 2


def table(comm: MPI.Comm) -> Table:
    """Growth of the emittance with refinement and without. Collective."""
    meshes = {f"{LEVELS} refined levels": LEVELS, "base level alone": 0}
    found = {name: _emittances(comm, levels) for name, levels in meshes.items()}
    width = 2 * PIPE / CELLS[0]
    rows: list[list[Cell]] = []
    for name, levels in meshes.items():
        growth = float(np.abs(found[name] - 1).max())
        rows.append(
            [name, RADIUS / width * 2**levels, Goal(growth, 0.01) if levels else growth, float(found[name][-1] - 1)]
        )
    return Table(
        "Emittance of a matched thermal beam",
        f"Slab of {PARTICLES} electrons in thermal equilibrium with constant focusing and their own field, tune depression "
        f"{DEPRESSION}, over {PERIODS} periods of the focusing in steps of 1/{STEPS} of one, in a square grounded pipe of a "
        "half width of 12 rms sizes: largest change, and change at the end, of the mean of both transverse emittances.",
        ("mesh", "cells in two rms sizes", "largest", "at the end"),
        rows,
        upwards="emittance over that at the start",
        picture=partial(_draw, found),
    )


def _emittances(comm: MPI.Comm, levels: int) -> np.ndarray:
    """Mean of the emittances along x and y over that at the start, after each period, (n,)."""
    scene = slab([thermal(PARTICLES)], [FOCUSING], PERIOD / STEPS, STEPS * PERIODS, levels)
    found = [state.moments().emittance[:2].mean() for state in states(comm, scene) if state.step % STEPS == 0]
    return np.array(found) / found[0]


def _draw(found: Mapping[str, np.ndarray], path: Path) -> None:
    with picture(path, "Emittance of a matched thermal beam", "periods", "emittance over that at the start") as axes:
        for name, values in found.items():
            axes.plot(range(len(values)), values, linewidth=1, label=name)

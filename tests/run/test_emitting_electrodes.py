"""Electrodes that emit: area and normals of their surface, and the currents of Langmuir and Blodgett."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
from mpi4py import MPI
from test_births import ordered

from amrpic.errors import SceneError
from amrpic.pic.simulation import Simulation
from amrpic.scene.scene import Scene
from amrpic.shapes import Cylinder, Sphere
from amrpic.shapes.scatter import scattered
from amrpic.units import ELECTRON_MASS, ELEMENTARY_CHARGE

VOLTAGE = 100.0
SPEED = math.sqrt(2 * ELEMENTARY_CHARGE / ELECTRON_MASS * VOLTAGE)  # m/s
PERVEANCE = 2.333952e-6  # A/V^(3/2)
CATHODE = 2e-3  # m, radius
COLD: dict[str, Any] = {"kind": "thermal", "energy": f"{2e-6 * VOLTAGE} eV"}


def diode(
    kind: str,
    cells: int,
    source: dict[str, Any],
    ratio: float = 2.0,
    transits: float = 3.0,
    levels: int = 0,
    passage: float = 1.5,
    **changes: Any,
) -> Scene:
    """A cathode in an anode `ratio` times as wide, with so many cells in the gap; of cylinders a period of 4 cells.

    Each of the levels around the cathode is six of its cells deep. A step is the part 1 / `passage` of that in which a cell is
    passed at the anode.
    """
    gap = (ratio - 1) * CATHODE
    width = gap / cells
    half = math.ceil((ratio * CATHODE / width + 2.5) / 2**levels) * width * 2**levels
    number = round(2 * half / width)
    along = 2 * width if kind == "cylinder" else half
    body: dict[str, Any] = {"kind": "sphere", "centre": [0, 0, 0]}
    if kind == "cylinder":
        body = {"kind": "cylinder", "start": [0, 0, -10 * half], "end": [0, 0, 10 * half]}
    hole = {**body, "radius": ratio * CATHODE}
    block = {"kind": "box", "lower": [-2 * half, -2 * half, -5 * half], "upper": [2 * half, 2 * half, 5 * half]}
    dt = width / SPEED / passage
    data: dict[str, Any] = {
        "domain": {
            "lower": [-half, -half, -along],
            "upper": [half, half, along],
            "cells": [number, number, 4 if kind == "cylinder" else number],
            "boundary": {
                "x": "dirichlet",
                "y": "dirichlet",
                "z": "periodic" if kind == "cylinder" else "dirichlet",
            },
        },
        "electrodes": [
            {"name": "cathode", "shape": {**body, "radius": CATHODE}, "voltage": -VOLTAGE},
            {"name": "anode", "shape": {"kind": "difference", "of": [block, hole]}, "voltage": 0},
        ],
        "sources": [{"electrode": "cathode", "momenta": COLD, **source}],
        "refinement": around(levels, width, along if kind == "cylinder" else 0.0),
        "solver": {"tolerance": 1e-4},
        "motion": {"kind": "leapfrog", "dt": dt, "frame": "lab"},
        "schedule": {"steps": int(transits * 3 * gap / SPEED / dt)},
        "output": {"write": []},
    }
    return Scene.from_dict({**data, **changes})


def around(levels: int, width: float, along: float) -> dict[str, Any]:
    """Refinement by levels around the cathode, each six of its cells deep, of a base with cells so wide."""
    boxes = []
    for level in range(1, levels + 1):
        half = CATHODE + 6 * width / 2**level
        corner = [half, half, along or half]
        boxes.append({"level": level, "lower": [-x for x in corner], "upper": corner})
    rule = {"rule": {"kind": "static", "boxes": boxes}} if levels else {}
    return {"levels": levels, "regrid_every": 0, "blocking_factor": 2, "buffer": 0, **rule}


LIMITED = {"process": "space-charge-limited", "per_face": 1}


def current(scene: Scene) -> tuple[float, Simulation]:
    """Current at the anode over the last third of a run, A, and the run."""
    run, rows = Simulation(MPI.COMM_SELF, scene), []
    for state in run:
        anode = state.lost.names.index("anode")
        arrived = state.lost.particles.select(np.flatnonzero(state.lost.cause == anode))
        rows.append((state.time, arrived.own_charge))
    time, charge = np.array(rows[len(rows) * 2 // 3 :]).T
    return float(-np.polyfit(time, charge, 1)[0]), run


def test_points_are_as_many_as_the_area_asks_for():
    ball, rod = Sphere((0, 0, 0), 2e-3), Cylinder((0, 0, -1e-2), (0, 0, 1e-2), 1e-3)
    for shape, lower, upper, area in (
        (ball, -1, 1, 4 * math.pi * 4e-6),
        (ball, [-1, -1, 0], [1, 1, 1], 2 * math.pi * 4e-6),
        (rod, [-1, -1, -1e-3], [1, 1, 1e-3], 2 * math.pi * 1e-3 * 2e-3),
    ):
        points = scattered(shape, np.broadcast_to(lower, 3), np.broadcast_to(upper, 3), 1e-4)
        assert points.area.sum() == pytest.approx(area, rel=0.005)
        across = points.place * (1, 1, 0 if shape is rod else 1)
        np.testing.assert_allclose(points.normal, across / np.linalg.norm(across, axis=1)[:, None], atol=1e-9)


@pytest.mark.parametrize("kind", ["cylinder", "sphere"])
def test_the_field_at_a_surface_follows_from_that_in_front_of_it(kind):
    run = Simulation(MPI.COMM_SELF, diode(kind, 8, {**LIMITED, "start": "1 s"}))
    layer = run.state.solution.layers["cathode"]
    exact = -VOLTAGE / CATHODE * (1 / math.log(2) if kind == "cylinder" else 2.0)
    assert layer.at_wall.mean() == pytest.approx(exact, rel=0.02)
    assert layer.at_wall.std() < 0.03 * abs(exact)


@pytest.mark.long
@pytest.mark.parametrize(
    ("kind", "ratio", "cells", "levels", "exact", "warm"),
    [
        ("cylinder", 2, 12, 0, 0.279267, 1.0032),
        ("sphere", 2, 8, 0, 0.326042, 1.0029),
        ("cylinder", 10, 18, 2, 0.978186, 1.0020),
        ("sphere", 10, 18, 2, 1.777056, 1.0017),
    ],
)
def test_a_round_cathode_has_the_current_of_langmuir_and_blodgett(kind, ratio, cells, levels, exact, warm):
    """β² and α² for an anode 2 and 10 times as wide, with levels at the latter's cathode, and what a start as warm adds, by
    Poisson's equation along r. The few patches of a cathode want four particles each, or the current swings."""
    transits, passage = (1.5, 3.0) if ratio > 2 else (3.0, 1.5)
    scene = diode(kind, cells, {**LIMITED, "per_face": 4}, ratio, transits, levels, passage)
    amount, run = current(scene)
    length = scene.domain.upper[2] - scene.domain.lower[2]
    of_unit = length / (ratio * CATHODE) if kind == "cylinder" else 2
    assert amount / (2 * math.pi * PERVEANCE * VOLTAGE**1.5 / exact * of_unit) == pytest.approx(warm, rel=0.01)
    tally, lost = run.state.tallies.of[0], run.lost.particles.own_charge
    assert abs(run.particles.own_charge + lost - tally.charge) < 1e-13 * abs(tally.charge)


def test_a_given_charge_leaves_all_of_a_surface_along_its_normals():
    momenta = {"kind": "beam", "energy": "100 eV"}
    source = {"process": "given", "charge": -1e-20, "particles": 4000, "pulse": {"shape": "flat", "length": "20 ps"}}
    scene = diode("sphere", 8, {**source, "momenta": momenta}, schedule={"steps": 2})
    data = scene.to_dict()
    run = Simulation(
        MPI.COMM_SELF, Scene.from_dict({**data, "electrodes": [{**e, "voltage": 0} for e in data["electrodes"]]})
    )
    run.advance(2)
    place, momentum = run.particles.position, run.particles.momentum
    assert len(place) == 4000
    cosine = (place * momentum).sum(axis=1) / np.linalg.norm(place, axis=1) / np.linalg.norm(momentum, axis=1)
    assert cosine.min() > 0.999
    assert np.linalg.norm(place.mean(axis=0)) < 0.05 * CATHODE


@pytest.mark.mpi(ranks=(1, 2), timeout=600)
def test_emission_from_metal_restarts_bit_by_bit_and_is_the_same_on_any_ranks(comm, tmp_path):
    folder = comm.bcast(tmp_path)
    scene = diode("cylinder", 8, LIMITED, solver={"tolerance": 1e-12})
    whole, alone = Simulation(comm, scene), Simulation(MPI.COMM_SELF, scene)
    whole.advance(10), alone.advance(20)
    whole.checkpoint(folder / "half")
    rest = Simulation.restart(comm, folder / "half")
    whole.advance(10), rest.advance(10)
    for name in ("position", "momentum", "weight", "id"):
        np.testing.assert_array_equal(getattr(rest.particles, name), getattr(whole.particles, name))
    one, many = ordered(MPI.COMM_SELF, alone), ordered(comm, whole)
    np.testing.assert_array_equal(many[:, 0], one[:, 0])
    for column in range(1, 8):
        np.testing.assert_allclose(many[:, column], one[:, column], rtol=0, atol=1e-9 * np.abs(one[:, column]).max())


@pytest.mark.parametrize(
    ("source", "words"),
    [
        ({"electrode": "cathod"}, "names no electrode"),
        ({"face": "x_lower"}, "is given as well as electrode"),
        ({"spot": {"shape": "disc", "radius": 1e-3}}, "no part of an electrode"),
    ],
)
def test_bad_sources_on_electrodes_are_refused_in_one_sentence(source, words):
    with pytest.raises(SceneError) as refused:
        diode("cylinder", 8, {**LIMITED, **source})
    text = str(refused.value)
    assert words in text and "sources.0" in text and "; " in text and "\n" not in text

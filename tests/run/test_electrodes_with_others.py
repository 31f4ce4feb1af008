"""Electrodes in whole runs with several other features at a time, drawn at random: a restart goes on bit by bit, and ranks
change the last digits at most.
"""

from __future__ import annotations

import secrets
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from mpi4py import MPI
from test_births import ordered

from amrpic.pic.simulation import Simulation
from amrpic.scene.scene import Scene

BEAM: dict[str, Any] = {
    "distribution": "gaussian",
    "species": "electron",
    "sigma": 1.5e-3,
    "cutoff": 3,
    "centre": [0, 0, -7e-3],
    "velocity": [0, 0, 3e6],
    "charge": -2e-13,
    "particles": 600,
}
PULSE = {"shape": "flat", "length": "0.6 ns"}
THERMAL = {"kind": "thermal", "energy": "1 eV"}
BESIDE = [-7e-3, -7e-3, -7e-3]  # m, of beams that must not meet the ball


def plain() -> dict[str, Any]:
    """A bunch that flies onto a ball in a grounded box."""
    return {
        "domain": {"lower": -0.014, "upper": 0.014, "cells": 14, "boundary": "dirichlet"},
        "bunches": [dict(BEAM)],
        "electrodes": [{"name": "ball", "shape": {"kind": "sphere", "centre": [0, 0, 6e-3], "radius": 4e-3}, "voltage": -100}],
        "sources": [],
        "motion": {"kind": "leapfrog", "dt": 1e-10},
        "schedule": {"steps": 8},
        "solver": {"tolerance": 1e-12},
        "output": {"write": []},
    }  # fmt: skip


def emits(scene: dict[str, Any]) -> None:
    wall = {"process": "space-charge-limited", "supply": "2 A/m^2", "per_face": 1, "momenta": THERMAL}
    scene["sources"].append({"electrode": "ball", **wall})


def is_a_photocathode(scene: dict[str, Any]) -> None:
    given = {"process": "given", "charge": -1e-13, "particles": 400, "pulse": PULSE, "momenta": THERMAL}
    scene["sources"].append({"electrode": "ball", **given})


def emits_into_a_mesh_that_comes_later(scene: dict[str, Any]) -> None:
    emits(scene)
    rule = {"kind": "charge-density", "relative": 0.01}
    scene["bunches"] = []
    scene["refinement"] = {"levels": 1, "regrid_every": 2, "blocking_factor": 2, "rule": rule}


def stands_beside_a_wall_that_emits(scene: dict[str, Any]) -> None:
    given = {"process": "given", "charge": -1e-13, "particles": 300, "pulse": PULSE, "momenta": THERMAL}
    scene["sources"].append({"face": "z_lower", **given})


def varies(scene: dict[str, Any]) -> None:
    scene["electrodes"][0]["voltage"] = "-100 V*cos(2*pi*100 MHz*t)"


def has_steps_that_grow(scene: dict[str, Any]) -> None:
    scene["motion"] |= {"growth": 0.05, "longest": 2 * scene["motion"]["dt"]}


def is_on_two_levels(scene: dict[str, Any]) -> None:
    rule = {"kind": "charge-density", "relative": 0.1}
    scene["refinement"] = {"levels": 1, "regrid_every": 2, "blocking_factor": 4, "max_grid_size": 8, "rule": rule}


def is_on_levels_of_its_own(scene: dict[str, Any]) -> None:
    is_on_two_levels(scene)
    scene["refinement"]["rule"] = {"kind": "any", "of": [{"kind": "conductors"}, scene["refinement"]["rule"]]}


def stands_beside_one_that_floats(scene: dict[str, Any]) -> None:
    ball = {"kind": "sphere", "centre": [8e-3, 8e-3, -2e-3], "radius": 3e-3}
    scene["electrodes"].append({"name": "free", "shape": ball, "charge": 1e-13})


def stands_in_rows_of_images(scene: dict[str, Any]) -> None:
    scene["domain"]["boundary"] = {"x": "periodic", "y": "dirichlet", "z": "open"}


def stands_beside_open_faces(scene: dict[str, Any]) -> None:
    scene["domain"]["boundary"] = {"x": "open", "y": "open", "z": ["dirichlet", "open"]}


def is_passed_by_fast_charge(scene: dict[str, Any]) -> None:
    scene["domain"]["boundary"] = "open"
    scene["bunches"][:1] = [{**BEAM, "velocity": [0, 0, v], "centre": BESIDE, "particles": 300} for v in (8e7, 1.6e8)]
    scene["motion"]["dt"] /= 20


def stands_in_a_lattice(scene: dict[str, Any]) -> None:
    scene["elements"] = [{"kind": "constant-focusing", "gradient": [0, 0, -1e6]}]


def is_seen_from_a_window(scene: dict[str, Any]) -> None:
    scene["domain"]["boundary"] = "open"
    scene["motion"]["window"] = "reference"


FEATURES = (
    emits, is_a_photocathode, emits_into_a_mesh_that_comes_later, stands_beside_a_wall_that_emits, varies,
    has_steps_that_grow, is_on_two_levels, is_on_levels_of_its_own, stands_beside_one_that_floats,
    stands_in_rows_of_images, stands_beside_open_faces, is_passed_by_fast_charge, stands_in_a_lattice,
    is_seen_from_a_window,
)  # fmt: skip
# What is refused together, in one sentence, or leaves no bunch of a window's or of fast charge.
APART = (
    {emits, is_seen_from_a_window},
    {is_a_photocathode, is_seen_from_a_window},
    {emits_into_a_mesh_that_comes_later, is_seen_from_a_window},
    {emits_into_a_mesh_that_comes_later, is_passed_by_fast_charge},
    {stands_beside_a_wall_that_emits, is_seen_from_a_window},
    {stands_beside_one_that_floats, is_passed_by_fast_charge},
)


def drawn(rng: np.random.Generator, count: int) -> tuple[Callable[[dict[str, Any]], None], ...]:
    """Return features that go together, in the order above."""
    while True:
        some = {FEATURES[n] for n in rng.choice(len(FEATURES), count, replace=False)}
        if not any(apart <= some for apart in APART):
            return tuple(feature for feature in FEATURES if feature in some)


def check(comm: Any, folder: Any, seed: int, count: int) -> None:
    """Run a drawn scene on all ranks, from its middle again, and on each rank alone."""
    data, features = plain(), drawn(np.random.default_rng(seed), count)
    for feature in features:
        feature(data)
    names = f"seed {seed}: a ball that " + ", ".join(feature.__name__ for feature in features)
    scene = Scene.from_dict(data)
    whole, alone = Simulation(comm, scene), Simulation(MPI.COMM_SELF, scene)
    whole.advance(4), alone.advance(8)
    whole.checkpoint(folder / "half")
    rest = Simulation.restart(comm, folder / "half")
    whole.advance(4), rest.advance(4)
    many, again, one = ordered(comm, whole), ordered(comm, rest), ordered(MPI.COMM_SELF, alone)
    assert np.array_equal(many, again), names
    charges, *others = (run.state.solution.charges for run in (alone, whole, rest))
    assert others[0] == others[1], names
    most = max(map(abs, charges.values()))
    assert all(abs(others[0][name] - charges[name]) < 1e-7 * most for name in charges), names
    np.testing.assert_array_equal(many[:, 0], one[:, 0], names)
    np.testing.assert_array_less(abs(many - one).max(axis=0), 1e-8 * abs(one).max(axis=0) + 1e-300, names)


@pytest.mark.mpi(ranks=2, timeout=300)
@pytest.mark.parametrize("seed", [1, 2])
def test_a_few_draws(comm, tmp_path, seed):
    check(comm, comm.bcast(tmp_path), seed, 3)


@pytest.mark.long
@pytest.mark.mpi(ranks=2, timeout=3000)
def test_fifty_draws(comm, tmp_path):
    first = comm.bcast(secrets.randbelow(10**6))
    for seed in range(first, first + 50):
        check(comm, comm.bcast(tmp_path) / str(seed), seed, 3)

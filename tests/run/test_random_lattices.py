"""Random beam lines: what holds for any of them, whatever elements, windows and steps they have."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from mpi4py import MPI

import amrpic
from amrpic.units import PROTON_MASS, SPEED_OF_LIGHT

MC = PROTON_MASS * SPEED_OF_LIGHT
CASES = 30
STEPS = 6
HALF = 0.03  # m, of the domain across


def element(rng: np.random.Generator, electric: bool) -> dict[str, Any]:
    """An element of a random kind, place, direction and strength."""
    length = min(float(rng.uniform(0.005, 0.08)), 1.8 * HALF)  # less than a period, in which it may repeat
    tilt = np.add(rng.normal(0, 0.15, 3), (0, 0, rng.choice([1, 1, -1])))
    placed = {
        "centre": [*rng.normal(0, 2e-3, 2).tolist(), float(rng.uniform(-0.05, 0.15))],
        "direction": tilt.tolist(),
        "roll": float(rng.uniform(-3, 3)),
    }
    enge = {"fringe": "enge", "gap": float(rng.uniform(0.005, 0.02))} if rng.random() < 0.4 else {}
    magnets = [
        {"kind": "quadrupole", "gradient": float(rng.normal(0, 3)), "length": length, **enge},
        {"kind": "solenoid", "field": float(rng.normal(0, 0.2)), "length": length},
        {"kind": "solenoid", "field": float(rng.normal(0, 0.2)), "length": length, "fringe": "sheet", "radius": 0.05},
        {"kind": "dipole", "field": float(rng.normal(0, 0.1)), "length": length,
         "entrance_angle": float(rng.uniform(-0.3, 0.3)), "exit_angle": float(rng.uniform(-0.3, 0.3)), **enge},
        {"kind": "uniform", "magnetic_field": rng.normal(0, 0.05, 3).tolist()},
    ]  # fmt: skip
    fields = [
        {"kind": "uniform", "electric_field": rng.normal(0, 1e5, 3).tolist(), "length": length},
        {"kind": "constant-focusing", "gradient": rng.normal(0, 1e7, 3).tolist()},
        {"kind": "rf-gap", "length": length, "voltage": 2e4, "frequency": 3e8, "phase": float(rng.uniform(-3, 3))},
        {"kind": "cavity", "length": length, "field": 1e6, "frequency": 3e8},
    ]
    kinds = magnets + fields if electric else magnets
    return {**kinds[rng.integers(len(kinds))], **placed}


def case(number: int) -> tuple[dict[str, Any], bool]:
    """A scene, and whether it has magnetic fields alone."""
    rng = np.random.default_rng([20, number])
    electric = bool(rng.random() < 0.6)
    beta_gamma = float(rng.uniform(0.02, 0.09))
    speed = beta_gamma / np.hypot(1, beta_gamma) * SPEED_OF_LIGHT
    boundary: Any = [{"z": "periodic", "x": "dirichlet", "y": "dirichlet"}, "open", "open"][rng.integers(3)]
    count = int(rng.integers(20, 60))
    bunch = {
        "distribution": "arrays",
        "position": (rng.normal(0, 1, (count, 3)) * [3e-3, 3e-3, 6e-3]).tolist(),
        "momenta": (np.add(rng.normal(0, 0.02, (count, 3)), (0, 0, 1)) * beta_gamma * MC).tolist(),
        "charge": float(rng.choice([1e-12, 1e-10])) if electric else 1e-30,
    }
    window = {"window": "reference", "reference": {"momentum": [0, 0, beta_gamma * MC]}} if rng.random() < 0.6 else {}
    made = {
        "seed": number,
        "domain": {"lower": -HALF, "upper": HALF, "cells": 8, "boundary": boundary},
        "bunches": [bunch],
        "elements": [element(rng, electric) for _ in range(rng.integers(1, 6))],
        "apertures": [{"kind": "round", "centre": [0, 0, 0.05], "length": "1 cm", "radius": "6 mm"}] * int(rng.random() < 0.5),
        "screens": [{"name": "s", "z": float(rng.uniform(-0.02, 0.1))}],
        "refinement": {"levels": int(rng.integers(2)), "regrid_every": 2},
        "solver": {"tolerance": 1e-12},
        "motion": {
            "kind": "leapfrog",
            "dt": float(rng.uniform(0.005, 0.03)) / speed,
            "pusher": str(rng.choice(["boris", "higuera-cary"])),
            **window,
        },
        "schedule": {"steps": STEPS},
        "output": {"write": []},
    }  # fmt: skip
    return made, not electric


def run(comm: Any, made: dict[str, Any], half: Path | None = None, at: int = 0) -> amrpic.Simulation:
    """A run to its end, with a checkpoint on the way."""
    simulation = amrpic.Simulation(comm, amrpic.Scene.from_dict(made))
    if half is not None:
        simulation.on_step(lambda now: now.checkpoint(half) if now.step == at else None)
    simulation.run()
    return simulation


def gathered(simulation: amrpic.Simulation, record: str) -> tuple[np.ndarray, np.ndarray]:
    """Ids, and places over the domain's half width, momenta over m c and times over the end's, sorted by ids and times."""
    held = getattr(simulation, record)
    particles = held if record == "particles" else held.particles
    time = np.zeros(len(particles)) if record == "particles" else held.time / simulation.time
    mine = np.column_stack([particles.position / HALF, particles.momentum / MC, time])
    ids = np.concatenate(simulation.comm.allgather(np.array(particles.id)))
    values = np.concatenate(simulation.comm.allgather(mine))
    order = np.lexsort((values[:, 6], ids))
    return ids[order], values[order]


@pytest.mark.mpi(ranks=2)
@pytest.mark.parametrize("number", range(0, CASES, 2))
def test_random_lattices_on_two_ranks(comm, tmp_path, number):
    laws_hold(comm, tmp_path, number)


@pytest.mark.mpi(ranks=3)
@pytest.mark.parametrize("number", range(1, CASES, 2))
def test_random_lattices_on_three_ranks(comm, tmp_path, number):
    laws_hold(comm, tmp_path, number)


def laws_hold(comm: Any, folder: Path, number: int) -> None:
    """Nothing is made or vanishes, restarts go on bit by bit, one rank finds the same, and magnetic fields keep |p|."""
    made, magnetic = case(number)
    middle = int(np.random.default_rng(number).integers(1, STEPS))
    simulation = run(comm, made, folder / "half", middle)
    left, lost = (gathered(simulation, record)[0] for record in ("particles", "lost"))
    assert np.array_equal(np.sort(np.concatenate([left, lost])), np.arange(len(made["bunches"][0]["position"])))
    again = amrpic.Simulation.restart(comm, folder / "half")
    again.run()
    for record in ("particles", "lost", "screens"):
        for one, other in zip(gathered(simulation, record), gathered(again, record), strict=True):
            assert np.array_equal(one, other), record
    if magnetic:
        start = np.linalg.norm(made["bunches"][0]["momenta"], axis=1) / MC
        for record in ("particles", "lost", "screens"):
            ids, values = gathered(simulation, record)
            size = np.linalg.norm(values[:, 3:6], axis=1)
            # a record's momentum is on the chord from the step's start to its middle, and shorter by the square of its turn
            tolerance = 1e-12 if record == "particles" else 2e-2
            np.testing.assert_allclose(size, start[ids], rtol=tolerance, atol=1e-15, err_msg=record)
    if comm.size > 1 and comm.rank == 0:
        alone = run(MPI.COMM_SELF, made)
        mine = [gathered(alone, record) for record in ("particles", "lost", "screens")]
    else:
        mine = None
    ours = [gathered(simulation, record) for record in ("particles", "lost", "screens")]
    for (ids, values), (expected, wanted) in zip(ours, mine or ours, strict=True):
        assert np.array_equal(ids, expected)
        np.testing.assert_allclose(values, wanted, rtol=0, atol=1e-10)

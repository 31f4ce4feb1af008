"""Runs whose particles are deposited while others come from other ranks: the same field, and the same bits after a restart."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from amrpic.pic import flight
from amrpic.pic.simulation import Simulation
from amrpic.scene.scene import Scene
from amrpic.stages.deposit import Deposition

STEPS, HALF = 5, 3
LEAPFROG = {"kind": "leapfrog", "dt": "60 ps"}
WALK = {"kind": "random-walk", "amplitude": "0.5 mm"}


def scene(motion: dict[str, Any], interface: str) -> Scene:
    """A dense ball that drifts across the ranks' boxes, on a mesh that follows it every other step."""
    return Scene.from_dict(
        {
            "domain": {"lower": "-10 mm", "upper": "10 mm", "cells": 16, "boundary": "dirichlet"},
            "bunches": [
                {"distribution": "waterbag", "species": "electron", "sigma": "1.5 mm", "charge": "-1 pC",
                 "particles": 60_000, "velocity": [0, 0, "0.03 c"], "centre": [0, 0, "-3 mm"]},
            ],
            "refinement": {"levels": 1, "max_grid_size": 8, "blocking_factor": 4, "regrid_every": 2,
                           "rule": {"kind": "charge-density", "relative": 0.05}},
            "particles": {"interface": interface},
            "motion": motion,
            "schedule": {"steps": STEPS},
            "output": {"write": []},
        }
    )  # fmt: skip


def everything(simulation: Simulation) -> dict[str, np.ndarray]:
    """Particles and fields of this rank."""
    particles, levels = simulation.particles, range(simulation.hierarchy.levels)
    fields = {"rho": simulation.rho, "phi": simulation.phi}
    return {
        "position": particles.position,
        "momentum": particles.momentum,
        "id": particles.id,
        **{name: np.concatenate([field.array(level) for level in levels]) for name, field in fields.items()},
    }


@pytest.fixture
def begun(monkeypatch) -> list[tuple[int, int, int]]:
    """Particles of this rank, those that came to it, and those that waited for these, of each deposit that begins early."""
    found: list[tuple[int, int, int]] = []

    class Watched(Deposition):
        def begin(self, migration):
            super().begin(migration)
            found.append((len(self._particles), migration.from_others, self.left))

    monkeypatch.setattr(flight, "Deposition", Watched)
    return found


@pytest.mark.mpi(ranks=(1, 2, 3), timeout=120)
@pytest.mark.parametrize("interface", ["own-level", "matched"])
@pytest.mark.parametrize("motion", [LEAPFROG, WALK], ids=lambda motion: motion["kind"])
def test_a_run_goes_on_bit_by_bit_from_the_midst(comm, tmp_path, begun, motion, interface):
    given = scene(motion, interface)
    simulation = Simulation(comm, given)
    simulation.on_step(lambda now: now.checkpoint(tmp_path / "half") if now.step == HALF else None)
    simulation.run()
    of_all = comm.allreduce(np.array(begun)).reshape(-1, 3)
    assert len(of_all) == sum(step % 2 for step in range(1, STEPS + 1))  # those without a new mesh
    for all_, came, waited in of_all.tolist():
        assert all_ > 50_000 and waited < all_ / 2 and (came > 100) == (comm.size > 1)
    again = Simulation.restart(comm, tmp_path / "half")
    again.run()
    for name, values in everything(simulation).items():
        assert np.array_equal(values, everything(again)[name]), name


@pytest.mark.mpi(ranks=(2, 3), timeout=120)
def test_a_run_is_that_which_deposits_all_particles_at_once(comm, begun, monkeypatch):
    given = scene(LEAPFROG, "own-level")
    simulation = Simulation(comm, given)
    simulation.run()
    assert len(begun) > 0
    monkeypatch.setattr(Deposition, "begin", lambda self, migration: None)
    at_once = Simulation(comm, given)
    at_once.run()
    one, other = everything(simulation), everything(at_once)
    assert np.array_equal(one["id"], other["id"])
    for name in ("position", "momentum", "rho", "phi"):
        scale = comm.allreduce(np.abs(other[name]).max(initial=0))
        assert np.abs(one[name] - other[name]).max(initial=0) < 1e-7 * scale, name

"""Which clouds a run takes at coarse-fine faces, and what that does to a particle there."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from amrpic.particles.clouds import matched_pays
from amrpic.pic.simulation import Simulation
from amrpic.scene.scene import Scene

CELL = 1 / 16  # m, of the finest level


def gaussian(number: int, size: float, **more: Any) -> dict[str, Any]:
    """A bunch of so many particles, σ in cells of the finest level."""
    return {"distribution": "gaussian", "sigma": size * CELL, "charge": "1 pC", "particles": number, **more}


def scene(bunches: list[dict[str, Any]], interface: str = "auto", **changes: Any) -> Scene:
    """A refined cube in the middle of free space, and bunches."""
    data: dict[str, Any] = {
        "domain": {"lower": -0.5, "upper": 0.5, "cells": 8},
        "bunches": bunches,
        "refinement": {
            "levels": 1,
            "blocking_factor": 4,
            "rule": {"kind": "static", "boxes": [{"level": 1, "first": 4, "last": 11}]},
        },
        "particles": {"interface": interface},
        "output": {"write": []},
    }
    return Scene.from_dict({**data, **changes})


def test_matched_clouds_are_for_few_particles_in_a_large_bunch():
    ten_cells = np.full(3, 10.0)
    assert matched_pays(14_000, ten_cells) and not matched_pays(14_001, ten_cells)
    flat, line = np.array([0.01, 10, 20]), np.array([0.01, 0.5, 20])
    assert matched_pays(28_000, flat) and not matched_pays(28_001, flat)
    assert matched_pays(2_800, line) and not matched_pays(2_801, line)
    assert matched_pays(1, np.zeros(3))
    assert not matched_pays(0, ten_cells)


@pytest.mark.mpi(ranks=(1, 2))
def test_auto_looks_at_each_bunch_and_says_what_it_took(comm, capsys):
    many, few = gaussian(1500, 1.5), gaussian(100, 1.5)  # 140 (σ/h)² is 315
    for bunches, taken in (([many], "own-level"), ([few], "matched"), ([many, few], "matched"), ([], "own-level")):
        simulation = Simulation(comm, scene(bunches))
        assert simulation.scene.particles.interface == taken
        simulation.run()
        logged = capsys.readouterr().out
        assert logged.count(f"particles.interface: {taken} clouds, because ") == (comm.rank == 0)
    # as one bunch they would be too wide for their number
    train = gaussian(400, 1, centres=[[-0.2] * 3, [0.2] * 3])
    assert Simulation(comm, scene([train])).scene.particles.interface == "own-level"


@pytest.mark.mpi(ranks=(1, 2))
def test_interface_is_as_asked_for_and_stays_so_over_a_restart(comm, tmp_path, capsys):
    for interface in ("matched", "own-level"):
        assert Simulation(comm, scene([gaussian(9, 1)], interface)).scene.particles.interface == interface
    unrefined = Simulation(comm, scene([gaussian(9, 1)], refinement={"blocking_factor": 4}))
    assert unrefined.scene.particles.interface == "own-level"
    unrefined.run()
    assert "interface" not in capsys.readouterr().out

    simulation = Simulation(comm, scene([gaussian(9, 1)]))
    simulation.checkpoint(tmp_path / "kept")
    for given in (None, scene([gaussian(9, 1)])):
        assert Simulation.restart(comm, tmp_path / "kept", given).scene.particles.interface == "matched"


@pytest.mark.mpi(ranks=(1, 2))
def test_run_with_matched_clouds_goes_on_bit_by_bit_after_a_restart(comm, tmp_path):
    given = scene([gaussian(200, 3)], motion={"kind": "leapfrog", "dt": 2e-7}, schedule={"steps": 3})
    simulation = Simulation(comm, given)
    simulation.on_step(lambda now: now.checkpoint(tmp_path / "first") if now.step == 1 else None)
    simulation.run()
    again = Simulation.restart(comm, tmp_path / "first")
    again.run()
    assert again.scene.particles.interface == "matched"
    assert np.array_equal(again.particles.id, simulation.particles.id)
    assert np.array_equal(again.particles.momentum, simulation.particles.momentum)
    assert simulation.lost.particles.global_count(comm) < 200


@pytest.mark.mpi(ranks=(1, 2))
@pytest.mark.parametrize("shape", ["nearest-grid-point", "cloud-in-cell", "triangular-shaped-cloud"])
def test_particle_at_a_face_hardly_pushes_itself_in_a_run(comm, shape):
    """Measured: own-level 0.15 to 0.6 of q²/(4πε₀h²), matched 0.0007 to 0.01."""
    position = np.array([[-0.25 + CELL / 2, 0.01, 0.02]])
    bunch = {"distribution": "arrays", "position": position, "charge": "1 pC"}
    dt, size = 1e-9, 1e-12**2 * 8.9875517923e9 / CELL**2

    def force(interface: str) -> float:
        """Return the force of the particle on itself, in q²/(4πε₀h²)."""
        given = scene(
            [bunch],
            particles={"shape": shape, "interface": interface},
            motion={"kind": "leapfrog", "dt": dt},
            schedule={"steps": 1},
        )
        simulation = Simulation(comm, given)
        staggered = simulation.state.staggered
        felt = (staggered.moved.momentum - simulation.particles.momentum) / (
            simulation.particles.charge[:, None] * dt / 2
        )
        return float(comm.allreduce(np.abs(felt).sum())) * 1e-12 / size

    assert force("own-level") > 0.1
    assert force("auto") == force("matched") < 0.012

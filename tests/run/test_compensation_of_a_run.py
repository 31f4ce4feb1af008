"""Which compensation a run takes, that it says so, and that it goes on the same after a restart."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from amrpic.particles.clouds import PAYING, SHAPES, compensation_pays
from amrpic.pic.simulation import Simulation
from amrpic.scene.scene import Scene
from amrpic.stages.diagnostics import potential_energy

CELL = 1 / 16  # m


def scene(numbers: list[int], compensation: str = "auto", **changes: Any) -> Scene:
    """Bunches of so many electrons with σ of two cells in free space, which move."""
    bunch = {
        "distribution": "gaussian",
        "species": "electron",
        "sigma": 2 * CELL,
        "charge": "-1 pC",
        "sampling": "sobol",
    }
    data: dict[str, Any] = {
        "domain": {"lower": -1, "upper": 1, "cells": 32},
        "bunches": [{**bunch, "particles": number} for number in numbers],
        "particles": {"shape": "triangular-shaped-cloud", "compensation": compensation},
        "motion": {"kind": "leapfrog", "dt": 1e-9},
        "schedule": {"steps": 3},
        "output": {"write": []},
    }
    return Scene.from_dict({**data, **changes})


@pytest.mark.parametrize("shape", SHAPES)
def test_compensation_is_for_many_particles_per_cell_beside_the_square_of_the_width(shape):
    for width in (2.0, 4.0, 8.0):
        number = PAYING[shape] * width**2 * (2 * np.pi) ** 1.5 * width**3
        assert compensation_pays(1.001 * number, np.full(3, width), shape)
        assert not compensation_pays(0.999 * number, np.full(3, width), shape)
    flat = np.array([2.0, 8.0, 8.0])  # its thickness counts, and its density
    number = PAYING[shape] * 4 * (2 * np.pi) ** 1.5 * 128
    assert compensation_pays(1.001 * number, flat, shape) and not compensation_pays(0.999 * number, flat, shape)


@pytest.mark.mpi(ranks=(1, 2))
def test_auto_looks_at_each_bunch_and_says_what_it_took(comm, capsys):
    limit = PAYING["triangular-shaped-cloud"] * 4 * (2 * np.pi) ** 1.5 * 8
    many, few = int(1.2 * limit), int(0.8 * limit)
    for numbers, taken in (([many], "clouds"), ([few], "none"), ([many, few], "none")):
        simulation = Simulation(comm, scene(numbers))
        assert simulation.scene.particles.compensation == taken
        simulation.run()
        assert capsys.readouterr().out.count(f"particles.compensation: {taken}, because ") == (comm.rank == 0)
    resting = Simulation(comm, scene([many], motion={"kind": "none"}, schedule={}))
    assert resting.scene.particles.compensation == "none"
    assert "compensation" not in capsys.readouterr().out


@pytest.mark.mpi(ranks=(1, 2))
@pytest.mark.parametrize("compensation", ["clouds", "clouds-and-mesh"])
def test_compensated_run_goes_on_bit_by_bit_after_a_restart(comm, tmp_path, compensation):
    simulation = Simulation(comm, scene([500], compensation))
    simulation.on_step(lambda now: now.checkpoint(tmp_path / "first") if now.step == 1 else None)
    simulation.run()
    for given in (None, scene([500], "auto")):
        again = Simulation.restart(comm, tmp_path / "first", given)
        assert again.scene.particles.compensation == compensation
        again.run()
        assert np.array_equal(again.particles.id, simulation.particles.id)
        assert np.array_equal(again.particles.momentum, simulation.particles.momentum)
    plain = Simulation(comm, scene([500], "none"))
    plain.run()
    assert not np.array_equal(plain.particles.momentum, simulation.particles.momentum)


def test_potential_energy_is_that_in_the_potential_which_particles_feel():
    """It is that of the particles in φ + κρ: ∫ κρ²/2 more."""
    from mpi4py import MPI

    state = Simulation(MPI.COMM_SELF, scene([3000], "clouds")).state
    compensation = state.efield.compensation
    assert compensation is not None
    with_it = potential_energy(state.rho, state.phi, compensation)
    square = sum(k * (p.data**2).sum() for k in compensation.strength for p in state.rho.patches) * CELL**3
    assert with_it - potential_energy(state.rho, state.phi) == pytest.approx(square / 2, rel=1e-10)


@pytest.mark.parametrize("compensation", ["clouds", "auto"])
def test_energy_bins_go_without_and_the_run_says_so(tmp_path, capsys, compensation):
    """As a warning where the scene asks for it, as a note where the run itself chose it, also after a restart."""
    from mpi4py import MPI

    number = int(1.2 * PAYING["triangular-shaped-cloud"] * 4 * (2 * np.pi) ** 1.5 * 8)
    beams = [
        {"distribution": "gaussian", "species": "electron", "sigma": 2 * CELL, "charge": "-1 pC", "particles": number}
        | {"momentum": [0, 0, sign * 4 * 2.73092449e-22]}
        for sign in (1, -1)
    ]
    data = scene([1], compensation).to_dict() | {"bunches": beams}
    simulation = Simulation(MPI.COMM_SELF, Scene.from_dict(data))
    assert len(simulation.state.solution.frames.members) == 2
    assert simulation.scene.particles.compensation == "clouds" and simulation.state.efield.compensation is None
    simulation.checkpoint(tmp_path / "start")
    for run in (
        simulation,
        *(Simulation.restart(MPI.COMM_SELF, tmp_path / "start", s) for s in (None, Scene.from_dict(data))),
    ):
        run.run()
        printed = capsys.readouterr()
        warned = "particles.compensation does not act in several energy bins" in printed.out + printed.err
        assert warned == (compensation == "clouds")
        noted = "particles.compensation: none as long as there are several energy bins"
        assert run is not simulation or (noted in printed.out) == (compensation == "auto")
        assert not any("compensation" in remark for remark in run.remarks) or warned

"""Beams of several energies: each part is solved for in a frame of its own."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from mpi4py import MPI

import amrpic
from amrpic.particles.energy_bins import frames_of
from amrpic.particles.motion_of_charge import left, rapidity
from amrpic.units import ELECTRON_MASS, SPEED_OF_LIGHT

MC = ELECTRON_MASS * SPEED_OF_LIGHT


def scene(momenta: list[float], steps: int = 0, bins: Any = "auto", **bunch: Any) -> amrpic.Scene:
    """Gaussian electron bunches in one place with these mean β γ along z."""
    return amrpic.Scene.from_dict(
        {
            "domain": {"lower": [-5e-3] * 3, "upper": [5e-3] * 3, "cells": [16] * 3},
            "bunches": [
                {
                    "distribution": "gaussian",
                    "species": "electron",
                    "charge": -1e-12,
                    "particles": 3000,
                    "sigma": 1e-3,
                    "momentum": [0.0, 0.0, u * MC],
                    "sampling": "halton",
                    **bunch,
                }
                for u in momenta
            ],
            "refinement": {"levels": 1, "regrid_every": 3},
            "motion": {"kind": "leapfrog", "dt": 1e-13, "energy_bins": bins},
            "schedule": {"steps": steps},
            "output": {"write": []},
        }
    )


def frames(given: amrpic.Scene, comm: MPI.Comm = MPI.COMM_SELF) -> Any:
    return amrpic.Simulation(comm, given).state.solution.frames


@pytest.mark.mpi(ranks=(1, 2))
def test_bins_are_as_many_as_the_energies_ask_for(comm):
    assert len(frames(scene([3.0]), comm).members) == 1
    two = frames(scene([3.0, 20.0]), comm)
    assert [round(member.momentum, 6) for member in two.members] == [3.0, 20.0]
    against = frames(scene([-3.0, 3.0]), comm)
    assert [round(member.momentum, 6) for member in against.members] == [-3.0, 3.0]
    mean = (3 / np.hypot(1, 3) + 20 / np.hypot(1, 20)) / 2  # velocity
    assert frames(scene([3.0, 20.0], bins=1), comm).only.momentum == pytest.approx(mean / np.sqrt(1 - mean**2))
    slow = frames(scene([-0.005, 0.005]), comm)  # ± 0.005 c, for which one frame does
    assert slow.only is not None and slow.only.momentum == 0
    wide = scene([10.0], momentum_spread=[0, 0, 2.0 * MC])
    many = frames(wide, comm)
    assert 4 <= len(many.members) <= 16 and list(many.edges) == sorted(many.edges)
    assert all(low.momentum < high.momentum for low, high in zip(many.members, many.members[1:], strict=False))


def test_no_charge_moves_in_its_frame_in_the_mean():
    """And the mean square velocity left in it is that of a plain sum."""
    run = amrpic.Simulation(MPI.COMM_SELF, scene([10.0], momentum_spread=[0.3 * MC, 0, 2.0 * MC]))
    particles, found = run.particles, run.state.solution.frames
    u = particles.momentum / MC
    number = np.searchsorted(found.edges, rapidity(particles, 2), side="right")
    for n, (frame, part) in enumerate(zip(found.members, found.parts(particles), strict=True)):
        own = u[number == n]
        gamma = np.sqrt(1 + (own**2).sum(axis=1))
        assert (own[:, 2] / gamma).mean() == pytest.approx(frame.beta[2], rel=1e-12)
        energy = frame.gamma * (gamma - frame.beta[2] * own[:, 2])  # γ in the frame
        across, along = own[:, 0] / energy, frame.gamma * (own[:, 2] - frame.beta[2] * gamma) / energy
        weight = energy / gamma
        square = [weight @ across**2 / weight.sum(), 0.0, weight @ along**2 / weight.sum()]
        assert left(run.comm, part, frame).square == pytest.approx(square, rel=1e-9, abs=1e-20)
    one = frames_of(run.comm, particles, run.scene.domain.value, "auto", 1)
    assert one.error - one.across > 2 * (found.error - found.across)


@pytest.mark.mpi(ranks=3, more=(2, 4))
def test_the_charge_and_the_motion_of_bins_are_the_same_on_any_ranks(comm):
    given = scene([3.0, 20.0], 7)
    run = amrpic.Simulation(comm, given)
    run.run()
    assert run.rho.integral() == pytest.approx(-2e-12, rel=1e-12)
    alone = amrpic.Simulation(MPI.COMM_SELF, given)
    alone.run()
    order = np.argsort(alone.particles.id)
    mine = np.searchsorted(alone.particles.id[order], run.particles.id)
    scale = np.abs(alone.particles.momentum).max()
    assert np.abs(run.particles.position - alone.particles.position[order][mine]).max(initial=0) < 1e-12
    assert np.abs(run.particles.momentum - alone.particles.momentum[order][mine]).max(initial=0) < 1e-8 * scale


def test_a_run_with_bins_goes_on_bit_by_bit(tmp_path: Path):
    """Also across the step in which they are chosen anew."""
    run = amrpic.Simulation(MPI.COMM_SELF, scene([3.0, 20.0], 13))
    run.run()
    run.checkpoint(tmp_path / "checkpoint")
    again = amrpic.Simulation.restart(MPI.COMM_SELF, tmp_path / "checkpoint", scene([3.0, 20.0], 20))
    assert again.state.solution.frames == run.state.solution.frames
    for axis in range(3):
        for level in range(run.hierarchy.levels):
            found, expected = (one.bfield.components[axis].array(level) for one in (again, run))
            np.testing.assert_array_equal(found, expected)
    again.run()
    whole = amrpic.Simulation(MPI.COMM_SELF, scene([3.0, 20.0], 20))
    whole.run()
    np.testing.assert_array_equal(again.particles.position, whole.particles.position)
    np.testing.assert_array_equal(again.particles.momentum, whole.particles.momentum)


def test_a_choice_of_the_same_bins_keeps_their_frames():
    """And the solver's set-up with them: momenta change by rounding alone from step to step."""
    run, kept = amrpic.Simulation(MPI.COMM_SELF, scene([20.0], 18)), []
    run.on_step(lambda now: kept.append(now.state.solution.frames))
    run.run()
    assert len(kept) == 18 and set(kept) == {kept[0]}

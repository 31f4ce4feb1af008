"""Beams of several energies: each part is solved for in a frame of its own."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from mpi4py import MPI

import amrpic
from amrpic.particles.energy_bins import frames_of
from amrpic.particles.frame import Frame
from amrpic.particles.motion_of_charge import left, rapidity, squares
from amrpic.particles.particles import Particles
from amrpic.particles.species import SPECIES, SpeciesTable
from amrpic.units import ELECTRON_MASS, ELEMENTARY_CHARGE, SPEED_OF_LIGHT

MC = ELECTRON_MASS * SPEED_OF_LIGHT


CHIRP = {
    "kind": "constant-focusing",
    "gradient": [0, 0, 5e11],
}  # V/m²: pulls electrons apart along z, and their energies


def scene(
    momenta: list[float],
    steps: int = 0,
    bins: Any = "auto",
    dt: float = 1e-13,
    elements: tuple[dict[str, Any], ...] = (),
    **bunch: Any,
) -> amrpic.Scene:
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
            "motion": {"kind": "leapfrog", "dt": dt, "energy_bins": bins},
            "elements": list(elements),
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
@pytest.mark.parametrize("elements", [(), (CHIRP,)], ids=["drift", "chirp"])
def test_the_charge_and_the_motion_of_bins_are_the_same_on_any_ranks(comm, elements):
    given = scene([3.0, 20.0], 7, elements=elements)
    run = amrpic.Simulation(comm, given)
    run.run()
    assert run.rho.integral() == pytest.approx(-2e-12, rel=1e-12)
    alone = amrpic.Simulation(MPI.COMM_SELF, given)
    start = alone.state.solution.frames.motion
    alone.run()
    assert (alone.state.solution.frames.motion != start) == bool(elements)
    assert run.state.solution.frames.of == alone.state.solution.frames.of
    order = np.argsort(alone.particles.id)
    mine = np.searchsorted(alone.particles.id[order], run.particles.id)
    scale = np.abs(alone.particles.momentum).max()
    assert np.abs(run.particles.position - alone.particles.position[order][mine]).max(initial=0) < 1e-12
    assert np.abs(run.particles.momentum - alone.particles.momentum[order][mine]).max(initial=0) < 1e-8 * scale


def test_a_run_with_bins_goes_on_bit_by_bit(tmp_path: Path):
    """Also across steps in which they are chosen anew."""
    whole = amrpic.Simulation(MPI.COMM_SELF, scene([3.0, 20.0], 20, elements=(CHIRP,)))
    whole.advance(13)
    whole.checkpoint(tmp_path / "checkpoint")
    again = amrpic.Simulation.restart(MPI.COMM_SELF, tmp_path / "checkpoint")
    before = whole.state.solution.frames
    assert again.state.solution.frames == before and again.state.solution.frames.motion == before.motion
    for axis in range(3):
        for level in range(whole.hierarchy.levels):
            found, expected = (one.bfield.components[axis].array(level) for one in (again, whole))
            np.testing.assert_array_equal(found, expected)
    for run in whole, again:
        run.run()
    assert again.state.solution.frames == whole.state.solution.frames != before
    assert again.state.solution.frames.motion == whole.state.solution.frames.motion != before.motion
    np.testing.assert_array_equal(again.particles.position, whole.particles.position)
    np.testing.assert_array_equal(again.particles.momentum, whole.particles.momentum)


def test_bins_follow_from_the_motion_and_not_from_the_number_of_steps():
    """A bunch whose spread of energy grows: as many bins in the same places after 5, 25 and 100 steps to one time."""
    found, fields = [], []
    for steps in (5, 25, 100):
        run = amrpic.Simulation(MPI.COMM_SELF, scene([10.0], dt=4e-12 / steps, elements=(CHIRP,)))
        assert len(run.state.solution.frames.members) == 1
        run.advance(steps)
        found.append(run.state.solution.frames)
        fields.append(run.bfield.sample([(1e-3, 0, 0.9e-3), (1e-3, 0, 1.9e-3)])[:, 1])
    assert len(found[0].members) > 2
    for one, field in zip(found[:-1], fields[:-1], strict=True):
        assert one.of == found[-1].of
        assert one.edges == pytest.approx(found[-1].edges, abs=0.05)
        assert field == pytest.approx(fields[-1], rel=0.02)


def test_a_choice_is_kept_while_the_motion_stays():
    """Of a warm beam, and of two beams: the motion that was measured at the start is what later steps compare with."""
    for given in (scene([10.0], 12, momentum_spread=[0.3 * MC, 0, 2.0 * MC]), scene([3.0, 20.0], 12)):
        run = amrpic.Simulation(MPI.COMM_SELF, given)
        first = run.state.solution.frames
        run.run()
        last = run.state.solution.frames
        assert last.motion == first.motion and (last.edges, last.of) == (first.edges, first.of)


def test_motion_left_in_a_frame_is_that_of_a_lorentz_transformation():
    """Of warm electrons and positrons both ways, fast and at rest, by matrices on their momenta with the energy."""
    rng = np.random.default_rng(5)
    kinds = SpeciesTable.of_runs([(0, SPECIES["electron"]), (60, SPECIES["positron"])])
    u, weight = rng.normal(size=(100, 3)) * (0.3, 0.2, 2.0) + (0, 0.1, 3), 1 + rng.random(100)
    particles = Particles(rng.normal(size=(100, 3)), u * MC, weight, np.arange(100), kinds)
    for axis, momentum in ((2, 0.0), (2, 3.0), (2, -5.0), (1, 0.7), (0, 40.0)):
        gamma = np.hypot(1, momentum)
        boost = np.eye(4)
        boost[0, 0] = boost[1 + axis, 1 + axis] = gamma
        boost[0, 1 + axis] = boost[1 + axis, 0] = -momentum
        energy = np.sqrt(1 + (u**2).sum(axis=1))
        there = np.column_stack([energy, u]) @ boost
        beta, amount = there[:, 1:] / there[:, :1], weight * ELEMENTARY_CHARGE * there[:, 0] / energy
        sign = np.where(np.arange(100) < 60, -1, 1)
        expected = [amount.sum(), *(amount @ beta**2), *((amount * sign) @ beta)]
        assert squares(particles, Frame(axis, momentum)) == pytest.approx(expected, rel=1e-11, abs=1e-12 * amount.sum())


def test_a_choice_of_the_same_bins_keeps_their_frames():
    """And the solver's set-up with them: momenta change by rounding alone from step to step."""
    run, kept = amrpic.Simulation(MPI.COMM_SELF, scene([20.0], 18)), []
    run.on_step(lambda now: kept.append(now.state.solution.frames))
    run.run()
    assert len(kept) == 18 and set(kept) == {kept[0]}


@pytest.mark.parametrize("compensation", ["none", "auto"])
def test_a_restart_says_again_nothing_that_the_log_has(tmp_path: Path, capsys, compensation):
    """Of the frames and of what several of them go without, until their motion has changed again."""
    given = scene([3.0, 20.0], 18).to_dict()
    given["particles"] = {"compensation": compensation}
    given["output"] = {"write": ["checkpoint", "series"], "checkpoint_every": 12, "directory": str(tmp_path)}
    given["domain"]["cells"] = [4] * 3  # wide ones, in which `auto` compensates
    amrpic.Simulation(MPI.COMM_SELF, amrpic.Scene.from_dict(given)).run()
    first = capsys.readouterr().out
    assert first.count("motion.energy_bins: 2 for the self-field") == 1
    assert first.count("particles.compensation: none as long as") == (compensation == "auto")
    again = amrpic.Simulation.restart(MPI.COMM_SELF, tmp_path / "checkpoint_00000012")
    again.run()
    log = capsys.readouterr().out
    assert "step 18/18" in log and "motion.energy_bins" not in log and "particles.compensation" not in log
    status = json.loads((tmp_path / "status.json").read_text())
    assert any(note.startswith("motion.energy_bins: 2") for note in status["notes"])

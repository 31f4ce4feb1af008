"""Time steps that a run chooses by itself, remarks on long ones, and both forms of leapfrog."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pytest
from mpi4py import MPI

import amrpic
from amrpic.errors import InputError, SceneError
from amrpic.pic import time_step
from amrpic.pic.setup import Setup
from amrpic.pic.step import advance, begin
from amrpic.units import ELECTRON_MASS, ELEMENTARY_CHARGE, PROTON_MASS, SPEED_OF_LIGHT, VACUUM_PERMITTIVITY
from exact.passages import HARD, SMOOTH, TIME, error_of, flown, order, passage, through_hard, through_smooth
from exact.runs import collected, states

U = 0.5  # p / (m c)
GAMMA = np.hypot(1, U)
SPEED = U / GAMMA * SPEED_OF_LIGHT
PER_MASS = ELEMENTARY_CHARGE / (GAMMA * PROTON_MASS)
MC = PROTON_MASS * SPEED_OF_LIGHT


def described(
    element: dict[str, Any] | None = None, dt: Any = "auto", x: float = 0.0, u_x: float = 0.0, **motion: Any
) -> dict[str, Any]:
    """The scene of a proton with the momentum U along z, without charge to speak of, for five steps."""
    proton = {
        "distribution": "arrays",
        "species": "proton",
        "position": [[x, 0, 0]],
        "momenta": [[u_x * MC, 0, U * MC]],
        "charge": 1e-30,
    }
    return {
        "domain": {"lower": [-1, -1, -1], "upper": [1, 1, 1], "cells": [8, 8, 16]},
        "bunches": [proton],
        "elements": [] if element is None else [element],
        "motion": {"kind": "leapfrog", "dt": dt, **motion},
        "schedule": {"steps": 5},
        "output": {"write": []},
    }


def scene(*args: Any, **more: Any) -> amrpic.Scene:
    return amrpic.Scene.from_dict(described(*args, **more))


def begun(given: amrpic.Scene, comm: MPI.Comm = MPI.COMM_SELF) -> Setup:
    """The set-up of a scene after its first solve."""
    return begin(comm, given)[1]


def magnet(path: Path) -> Path:
    """A map of B = 0.2 T along y, with nodes 5 mm apart along z."""
    with h5py.File(path, "w") as h5:
        h5.attrs.update({"openPMD": "1.1.0", "basePath": "/data/%T/", "meshesPath": "fields/"})
        B = h5.create_group("data/0/fields/B")
        B.attrs.update({"geometry": "cartesian", "dataOrder": "C", "gridUnitSI": 1.0})
        B.attrs["axisLabels"] = np.array(["x", "y", "z"], dtype="S")
        B.attrs["gridSpacing"] = [0.02, 0.02, 0.005]
        B.attrs["gridGlobalOffset"] = [-0.1, -0.1, -0.1]
        B.attrs["unitDimension"] = [0.0, 1, -2, -1, 0, 0, 0]
        B["y"] = np.full((11, 11, 41), 0.2)
    return path


ELEMENTS: dict[str, tuple[dict[str, Any], float]] = {  # and the step for the proton
    "betatron period": (
        {"kind": "quadrupole", "length": 5, "gradient": -7},
        2 * np.pi / np.sqrt(7 * SPEED * PER_MASS) / time_step.PER_PERIOD,
    ),
    "betatron period of focusing": (
        {"kind": "constant-focusing", "gradient": [1e8, -4e8, 0]},
        2 * np.pi / np.sqrt(4e8 * PER_MASS) / time_step.PER_PERIOD,
    ),
    "cyclotron period": (
        {"kind": "solenoid", "length": 5, "field": -3},
        2 * np.pi / (3 * PER_MASS) / time_step.PER_PERIOD,
    ),
    "gain of γ m c": (
        {"kind": "uniform", "electric_field": [3e9, 0, -4e9]},
        SPEED_OF_LIGHT / (5e9 * PER_MASS) / time_step.PER_PERIOD,
    ),
    "RF period": (
        {"kind": "cavity", "length": 1, "field": 1e3, "frequency": 3e8},
        1 / 3e8 / time_step.PER_RF_PERIOD,
    ),
    "passage through": (
        {"kind": "rf-gap", "length": 0.05, "voltage": 10},
        0.05 / SPEED / time_step.PER_LENGTH,
    ),
    "or its fringe": (
        {"kind": "dipole", "length": 0.5, "field": 0.01, "fringe": "enge", "gap": 0.02},
        4 * 0.02 / SPEED / time_step.PER_LENGTH,
    ),
}


@pytest.mark.parametrize("rule", ELEMENTS)
def test_an_element_sets_the_step_by_its_own_time(rule):
    element, step = ELEMENTS[rule]
    setup = begun(scene({**element, "name": "of mine"}))
    assert setup.dt == pytest.approx(step, rel=1e-9)
    [note] = setup.remarks.notes
    assert rule.removesuffix(" of focusing") in note and "of mine" in note


def test_nodes_of_a_map_set_the_step(tmp_path):
    setup = begun(scene({"kind": "map", "file": str(magnet(tmp_path / "b.h5")), "scale": 0.01}))
    assert setup.dt == pytest.approx(0.005 / SPEED / time_step.PER_NODE)
    strong = begun(scene({"kind": "map", "file": str(tmp_path / "b.h5"), "scale": -100}))
    assert strong.dt == pytest.approx(2 * np.pi / (20 * PER_MASS) / time_step.PER_PERIOD)


@pytest.mark.parametrize("window, per_cell", [("none", SPEED / 0.125), ("reference", SPEED_OF_LIGHT / 1e3 / 0.25)])
def test_cells_are_crossed_with_the_velocity_relative_to_the_window(window, per_cell):
    """Along z without a window; across with one, which goes along z with the reference particle."""
    reference = {"species": "proton", "momentum": [0, 0, U * MC]}
    setup = begun(scene(u_x=1e-3 * GAMMA, window=window, reference=reference))  # 1e-3 c across, to first order
    assert setup.dt == pytest.approx(1 / per_cell / time_step.PER_CELL, rel=1e-5)
    assert f"cell of the finest level along {'z' if window == 'none' else 'x'}" in setup.remarks.notes[0]


def ball(gamma: float, dt: Any = "auto", of_other: float | None = None, **more: Any) -> amrpic.Scene:
    """A uniform ball of electrons and positrons, a quarter of them positrons, at rest in a frame of that γ.

    `of_other`: γ of the positrons, if it is another one, in an energy bin of their own.
    """
    u, other = (np.sqrt(g**2 - 1) for g in (gamma, of_other or gamma))
    sizes = (np.array([1e-3, 1e-3, 1e-3 / gamma]) / np.sqrt(5)).tolist()
    bunch = {
        "distribution": "hollow",
        "inner": 0.0,
        "particles": 40_000,
        "sampling": "sobol",
        "sigma": sizes,
        "momentum": [0, 0, u * ELECTRON_MASS * SPEED_OF_LIGHT],
    }
    return amrpic.Scene.from_dict(
        {
            "domain": {"lower": [-2e-3, -2e-3, -2e-3 / gamma], "upper": [2e-3, 2e-3, 2e-3 / gamma], "cells": [16] * 3},
            "bunches": [
                {**bunch, "species": "electron", "charge": -3e-12},
                {
                    **bunch,
                    "species": "positron",
                    "charge": 1e-12,
                    "momentum": [0, 0, other * ELECTRON_MASS * SPEED_OF_LIGHT],
                },
            ],
            "motion": {
                "kind": "leapfrog",
                "dt": dt,
                "window": "reference" if u else "none",
                "energy_bins": 2 if of_other else 1,
            },
            "output": {"write": []},
            **more,
        }
    )


@pytest.mark.mpi(ranks=(1, 2))
@pytest.mark.parametrize("gamma", [1.0, 10.0])
def test_the_plasma_period_is_that_of_all_species_together(comm, gamma):
    setup = begun(ball(gamma), comm)
    density = 4e-12 * gamma / (4 / 3 * np.pi * 1e-9)  # of |charge|, in the laboratory
    omega = np.sqrt(density * ELEMENTARY_CHARGE / (VACUUM_PERMITTIVITY * ELECTRON_MASS * gamma**3))
    assert setup.dt == pytest.approx(2 * np.pi / omega / time_step.PER_PLASMA_PERIOD, rel=0.05)
    assert "plasma period" in setup.remarks.notes[-1]


def test_the_plasma_period_counts_energy_bins_with_their_own_mass():
    """Three quarters of a ball at γ = 10, the rest at γ = 20: ω² is the sum of both."""
    found = []
    for other in (10.0, 20.0):
        state, setup = begin(MPI.COMM_SELF, ball(10.0, of_other=other))
        found.append(time_step.plasma_frequency(state.particles, state.hierarchy, setup.clouds, state.solution.frames))
    assert len(state.solution.frames.members) == 2
    assert (found[1] / found[0]) ** 2 == pytest.approx((3 + 1 / 8) / 4, rel=1e-3)


def test_nothing_that_takes_time_is_one_sentence():
    empty = amrpic.Scene.from_dict({**described(), "bunches": []})
    with pytest.raises(
        InputError, match=r'motion\.dt is "auto", but no particle moves, has charge or feels an element'
    ):
        begun(empty)


@pytest.mark.parametrize(
    "dt, text", [("soon", "unit"), (0, "greater than 0"), (-1e-9, "greater than 0"), (True, "time")]
)
def test_other_steps_are_refused(dt, text):
    with pytest.raises(SceneError, match=rf"motion\.dt .*{text}"):
        scene(dt=dt)


@pytest.mark.parametrize(
    "given, words, longest",  # in steps that the run chooses
    [
        (lambda dt: scene(dt=dt), "cell of the finest level along z", 2),
        (lambda dt: scene(ELEMENTS["cyclotron period"][0], dt), "cyclotron period in elements.0", 50),
        (lambda dt: scene(ELEMENTS["betatron period"][0], dt), "betatron period in elements.0", 50),
        (lambda dt: scene(ELEMENTS["gain of γ m c"][0], dt), "gain of γ m c in elements.0", 250),
        (lambda dt: scene(ELEMENTS["passage through"][0], dt), "passage through elements.0 or its fringe", 20),
        (lambda dt: scene(ELEMENTS["or its fringe"][0], dt), "passage through elements.0 or its fringe", 20),
        (lambda dt: ball(1.0, dt), "plasma period", 60 / (4 * np.pi)),
    ],
)
def test_a_long_step_gets_a_remark(given, words, longest):
    """One on each kind, where there are over 1 % fewer steps than are advisable, and none of a step that the run chose."""
    chosen = begun(given("auto"))
    assert not chosen.remarks.warnings
    assert not begun(given(chosen.dt)).remarks.warnings
    assert not any(words in remark for remark in begun(given(1.009 * longest * chosen.dt)).remarks.warnings)
    assert any(words in remark for remark in begun(given(1.012 * longest * chosen.dt)).remarks.warnings)
    remarks = begun(given(1000 * chosen.dt)).remarks.warnings
    assert sum(words in remark for remark in remarks) == 1
    assert all("motion.dt of" in remark and "is long" in remark for remark in remarks)


@pytest.mark.mpi(ranks=(1, 2))
@pytest.mark.parametrize("form", ["kick-drift-kick", "drift-kick-drift"])
@pytest.mark.parametrize("gamma", [1.0, 3.0])
def test_a_restart_goes_on_bit_by_bit_with_the_step_that_was_chosen(comm, tmp_path, form, gamma):
    """In the laboratory, where momenta are made anew in a checkpoint, and with a magnetic field, where they are kept."""
    given = ball(gamma, schedule={"steps": 6})
    given = given.model_copy(update={"motion": given.motion.model_copy(update={"form": form})})
    run = amrpic.Simulation(comm, given)
    run.checkpoint(tmp_path / "0")
    run.on_step(lambda now: now.checkpoint(tmp_path / "3") if now.step == 3 else None)
    run.run()
    whole = [*collected(comm, run.particles), np.array(run.time)]
    for step in ("0", "3"):
        again = amrpic.Simulation.restart(comm, tmp_path / step)
        again.run()
        for found, should in zip([*collected(comm, again.particles), np.array(again.time)], whole, strict=True):
            assert np.array_equal(found, should)
        assert again._setup.dt == run._setup.dt and not again.remarks


def test_a_restart_that_asks_for_it_anew_chooses_a_step(tmp_path):
    amrpic.Simulation(MPI.COMM_SELF, ball(1.0, 1e-12)).checkpoint(tmp_path / "made")
    again = amrpic.Simulation.restart(MPI.COMM_SELF, tmp_path / "made", ball(1.0))
    assert again._setup.dt == pytest.approx(begun(ball(1.0)).dt)


def test_a_restart_gets_a_remark_of_another_long_step_alone(tmp_path):
    amrpic.Simulation(MPI.COMM_SELF, ball(1.0, 1e-8)).checkpoint(tmp_path / "made")
    same, longer = (amrpic.Simulation.restart(MPI.COMM_SELF, tmp_path / "made", ball(1.0, dt)) for dt in (1e-8, 2e-8))
    assert not same.remarks
    assert any("motion.dt of 2e-08 s is long" in remark for remark in longer.remarks)


# ---- both forms ----


@pytest.mark.parametrize("name", ["quadrupole", "solenoid"])
@pytest.mark.parametrize("ends", ["smooth", "hard"])
def test_drift_kick_drift_is_of_second_order(name, ends):
    """At the middle of steps: n of them end at (n - 1/2) dt."""
    elements, exact = (SMOOTH, through_smooth) if ends == "smooth" else (HARD, through_hard)
    errors = []
    for steps in (100, 200, 400):
        given = passage([elements[name]], steps)
        given["motion"] |= {"form": "drift-kick-drift", "dt": TIME / (steps - 0.5)}
        *_, state = states(MPI.COMM_SELF, given)
        assert state.time == pytest.approx(TIME, rel=1e-12)
        errors.append(error_of(MPI.COMM_SELF, state, elements[name], exact))
    assert order(errors) > 1.8, errors
    assert errors[-1] < 1e-4, errors


def test_both_forms_are_of_second_order_in_the_field_of_a_bunch():
    """Positions and momenta of electrons and positrons that expand, against those with many more steps."""
    time = 3e-10

    def ended(form: str, steps: int) -> np.ndarray:
        dt = time / (steps - 0.5 * (form == "drift-kick-drift"))
        given = ball(1.0, dt, schedule={"steps": steps}, solver={"tolerance": 1e-10})
        motion = given.motion.model_copy(update={"form": form})
        state, setup = begin(MPI.COMM_SELF, given.model_copy(update={"motion": motion}))
        while state.step < steps:
            state = advance(state, setup)
        assert state.time == pytest.approx(time, rel=1e-12)
        return np.stack(collected(MPI.COMM_SELF, state.synchronized))

    exact = ended("kick-drift-kick", 80)
    for form in ("kick-drift-kick", "drift-kick-drift"):
        errors = np.array([np.linalg.norm(ended(form, steps) - exact, axis=(1, 2)) for steps in (5, 10, 20)])
        assert all(order(list(column)) > 1.9 for column in errors.T), (form, errors)


def test_drift_kick_drift_kicks_in_the_middle_of_its_drifts():
    """In a linear field, by hand: two half drifts around each kick; states are those of half a kick."""
    gradient, dt = 4e8, 1e-10
    element = {"kind": "constant-focusing", "gradient": [gradient, 0, 0]}
    x, p = np.array([0.01, 0, 0]), np.array([0, 0, U * MC])
    for state in states(MPI.COMM_SELF, described(element, dt, x=0.01, form="drift-kick-drift")):
        if state.step == 0:
            continue
        x = x + dt / 2 * p / PROTON_MASS / np.sqrt(1 + p @ p / MC**2)
        half = -ELEMENTARY_CHARGE * gradient * dt / 2 * x * (1, 0, 0)
        assert state.time == pytest.approx((state.step - 0.5) * dt, rel=1e-12)
        assert state.particles.position[0] == pytest.approx(x, rel=1e-12)
        assert state.synchronized.momentum[0] == pytest.approx(p + half, rel=1e-12)
        p = p + 2 * half
        x = x + dt / 2 * p / PROTON_MASS / np.sqrt(1 + p @ p / MC**2)
    assert state.step == 5


@pytest.mark.parametrize(
    "element, exact",
    [
        (SMOOTH["solenoid"], through_smooth),
        (SMOOTH["focusing"], through_smooth),
        (HARD["quadrupole"], through_hard),
    ],
)
def test_chosen_steps_pass_elements_within_1e_5(element, exact):
    state = flown(MPI.COMM_SELF, element, "auto")
    assert 100 < state.step < 1000
    assert error_of(MPI.COMM_SELF, state, element, exact) < 1e-5

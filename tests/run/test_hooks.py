"""Fields and kicks from Python: what they do, that a restart has them, and one sentence for each mistake."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from mpi4py import MPI
from scipy.integrate import solve_ivp

import amrpic
from amrpic.errors import InputError
from amrpic.units import ELEMENTARY_CHARGE, PROTON_MASS, SPEED_OF_LIGHT

MC = PROTON_MASS * SPEED_OF_LIGHT
BETA_GAMMA = 0.2
DT = 0.1e-9
Fields = tuple[Any, Any]


def scene(elements: list[dict[str, Any]] | None = None, steps: int = 20, charge: float = 1e-25, **more: Any) -> Any:
    """Protons that fly along z from -0.1 m, 6 mm a step."""
    rng = np.random.default_rng(4)
    position = rng.normal(0, 2e-3, (60, 3)) - np.array([0, 0, 0.1])
    momentum = (rng.normal(0, 2e-3, (60, 3)) + np.array([0, 0, 1])) * BETA_GAMMA * MC
    return amrpic.Scene.from_dict(
        {
            "domain": {"lower": ["-5 cm", "-5 cm", "-20 cm"], "upper": ["5 cm", "5 cm", "20 cm"], "cells": [8, 8, 32]},
            "bunches": [
                {
                    "distribution": "arrays",
                    "species": "proton",
                    "position": position.tolist(),
                    "momenta": momentum.tolist(),
                    "charge": charge,
                }
            ],
            "elements": elements or [],
            "motion": {"kind": "leapfrog", "dt": DT},
            "schedule": {"steps": steps},
            "output": {"write": []},
            **more,
        }
    )


def gathered(run: amrpic.Simulation, comm: MPI.Comm) -> dict[str, np.ndarray]:
    """Places and momenta of all particles in the order of ids, on every rank."""
    own = {name: np.array(getattr(run.particles, name)) for name in ("id", "position", "momentum")}
    all_ = {name: np.concatenate(comm.allgather(values)) for name, values in own.items()}
    order = np.argsort(all_["id"])
    return {name: values[order] for name, values in all_.items()}


def ended(run: amrpic.Simulation, comm: MPI.Comm) -> dict[str, np.ndarray]:
    run.run()
    return gathered(run, comm)


def uniform(x: np.ndarray, y: np.ndarray, z: np.ndarray, t: float) -> Fields:
    return (2e5, -1e5, 3e5), (0.02, 0.01, -0.03)


def quadrupole(x: np.ndarray, y: np.ndarray, z: np.ndarray, t: float) -> Fields:
    return np.zeros((3, len(x))), (5 * y, 5 * x, 0)


def wave(x: np.ndarray, y: np.ndarray, z: np.ndarray, t: float) -> Fields:
    return (1e5 * np.cos(1e9 * t) + 0 * x, 0, 1e6 * x), (0, 0.05 * np.sin(30 * z), 0)


ELEMENTS: dict[str, dict[str, Any]] = {
    "uniform": {"kind": "uniform", "electric_field": [2e5, -1e5, 3e5], "magnetic_field": [0.02, 0.01, -0.03]},
    "quadrupole": {"kind": "quadrupole", "length": 10, "gradient": 5, "fringe": "enge", "gap": 0.01},  # taken at points
}


@pytest.mark.mpi(ranks=(1, 3), more=(2, 4))
@pytest.mark.parametrize("name", ELEMENTS)
def test_a_function_acts_as_the_element_of_the_same_field(comm, name):
    found = ended(amrpic.Simulation(comm, scene(), fields=[globals()[name]]), comm)
    should = ended(amrpic.Simulation(comm, scene([ELEMENTS[name]])), comm)
    free = ended(amrpic.Simulation(comm, scene()), comm)
    for key, unit in (("position", 0.1), ("momentum", BETA_GAMMA * MC)):
        off, effect = (float(np.abs(found[key] - other[key]).max()) / unit for other in (should, free))
        assert off < 1e-13
        assert effect > 1e-3


@pytest.mark.parametrize("charge", [1e-25, 2e-10], ids=["without", "with self-field"])
def test_fields_from_python_add_to_elements_and_walls(comm, charge):
    """Half of a field as an element, half as two functions, between plates of a fast beam's frame."""
    walls = {
        "lower": ["-5 cm", "-5 cm", "-20 cm"],
        "upper": ["5 cm", "5 cm", "20 cm"],
        "cells": [8, 8, 32],
        "boundary": {"x": "dirichlet", "y": "dirichlet", "z": "open"},
        "potential": {"x": ["0 V", "5 kV"]},
    }

    def quarter(x: np.ndarray, y: np.ndarray, z: np.ndarray, t: float) -> Fields:
        return [5e4, -2.5e4, 7.5e4], [0.005, 0.0025, -0.0075]

    half = {"kind": "uniform", "electric_field": [1e5, -5e4, 1.5e5], "magnetic_field": [0.01, 0.005, -0.015]}
    found = ended(amrpic.Simulation(comm, scene([half], charge=charge, domain=walls), fields=[quarter, quarter]), comm)
    should = ended(amrpic.Simulation(comm, scene([ELEMENTS["uniform"]], charge=charge, domain=walls)), comm)
    for key, unit in (("position", 0.1), ("momentum", BETA_GAMMA * MC)):
        assert float(np.abs(found[key] - should[key]).max()) < 1e-12 * unit


def test_time_of_a_function_is_that_of_positions(comm):
    times = []

    def noted(x: np.ndarray, y: np.ndarray, z: np.ndarray, t: float) -> Fields:
        times.append((t, z.mean()))
        return (0, 0, 0), (0, 0, 0)

    amrpic.Simulation(comm, scene(steps=3), fields=[noted]).run()
    assert np.allclose([t for t, _ in times], DT * np.arange(4), rtol=1e-14)
    speed = BETA_GAMMA / np.hypot(1, BETA_GAMMA) * SPEED_OF_LIGHT
    assert np.diff([z for _, z in times]) == pytest.approx(3 * [speed * DT], rel=1e-2)


def test_orbits_in_a_field_that_changes_are_those_of_scipy(comm):
    """At second order in the step."""
    start = gathered(amrpic.Simulation(comm, scene()), comm)

    def change(t: float, state: np.ndarray) -> np.ndarray:
        x, u = state.reshape(2, -1, 3)
        v = SPEED_OF_LIGHT * u / np.sqrt(1 + (u**2).sum(axis=1, keepdims=True))
        E, B = (np.stack(np.broadcast_arrays(*field), axis=1) for field in wave(x[:, 0], x[:, 1], x[:, 2], t))
        return np.concatenate([v, ELEMENTARY_CHARGE / MC * (E + np.cross(v, B))]).ravel()

    initial = np.concatenate([start["position"], start["momentum"] / MC]).ravel()
    exact = solve_ivp(change, (0, 20 * DT), initial, method="DOP853", rtol=1e-11, atol=1e-13).y[:, -1].reshape(2, -1, 3)
    errors = []
    for steps in (20, 40, 80):
        given = scene(steps=steps, motion={"kind": "leapfrog", "dt": 20 * DT / steps})
        found = ended(amrpic.Simulation(comm, given, fields=[wave]), comm)
        off = found["position"] - exact[0], BETA_GAMMA * (found["momentum"] / MC - exact[1])
        errors.append(float(max(np.abs(values).max() for values in off)))
    assert np.log2(errors[0] / errors[2]) / 2 > 1.9, errors
    assert errors[-1] < 1e-6, errors


def lens(run: amrpic.Simulation) -> None:
    """A thin lens at every third step."""
    if run.step % 3 == 0:
        run.kick(-0.4 * BETA_GAMMA * MC * run.particles.position * (1, 1, 0))


@pytest.mark.mpi(ranks=(1, 2, 3))
def test_kicks_act_at_the_time_of_positions(comm):
    """Between kicks particles drift: places and momenta are sums, to rounding."""
    run = amrpic.Simulation(comm, scene(charge=1e-40))
    start = gathered(run, comm)
    x, p = start["position"], start["momentum"]
    run.on_step(lens)
    for step in range(1, 21):
        x = x + DT * p / (PROTON_MASS * np.sqrt(1 + (p**2).sum(axis=1, keepdims=True) / MC**2))
        if step % 3 == 0:
            p = p - 0.4 * BETA_GAMMA * MC * x * (1, 1, 0)
    found = ended(run, comm)
    assert np.abs(found["position"] - x).max() < 1e-13
    assert np.abs(found["momentum"] - p).max() < 1e-12 * BETA_GAMMA * MC


def lens_in_laboratory(run: amrpic.Simulation) -> None:
    if run.step % 3 == 0:
        places = run.window.places(run.particles.position)
        run.kick(run.window.from_laboratory(-0.4 * BETA_GAMMA * MC * places * (1, 1, 0)))


@pytest.mark.mpi(ranks=(1, 2))
def test_fields_and_kicks_are_the_same_in_a_window_that_turns(comm):
    bend = {"kind": "dipole", "length": "0.1 m", "field": "0.5 T"}
    window: dict[str, Any] = {
        "motion": {"kind": "leapfrog", "dt": DT, "window": "reference"},
        "domain": {"lower": ["-4 cm", "-4 cm", "-14 cm"], "upper": ["4 cm", "4 cm", "-6 cm"], "cells": 8},
    }
    reference = {"position": [0, 0, -0.1], "momentum": [0, 0, BETA_GAMMA * MC]}
    window["motion"]["reference"] = reference
    found: list[np.ndarray] = []
    should: list[np.ndarray] = []
    for into, given in ((found, scene([bend], 40, **window)), (should, scene([bend], 40))):
        run = amrpic.Simulation(comm, given, fields=[wave])
        run.on_step(lens_in_laboratory)
        whole = ended(run, comm)
        into += [run.window.places(whole["position"]), run.window.to_laboratory(whole["momentum"])]
        assert run.window.is_turned == (into is found)
    for a, b in zip(found, should, strict=True):
        assert float(np.abs(a - b).max()) < 1e-11 * np.abs(b).max()


def test_a_kick_before_the_first_step_is_in_the_first_state(comm):
    run = amrpic.Simulation(comm, scene())
    before = gathered(run, comm)["momentum"]
    run.kick(np.full((60, 3), 1e-21))
    assert np.array_equal(gathered(run, comm)["momentum"], before + 1e-21)
    assert run.step == 0


def test_a_kick_of_particles_at_rest_changes_their_momenta(comm):
    run = amrpic.Simulation(comm, scene(motion={"kind": "none"}))
    before = np.array(run.particles.momentum)
    run.kick(np.full((60, 3), 1e-21))
    assert np.array_equal(run.particles.momentum, before + 1e-21)


@pytest.mark.mpi(ranks=(1, 2))
def test_restart_has_fields_and_kicks_bit_by_bit(comm, tmp_path):
    """From a checkpoint of the run's own, of a step that has a kick, and from one made in a callback."""
    output = {"write": ["checkpoint"], "directory": str(tmp_path / "run"), "checkpoint_every": 9, "keep": 9}
    given = scene([ELEMENTS["quadrupole"]], charge=2e-10, output=output)
    run = amrpic.Simulation(comm, given, fields=[uniform, wave])
    run.on_step(lens)
    run.on_step(lambda now: now.checkpoint(tmp_path / "own") if now.step == 12 else None)
    whole = ended(run, comm)
    for path in (tmp_path / "run" / "checkpoint_00000009", tmp_path / "own"):
        again = amrpic.Simulation.restart(comm, path, fields=[uniform, wave])
        assert not again.remarks
        again.on_step(lens)
        for key, values in ended(again, comm).items():
            assert np.array_equal(values, whole[key]), key


def test_a_restart_without_the_fields_gets_a_remark(comm, tmp_path):
    run = amrpic.Simulation(comm, scene(), fields=[uniform, wave])
    run.checkpoint(tmp_path / "made")
    [remark] = amrpic.Simulation.restart(comm, tmp_path / "made").remarks
    assert remark == (
        "fields from Python are none, and were uniform, wave up to the checkpoint; give Simulation.restart the same ones to go "
        "on as before"
    )


def test_functions_for_particles_at_rest_get_a_remark(comm):
    [remark] = amrpic.Simulation(comm, scene(motion={"kind": "none"}), fields=[uniform]).remarks
    assert remark.startswith('fields from Python act on nothing, since motion.kind is "none"')


def test_particles_of_a_run_are_read_only(comm):
    run = amrpic.Simulation(comm, scene(steps=1))
    for _ in range(2):
        for array in run.particles.arrays:
            with pytest.raises(ValueError, match="read-only"):
                array[...] = 0
        run.run()
    assert run.state.particles.momentum.flags.writeable  # of the run itself


def broken(x: np.ndarray, y: np.ndarray, z: np.ndarray, t: float) -> Fields:
    if MPI.COMM_WORLD.rank == MPI.COMM_WORLD.size - 1:
        raise RuntimeError("the table is empty")
    return (0, 0, 0), (0, 0, 0)


def holed(x: np.ndarray, y: np.ndarray, z: np.ndarray, t: float) -> Fields:
    return (0, 0, np.where(x == x.min(initial=0), np.nan, 1.0)), (0, 0, 0)


def overwriting(x: np.ndarray, y: np.ndarray, z: np.ndarray, t: float) -> Fields:
    x *= 2
    return (x, 0, 0), (0, 0, 0)


@pytest.mark.mpi(ranks=(1, 2))
@pytest.mark.parametrize(
    "function, words",
    [
        (broken, r'fields\[0\], "broken", failed at t = 0 s \(RuntimeError: the table is empty\)'),
        (holed, r"E = \[0.0, 0.0, nan\] at \(.*\) m, one of 1 places where it is not finite; return finite numbers"),
        (overwriting, "read-only"),
        (lambda x, y, z, t: (0, 0, 0), "it returns 3 values of shapes .*; return two, E and B"),
        (lambda x, y, z, t: None, "it returns a NoneType; return two, E and B"),
        (lambda x, y, z, t: ((0, 0, 0), np.zeros((len(x), 3))), r"B is an array of shape \(\d+, 3\) for n = \d+ part"),
        (lambda x, y, z, t: ((0, 0, x[:-1]), (0, 0, 0)), r"E is 3 values of shapes \(\), \(\), \(\d+,\) for n = \d+ part"),
        (lambda x, y: 0, "TypeError"),
        (3.5, r"fields\[0\] is 3.5; give a function of x, y, z, t that returns E, B"),
    ],
    ids=["raises", "nan", "writes", "three", "nothing", "rows", "short", "arguments", "number"],
)  # fmt: skip
def test_mistakes_of_functions_end_all_ranks_with_a_sentence(comm, function, words):
    with pytest.raises(InputError, match=words) as refused:
        amrpic.Simulation(comm, scene(), fields=[function])
    assert "\n" not in str(refused.value)
    assert len(set(comm.allgather(str(refused.value)))) == 1


@pytest.mark.mpi(ranks=(1, 2))
def test_mistakes_of_kicks_end_all_ranks_with_a_sentence(comm):
    run = amrpic.Simulation(comm, scene())
    before = np.array(run.particles.momentum)
    nan = np.zeros((len(before), 3))
    if len(before):
        nan[-1, 1] = np.nan
    for change, words in (
        (0.0, "has shape () for"),
        (np.zeros((3, 61)), "has shape (3, 61)"),
        (nan, "[0.0, nan, 0.0] kg m/s"),
    ):
        with pytest.raises(InputError) as refused:
            run.kick(change)
        assert words in str(refused.value)
    assert np.array_equal(run.particles.momentum, before)


def test_a_kick_of_one_particle_turns_its_velocity(comm):
    """p_x from 0 to p: x grows by v_x dt per step, v_x = p c² / E."""
    momentum = ELEMENTARY_CHARGE * 1e8 / SPEED_OF_LIGHT
    one = {
        "distribution": "arrays",
        "species": "proton",
        "position": [[0, 0, 0]],
        "momenta": [[0, 0, 0]],
        "charge": 1e-30,
    }
    run = amrpic.Simulation(comm, scene(steps=2, bunches=[one]))
    run.kick([[momentum, 0, 0]])
    run.run()
    speed = momentum / np.hypot(PROTON_MASS, momentum / SPEED_OF_LIGHT)
    assert run.particles.position[0, 0] == pytest.approx(2 * DT * speed, rel=1e-12)

"""Particles that are born in time: the order of their first flight, the balance of their charge, restarts and ranks."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from mpi4py import MPI

from amrpic.errors import SceneError
from amrpic.pic.emitters import OfSurface, Span
from amrpic.pic.simulation import Simulation
from amrpic.scene.scene import Scene
from amrpic.units import ELECTRON_MASS, ELEMENTARY_CHARGE, SPEED_OF_LIGHT
from particle_cases import assert_same_bits

PERIODIC = {"x": "periodic", "y": "periodic", "z": "dirichlet"}
GAP: dict[str, Any] = {"lower": [0, 0, 0], "upper": [1e-3, 1e-3, 1e-2], "cells": [4, 4, 32], "boundary": PERIODIC}
SLOW = 1e6  # m/s
STEP = 1e-10  # s


def scene(source: dict[str, Any], **changes: Any) -> Scene:
    """Electrons from the lower plane of a gap."""
    data: dict[str, Any] = {
        "domain": GAP,
        "sources": [{"process": "given", "face": "z_lower", **source}],
        "motion": {"kind": "leapfrog", "dt": STEP},
        "schedule": {"steps": 20},
        "output": {"write": []},
    }
    return Scene.from_dict({**data, **changes})


def beam_of(speed: float) -> dict[str, Any]:
    square = (speed / SPEED_OF_LIGHT) ** 2
    over_mc2 = square / (1 + np.sqrt(1 - square)) / np.sqrt(1 - square)  # gamma - 1
    return {"kind": "beam", "energy": float(over_mc2 * ELECTRON_MASS * SPEED_OF_LIGHT**2)}


FAINT = {"current": -1e-18, "per_step": 8, "momenta": beam_of(SLOW)}


def born_at(run: Simulation) -> np.ndarray:
    """Times of birth of this rank's particles, (n,) s, with eight in each step."""
    emitter, number = run._setup.emitters[0], run.particles.id - run._setup.emitters[0].first
    first = run.time - run._setup.dt * (run.step - 1)  # where the first step ends: it may be half of one
    ends = np.concatenate([[0.0], first + run._setup.dt * np.arange(run.step)])
    out = np.empty(len(number))
    for step in range(run.step):
        own = number // 8 == step
        out[own] = emitter.times(number[own], Span(ends[step], ends[step + 1], 8 * step))
    return out


def error_of_flights(steps: int, form: str, pusher: str, magnetic: float) -> float:
    """Largest error of a place, over the length of the way, against the exact flight in E = -(a + k z) and B along x."""
    a, k, time = 1e3, 4e5, 2e-9
    dt = time / steps
    elements = [
        {"kind": "uniform", "electric_field": [0, 0, -a], "magnetic_field": [magnetic, 0, 0]},
        {"kind": "constant-focusing", "gradient": [0, 0, k]},
    ]
    motion = {"kind": "leapfrog", "dt": dt, "form": form, "pusher": pusher}
    run = Simulation(MPI.COMM_SELF, scene(FAINT, elements=elements, motion=motion, schedule={"steps": steps}))
    run.advance(steps)
    exact = flights(run.time - born_at(run), a, k, magnetic)
    return float(np.abs(run.particles.position[:, 2] - exact).max() / exact.max())


def flights(tau: np.ndarray, a: float, k: float, magnetic: float) -> np.ndarray:
    """z after a time, by many small steps of the equations of motion of electrons that start at z = 0 with v_z."""
    ratio, steps = ELEMENTARY_CHARGE / ELECTRON_MASS, 1000
    h, start = tau / steps, SLOW / np.sqrt(1 - (SLOW / SPEED_OF_LIGHT) ** 2)
    state = np.array([np.zeros_like(tau), np.zeros_like(tau), np.full_like(tau, start)])

    def rates(state: np.ndarray) -> np.ndarray:
        z, uy, uz = state
        vy, vz = np.array([uy, uz]) / np.sqrt(1 + (uy**2 + uz**2) / SPEED_OF_LIGHT**2)
        return np.array([vz, -ratio * vz * magnetic, ratio * (a + k * z + vy * magnetic)])

    for _ in range(steps):  # Runge and Kutta's
        k1 = rates(state)
        k2 = rates(state + h / 2 * k1)
        k3 = rates(state + h / 2 * k2)
        k4 = rates(state + h * k3)
        state = state + h / 6 * (k1 + 2 * k2 + 2 * k3 + k4)
    return state[0]


@pytest.mark.parametrize(
    ("form", "pusher", "magnetic"),
    [
        ("kick-drift-kick", "higuera-cary", 0.0),
        ("drift-kick-drift", "higuera-cary", 0.0),
        ("kick-drift-kick", "boris", 2e-3),
        ("kick-drift-kick", "higuera-cary", 2e-3),
        ("drift-kick-drift", "boris", 2e-3),
    ],
)
def test_first_flight_keeps_second_order(form, pusher, magnetic):
    errors = [error_of_flights(steps, form, pusher, magnetic) for steps in (20, 40, 80)]
    assert np.log2(errors[0] / errors[2]) / 2 > 1.85, errors


@pytest.mark.mpi(ranks=(1, 2))
def test_what_is_born_flies_or_is_lost(comm):
    """Also of a field that turns some back to the cathode."""
    domain = {**GAP, "potential": {"z": [0, 3]}}
    thermal = {"kind": "thermal", "energy": "0.3 eV"}
    run = Simulation(comm, scene({"current": -4e-7, "per_step": 50, "momenta": thermal}, domain=domain))
    run.advance(300)
    tally, lost = run.state.tallies.of[0], run.lost.particles
    flying, gone = (part.total_charge(run.comm) for part in (run.particles, lost))
    assert tally.charge == pytest.approx(-4e-7 * run.time, rel=1e-12)
    assert abs(flying + gone - tally.charge) < 1e-13 * abs(tally.charge)
    causes = run.comm.allreduce(np.bincount(run.lost.cause, minlength=6))
    assert tally.particles == run.comm.allreduce(len(run.particles)) + causes.sum()
    assert causes[4] > 0 and causes[5] > 0 and causes[:4].sum() == 0


def test_memory_follows_the_number_of_particles_in_flight():
    """Of 200,000 that are born in ten steps and fly through the gap nothing is left but the record of their losses."""
    pulse = {"charge": -1e-20, "particles": 200_000, "pulse": {"shape": "flat", "length": 10 * STEP}}
    run = Simulation(MPI.COMM_SELF, scene({**pulse, "momenta": beam_of(2 * SLOW)}, schedule={"steps": 80}))

    def held() -> int:
        particles = run.particles
        bases = {id(of): of for of in map(_memory_of, particles.arrays)}
        return sum(of.nbytes for of in bases.values())

    begun = held()
    run.advance(12)
    assert len(run.particles) == 200_000 and 64 * 200_000 <= held() < 1.1 * 64 * 200_000
    run.advance(60)
    assert len(run.particles) == 0 and held() <= begun + 2**16
    assert len(run.lost) == 200_000 and run.lost.particles.own_charge == pytest.approx(-1e-20, rel=1e-12)
    assert run.lost.charges.sum() == pytest.approx(-1e-20, rel=1e-12)
    assert _memory_of(run.lost.time).nbytes <= 1.5 * 8 * 8 * 200_000


def _memory_of(array: np.ndarray) -> np.ndarray:
    while isinstance(array.base, np.ndarray):
        array = array.base
    return array


PULSE = {"charge": -1e-14, "particles": 3000, "pulse": {"shape": "gaussian", "sigma": 4 * STEP, "cutoff": 2}}


def ordered(comm: Any, run: Simulation) -> np.ndarray:
    """All particles of all ranks by id: id, place, momentum and weight."""
    particles = run.particles
    own = np.column_stack([particles.id, particles.position, particles.momentum, particles.weight])
    whole = np.concatenate(comm.allgather(own))
    return whole[np.argsort(whole[:, 0])]


@pytest.mark.mpi(ranks=(2, 4))
def test_births_are_the_same_on_any_ranks(comm):
    given = scene(
        {**PULSE, "momenta": {"kind": "thermal", "energy": "1 eV"}, "sampling": "sobol"},
        domain={**GAP, "potential": {"z": [0, 100]}},
        solver={"tolerance": 1e-12},
        refinement={"levels": 1, "regrid_every": 3, "rule": {"kind": "charge-density", "relative": 0.2}},
    )
    together, alone = Simulation(comm, given), Simulation(MPI.COMM_SELF, given)
    together.advance(25), alone.advance(25)
    one, many = ordered(MPI.COMM_SELF, alone), ordered(comm, together)
    np.testing.assert_array_equal(many[:, 0], one[:, 0])
    np.testing.assert_allclose(many, one, rtol=1e-9, atol=1e-10 * np.abs(one).max(axis=0).min())


@pytest.mark.mpi(ranks=(1, 2))
def test_a_restart_amid_emission_goes_on_bit_by_bit(comm, tmp_path):
    folder = comm.bcast(tmp_path)
    given = scene(
        {**PULSE, "momenta": {"kind": "lambert", "energy": "1 eV"}},
        domain={**GAP, "potential": {"z": [0, 100]}},
        sources=[
            {"process": "given", "face": "z_lower", **PULSE},
            {"process": "given", "face": "z_lower", "current": -1e-7, "per_step": 7, "momenta": beam_of(SLOW)},
        ],
    )
    whole = Simulation(comm, given)
    whole.advance(6)
    whole.checkpoint(folder / "half")
    rest = Simulation.restart(comm, folder / "half")
    whole.advance(9), rest.advance(9)
    assert_same_bits(rest.particles, whole.particles)
    assert rest.state.tallies == whole.state.tallies


def test_a_pulse_has_its_times_and_places():
    spot = {"shape": "gaussian", "sigma": [1e-4, 2e-4], "centre": [5e-4, 5e-4], "cutoff": 2}
    faint = {**PULSE, "charge": -1e-20}
    run = Simulation(MPI.COMM_SELF, scene({**faint, "spot": spot, "momenta": beam_of(SLOW)}, schedule={"start": -1e-9}))
    run.advance(10)
    assert len(run.particles) == 0  # nothing is born before its time
    run.advance(20)
    assert len(run.particles) == 3000
    assert run.particles.total_charge(run.comm) == pytest.approx(-1e-20, rel=1e-12)
    speed = run.particles.momentum[:, 2] / ELECTRON_MASS
    age = run.particles.position[:, 2] / speed
    from scipy import stats

    middle, law = 8 * STEP, stats.truncnorm(-2, 2, scale=4 * STEP)
    assert stats.kstest(run.time - age - middle, law.cdf).pvalue > 0.01
    x, y = (run.particles.position[:, :2] - 5e-4).T / [[1e-4], [2e-4]]
    square = x**2 + y**2
    inside = 1 - np.exp(-2.0)
    assert stats.kstest(square, lambda s: (1 - np.exp(-s / 2)) / inside).pvalue > 0.01


@pytest.mark.parametrize("parts, number", [(10, 10), (10.5, 11), (0.4, 1)])
@pytest.mark.parametrize(
    "given",
    [
        {"current": -1e-9, "pulse": {"shape": "steady", "stop": 5.3 * STEP}},
        {"charge": -1e-18, "pulse": {"shape": "flat", "length": 5.3 * STEP}},
        {"charge": -1e-18, "pulse": {"shape": "gaussian", "sigma": STEP}},
        {"charge": -1e-18, "pulse": {"shape": "table", "times": [0, 5.3 * STEP], "values": [1, 1]}},
    ],
)
def test_a_pulse_gives_its_charge_whatever_that_of_a_macroparticle(given, parts, number):
    total = given.get("charge", given.get("current", 0) * 5.3 * STEP)
    run = Simulation(MPI.COMM_SELF, scene({**given, "particle_charge": total / parts, "momenta": beam_of(SLOW)}))
    run.advance(10)
    assert len(run.particles) == number
    assert run.particles.total_charge(run.comm) == pytest.approx(total, rel=1e-12)


@pytest.mark.parametrize(
    "given, missed",
    [
        ({"charge": -1e-18, "pulse": {"shape": "flat", "start": -STEP, "length": 4 * STEP}}, "0.25"),
        ({"current": -1e-18, "pulse": {"shape": "steady", "start": -STEP, "stop": STEP}}, "0.5"),
        ({"current": -1e-18, "pulse": {"shape": "steady", "start": -STEP}}, None),
        ({"charge": -1e-18, "pulse": {"shape": "flat", "length": STEP}}, None),
    ],
)
def test_charge_from_before_the_run_draws_a_remark(given, missed):
    remarks = Simulation(MPI.COMM_SELF, scene({**given, "per_step": 2})).remarks
    said = [f"{missed} of the charge of source_0 would be born before the run starts at 0 s, the first at -1e-10 s"]
    found = [sentence.partition(", and is not")[0] for sentence in remarks if "before the run" in sentence]
    assert found == (said if missed else [])


@pytest.mark.parametrize("given", [{"process": "space-charge-limited"}, {"current": -1.0, "per_step": 400}])
def test_a_spot_on_a_wall_goes_on_across_periodic_faces(given):
    """It has all of its area, and gives what the same spot in the middle does."""
    areas, charges = [], []
    for centre in ([5e-4, 5e-4], [0, 5e-4], [1e-3, 0]):
        spot = {"shape": "disc", "radius": 3e-4, "centre": centre}
        limit = {} if "process" in given else {"limit": "space-charge"}
        run = Simulation(
            MPI.COMM_SELF, scene({**given, **limit, "spot": spot}, domain={**GAP, "potential": {"z": [0, 9]}})
        )
        run.advance(2)
        [emitter] = run._setup.emitters
        assert isinstance(emitter, OfSurface) and emitter._on_wall is not None
        areas.append(emitter._on_wall.area.sum())
        charges.append(run.state.tallies.of[0].charge)
    assert areas == pytest.approx([areas[0]] * 3, rel=1e-12) and areas[0] == pytest.approx(np.pi * 9e-8, rel=0.02)
    assert charges == pytest.approx([charges[0]] * 3, rel=0.05)


def test_a_photo_cathode_has_the_thermal_emittance():
    """√(MTE / m c²) times the rms size of the spot, within five standard errors; MTE itself too."""
    count, energy = 20_000, 0.5 * ELEMENTARY_CHARGE
    photo = {
        "process": "photo", "charge": -1e-20, "particles": count, "mean_transverse_energy": "0.5 eV",
        "pulse": {"shape": "flat", "length": 2 * STEP}, "spot": {"shape": "disc", "radius": "2 mm"},
    }  # fmt: skip
    wide = {"lower": [-1e-2, -1e-2, 0], "upper": [1e-2, 1e-2, 1e-2], "cells": 8, "boundary": "dirichlet"}
    run = Simulation(MPI.COMM_SELF, scene(photo, domain=wide))
    run.advance(4)
    assert len(run.particles) == count
    u = run.particles.momentum[:, :2] / (ELECTRON_MASS * SPEED_OF_LIGHT)
    measured = (u**2).sum(axis=1) / 2 * ELECTRON_MASS * SPEED_OF_LIGHT**2
    assert abs(measured.mean() - energy) < 5 * measured.std() / np.sqrt(count)
    expected = np.sqrt(energy / (ELECTRON_MASS * SPEED_OF_LIGHT**2)) * 1e-3  # of a disc, half its radius
    for emittance in run.state.moments().emittance[:2]:
        assert abs(emittance / expected - 1) < 5 / np.sqrt(2 * count)


def test_a_source_inside_sends_along_its_own_axis():
    plane = {"centre": [0, 0, "5 mm"], "direction": [1, 0, 0]}
    spot = {"shape": "disc", "radius": "1 mm"}
    domain = {"lower": -1e-2, "upper": 1e-2, "cells": 16}
    source = {"face": None, "plane": plane, "spot": spot, "current": -1e-18, "per_step": 50, "momenta": beam_of(SLOW)}
    run = Simulation(MPI.COMM_SELF, scene(source, domain=domain))
    run.advance(10)
    x, y, z = run.particles.position.T
    assert (x >= 0).all() and x.max() == pytest.approx(SLOW * run.time, rel=0.01)
    assert np.hypot(y, z - 5e-3).max() <= 1e-3 * (1 + 1e-12)


def test_a_source_partly_outside_is_remarked_on_and_goes_on():
    spot = {"shape": "disc", "radius": "1 mm"}
    domain = {"lower": [0, -1e-2, 0], "upper": 1e-2, "cells": 16}
    run = Simulation(MPI.COMM_SELF, scene({**FAINT, "spot": spot}, domain=domain))
    run.advance(10)
    assert len(run.particles) == run.state.tallies.of[0].particles < 80
    assert [remark for remark in run.remarks if "outside of the domain" in remark]


def test_births_in_a_window_are_those_of_the_laboratory():
    """A bunch flies off with the window; the source is a plane that the window passes, and gives the same particles."""
    plane = {"centre": [0, 0, "1 mm"]}
    source = {
        "face": None, "plane": plane, "spot": {"shape": "disc", "radius": "1 mm"}, "current": -1e-20, "per_step": 8,
        "momenta": beam_of(SLOW),
    }  # fmt: skip
    bunch = {"distribution": "gaussian", "species": "electron", "sigma": 1e-4, "charge": -1e-26, "particles": 10}
    bunch |= {"velocity": [0, 0, SLOW]}
    domain = {"lower": [-5e-3, -5e-3, -5e-3], "upper": 5e-3, "cells": 16}
    runs = [
        Simulation(
            MPI.COMM_SELF,
            scene(source, bunches=[bunch], domain=domain, motion={"kind": "leapfrog", "dt": STEP, "window": window}),
        )
        for window in ("none", "reference")
    ]
    for run in runs:
        run.advance(20)
    one, other = (ordered(MPI.COMM_SELF, run) for run in runs)
    other[:, 1:4] += runs[1].window.origin
    np.testing.assert_allclose(other, one, rtol=1e-9, atol=1e-15)
    assert runs[1].window.origin[2] > 1e-3


@pytest.mark.parametrize(
    ("source", "words"),
    [
        ({"face": "w_lower"}, "face"),
        ({"face": None}, "is missing"),
        ({"plane": {}}, "is given as well as plane"),
        ({"face": None, "plane": {}}, "is missing"),
        ({"face": None, "plane": {"direction": [0, 0, 0]}}, "points nowhere"),
        ({"species": {"charge": 0, "mass": 1}}, "has no charge"),
        ({"current": None}, "is missing"),
        ({"current": 1e-18}, "has not the sign"),
        ({"charge": -1e-18}, "is not what a steady pulse has"),
        ({"per_step": None}, "is missing, as are particle_charge and per_step"),
        ({"particles": 5}, "is given as well as per_step"),
        ({"per_step": None, "particles": 5}, "a pulse without an end"),
        ({"per_step": 0}, "per_step"),
        ({"pulse": {"shape": "steady", "stop": 0}}, "is not after start"),
        ({"pulse": {"shape": "flat", "length": 0}}, "length"),
        ({"pulse": {"shape": "round"}}, "unknown shape"),
        ({"pulse": {"shape": "table", "times": [0, 1], "values": [1]}}, "has 1 members"),
        ({"pulse": {"shape": "table", "times": [1, 0], "values": [1, 1]}}, "do not ascend"),
        ({"pulse": {"shape": "table", "times": [0, 1], "values": [0, 0]}}, "are all zero"),
        ({"momenta": {"kind": "thermal", "energy": "0.1 kV"}}, "energy"),
        ({"momenta": {"kind": "thermal", "energy": "100 keV"}}, "not relativistic"),
        ({"momenta": {"kind": "thermal"}}, "energy is missing"),
        (
            {
                "momenta": {
                    "kind": "three-step",
                    "photon_energy": "4 eV",
                    "work_function": "5 eV",
                    "fermi_energy": "7 eV",
                }
            },
            "does not exceed the work function",
        ),
        ({"spot": {"shape": "disc", "radius": -1}}, "radius"),
        ({"spot": {"shape": "gaussian", "sigma": [1e-3, 0]}}, "sigma"),
        ({"spot": {"shape": "gaussian", "sigma": 1e-3}}, "sigma (0.001) is no list; write sigma = […, …]"),
        ({"process": "photo", "momenta": None}, "mean_transverse_energy"),
        (
            {"process": "photo", "momenta": None, "mean_transverse_energy": "1 eV", "laser_energy": 1},
            "goes with all of",
        ),
        ({"name": "a b"}, "cannot stand in tables"),
        ({"curent": 1}, "unknown key"),
        ({"process": "magic"}, "process"),
    ],
)
def test_bad_sources_are_refused_in_one_sentence(source, words):
    with pytest.raises(SceneError) as refused:
        scene({**FAINT, **source})
    text = str(refused.value)
    assert words in text and "sources.0" in text and "; " in text and "\n" not in text


def test_sources_need_a_motion():
    with pytest.raises(SceneError, match="leapfrog"):
        scene(FAINT, motion={"kind": "none"})


def test_names_of_sources_differ():
    with pytest.raises(SceneError, match="name"):
        scene({}, sources=[{"process": "given", "face": "z_lower", "name": "gun", **FAINT}] * 2)

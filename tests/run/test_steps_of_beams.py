"""Steps that a run chooses for a beam in its own field: what they give is what much shorter ones give."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
from mpi4py import MPI

import amrpic
from amrpic.pic import time_step
from amrpic.pic.setup import Setup
from amrpic.pic.step import begin
from amrpic.units import (
    ELECTRON_MASS,
    ELEMENTARY_CHARGE,
    PROTON_MASS,
    SPEED_OF_LIGHT,
    VACUUM_PERMITTIVITY,
)

MASSES = {"electron": ELECTRON_MASS, "proton": PROTON_MASS}


def flown(given: dict[str, Any], steps: int, dt: Any = "auto") -> amrpic.Simulation:
    run = amrpic.Simulation(MPI.COMM_SELF, amrpic.Scene.from_dict({**given, "motion": {**given["motion"], "dt": dt}}))
    run.advance(steps)
    return run


@pytest.mark.parametrize("pusher", ["higuera-cary", "boris"])
def test_a_dense_fast_beam_gains_what_its_own_field_gives(pusher):
    """1 nC at 250 MeV: q E Δt is 0.7 γ m c, and what E + v × B leaves of it 1/γ² of that. Values by steps 32 times shorter."""
    bunch = {
        "distribution": "gaussian",
        "species": "electron",
        "kinetic_energy": "250 MeV",
        "sigma": ["0.1 mm", "0.1 mm", "10 um"],
        "charge": "-1 nC",
        "particles": 4096,
        "sampling": "sobol",
    }
    given = {
        "domain": {"lower": ["-0.8 mm", "-0.8 mm", "-60 um"], "upper": ["0.8 mm", "0.8 mm", "60 um"], "cells": 24},
        "bunches": [bunch],
        "motion": {"kind": "leapfrog", "window": "reference", "pusher": pusher},
    }
    run = flown(given, 12)
    momentum, start = run.particles.momentum, flown(given, 0).particles.momentum[:, 2].mean()
    assert run.time == pytest.approx(4.28e-9, rel=0.05) and not run.remarks
    assert momentum[:, 2].mean() / start - 1 == pytest.approx(1.59e-4, abs=3e-6)
    assert momentum[:, 2].std() / start == pytest.approx(1.98e-3, rel=0.01)
    assert momentum[:, 0].std() / start == pytest.approx(2.57e-5, rel=0.01)
    noted = (
        "motion.pusher: higuera-cary while the particles have a magnetic field of their own" in run._setup.remarks.notes
    )
    assert noted is (pusher == "boris")
    assert any("is long" in remark for remark in flown(given, 0, 30 * run.time / 12).remarks)


def random_beam(number: int) -> dict[str, Any]:
    """1 eV to 1 GeV, pancakes to needles, 1 fC to 10 nC, in a drift or an element."""
    rng = np.random.default_rng([45, number])

    def between(low: float, high: float) -> float:
        return float(10 ** rng.uniform(math.log10(low), math.log10(high)))

    species = ("electron", "electron", "proton")[rng.integers(3)]
    sign, mc = (-1 if species == "electron" else 1), MASSES[species] * SPEED_OF_LIGHT
    gamma = 1 + between(1, 1e9) * ELEMENTARY_CHARGE / (mc * SPEED_OF_LIGHT)
    p = math.sqrt(gamma**2 - 1) * mc
    x = between(1e-5, 1e-3)
    size = np.array([x, x * between(0.5, 2), x * between(0.03, 30)])
    element: dict[str, Any] = {
        "drift": {},
        "quadrupole": {"length": 1e6, "gradient": between(0.01, 100)},
        "solenoid": {"length": 1e6, "field": between(0.01, 3)},
        "constant-focusing": {"wavenumber": [between(0.1, 30)] * 2 + [0]},
        "rf-gap": {"length": between(0.01, 1), "voltage": between(1e2, 1e6), "frequency": between(1e8, 3e9)},
        "uniform": {"electric_field": [0, 0, sign * between(1e3, 1e7)], "magnetic_field": [0, between(1e-3, 1), 0]},
    }
    kind = list(element)[number % len(element)]
    bunch = {
        "distribution": "gaussian",
        "species": species,
        "sigma": size.tolist(),
        "charge": sign * between(1e-15, 1e-8),
        "particles": 1000,
        "sampling": "sobol",
        "momentum": [0, 0, p],
        "momentum_spread": [between(1e-6, 1e-2) * p] * 3,
    }
    return {
        "domain": {"lower": (-8 * size).tolist(), "upper": (8 * size).tolist(), "cells": 16},
        "bunches": [bunch],
        "elements": [] if kind == "drift" else [{"kind": kind, **element[kind]}],
        "motion": {"kind": "leapfrog", "window": "reference", "pusher": ("higuera-cary", "boris")[number // 6 % 2]},
    }


@pytest.mark.parametrize(
    "number, shorter", [*((n, 4) for n in range(3)), *(pytest.param(n, 32, marks=pytest.mark.long) for n in range(30))]
)
def test_steps_of_random_beams_give_what_much_shorter_ones_give(number, shorter):
    """Over 20 steps or a plasma period, the shorter: mean p_z within 1e-3, spread and rms momenta within 5 %."""
    given = random_beam(number)
    chosen = amrpic.Scene.from_dict({**given, "motion": {**given["motion"], "dt": "auto"}})
    state, setup = begin(MPI.COMM_SELF, chosen)
    omega = time_step.plasma_frequency(state.particles, state.hierarchy, setup.clouds, state.solution.frames)
    steps = min(20, math.ceil(2 * math.pi / omega / setup.dt))
    runs = flown(given, steps), flown(given, shorter * steps, setup.dt / shorter)
    (mean, spread, rms), exact = (
        (p[:, 2].mean(), p.std(axis=0), np.sqrt((p**2).mean(axis=0))) for p in (run.particles.momentum for run in runs)
    )
    assert runs[0].time == pytest.approx(runs[1].time) and not any("is long" in remark for remark in runs[0].remarks)
    assert mean == pytest.approx(exact[0], rel=1e-3)
    assert spread == pytest.approx(exact[1], rel=0.05) and rms == pytest.approx(exact[2], rel=0.05)


# ---- rules ----


def ball(u: float, charge: float, radius: float, dt: Any = "auto") -> dict[str, Any]:
    """A uniform ball of electrons, as seen at rest, that moves with βγ = u."""
    gamma = math.hypot(1, u)
    sizes = np.array([radius, radius, radius / gamma])
    bunch = {
        "distribution": "hollow",
        "inner": 0.0,
        "species": "electron",
        "charge": -charge,
        "particles": 20_000,
        "sampling": "sobol",
        "sigma": (sizes / math.sqrt(5)).tolist(),
        "momentum": [0, 0, u * ELECTRON_MASS * SPEED_OF_LIGHT],
    }
    return {
        "domain": {"lower": (-2 * sizes).tolist(), "upper": (2 * sizes).tolist(), "cells": 32},
        "bunches": [bunch],
        "motion": {"kind": "leapfrog", "dt": dt, "window": "reference" if u else "none"},
        "output": {"write": []},
    }


def begun(given: dict[str, Any], comm: MPI.Comm = MPI.COMM_SELF) -> Setup:
    return begin(comm, amrpic.Scene.from_dict(given))[1]


@pytest.mark.mpi(ranks=(1, 2))
@pytest.mark.parametrize("u", [0.0, 10.0])
def test_a_field_that_gives_m_c_within_few_steps_sets_them(comm, u):
    """At the edge of a ball of 10 nC and 10 μm, 0.9 TV/m; one that moves has γ times as long steps."""
    charge, radius = 1e-8, 1e-5
    setup = begun(ball(u, charge, radius), comm)
    field = charge / (4 * np.pi * VACUUM_PERMITTIVITY * radius**2)
    time = ELECTRON_MASS * SPEED_OF_LIGHT / (ELEMENTARY_CHARGE * field) * math.hypot(1, u)
    assert setup.dt == pytest.approx(time / time_step.PER_GAIN, rel=0.1)
    assert (
        "m c across the motion in the particles' own field" if u else "γ m c in the particles' own"
    ) in setup.remarks.notes[-1]
    assert not setup.remarks.warnings
    [remark] = [
        one for one in begun(ball(u, charge, radius, 12 * setup.dt), comm).remarks.warnings if "particles' own" in one
    ]
    assert "at least 4 are advisable" in remark


@pytest.mark.mpi(ranks=(1, 2))
@pytest.mark.parametrize("u", [0.0, 2.0])
def test_light_particles_in_the_charge_of_heavy_ones_set_the_step(comm, u):
    """A few electrons at rest in a ball of protons, which moves or not: ω² = e ρ / (ε0 m), ρ in the laboratory."""
    charge, radius = 1e-10, 1e-3
    given = ball(u * PROTON_MASS / ELECTRON_MASS, charge, radius)
    gamma = math.hypot(1, u)
    sizes = np.array([radius, radius, radius / gamma])
    given["domain"] |= {"lower": (-2 * sizes).tolist(), "upper": (2 * sizes).tolist(), "cells": 16}
    [protons] = given["bunches"]
    protons |= {"species": "proton", "charge": charge, "sigma": (sizes / math.sqrt(5)).tolist()}
    electrons = {**protons, "species": "electron", "charge": -1e-16, "momentum": [0, 0, 0], "particles": 100}
    given["bunches"] = [protons, electrons]
    found = []
    for bunches in ([protons], [protons, electrons]):
        state, setup = begin(comm, amrpic.Scene.from_dict({**given, "bunches": bunches}))
        found.append(time_step.oscillation(state.particles, state.hierarchy, setup.clouds, state.solution.frames))
    density = charge * gamma / (4 / 3 * np.pi * radius**3)
    alone, light = (density * ELEMENTARY_CHARGE / (VACUUM_PERMITTIVITY * m) for m in (PROTON_MASS, ELECTRON_MASS))
    assert found[0] == pytest.approx(math.sqrt(alone / gamma**3), rel=0.05)
    assert found[1] == pytest.approx(math.sqrt(light), rel=0.05)
    if u == 0:
        assert setup.dt == pytest.approx(2 * np.pi / found[1] / time_step.PER_PLASMA_PERIOD)
        assert "oscillation of a particle in the charge of all" in setup.remarks.notes[-1]


def test_a_beam_that_grows_dense_gets_a_remark_at_a_later_step(monkeypatch):
    """A ball at rest with 20 steps per plasma period, which focusing shrinks to half within five."""
    monkeypatch.setattr(time_step, "EVERY", 5)
    charge, radius = 1e-12, 1e-3
    density = charge / (4 / 3 * np.pi * radius**3)
    dt = 2 * np.pi / 20 / math.sqrt(density * ELEMENTARY_CHARGE / (VACUUM_PERMITTIVITY * ELECTRON_MASS))
    given = ball(0.0, charge, radius)
    given["domain"]["cells"] = 16
    given["bunches"][0]["particles"] = 5000
    gradient = -ELECTRON_MASS / ELEMENTARY_CHARGE * (0.26 / dt) ** 2
    given["elements"] = [{"kind": "constant-focusing", "gradient": [gradient] * 3}]
    run = flown(given, 4, dt)
    assert not any("is long" in remark for remark in run.remarks)
    run.advance(1)
    [remark] = [remark for remark in run.remarks if "is long at step 5" in remark]
    assert "plasma period" in remark and "go on from an earlier checkpoint" in remark
    run.advance(5)
    assert sum("is long at step" in remark for remark in run.remarks) == 1


def test_the_log_says_what_a_run_chooses_while_it_goes_on(capsys, tmp_path):
    """Electrons that an electric field makes fast, from the step on in which they are; once, and not again by a restart."""
    given = {
        "domain": {"lower": "-8 mm", "upper": "8 mm", "cells": 8},
        "bunches": [
            {"distribution": "sphere", "species": "electron", "radius": "1 mm", "charge": "-1 fC", "particles": 50}
        ],
        "elements": [{"kind": "uniform", "electric_field": [0, 0, -1e7]}],
        "motion": {"kind": "leapfrog", "dt": "1 ps", "pusher": "boris"},
        "schedule": {"steps": 8},
        "output": {"write": ["checkpoint"], "checkpoint_every": 6, "directory": str(tmp_path)},
    }
    amrpic.Simulation(MPI.COMM_SELF, amrpic.Scene.from_dict(given)).run()
    lines = capsys.readouterr().out.splitlines()
    [said] = [n for n, line in enumerate(lines) if line.startswith("motion.pusher: higuera-cary")]
    assert any(line.startswith("step 0/8") for line in lines[:said])
    amrpic.Simulation.restart(MPI.COMM_SELF, tmp_path / "checkpoint_00000006").run()
    assert "motion.pusher" not in capsys.readouterr().out

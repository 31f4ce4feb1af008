# mypy: disable-error-code="union-attr"
"""Runs with electrodes: voltages of the step's time, charge balance, hits, restarts, and the same answers on any ranks."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pytest
from mpi4py import MPI
from scipy.constants import epsilon_0
from scipy.integrate import solve_ivp

import amrpic
from amrpic import Scene, Simulation
from amrpic.errors import InputError
from amrpic.io import time_series
from amrpic.pic.meshed import MeshedParticles
from amrpic.pic.metal_images import neglected
from amrpic.pic.time_step import swing
from amrpic.units import ELEMENTARY_CHARGE, PROTON_MASS
from rank_subsets import first_ranks, wait_quietly

BALL = {"name": "ball", "shape": {"kind": "sphere", "centre": [0, 0, 8e-3], "radius": 5e-3}, "voltage": 100}
FINE = {"lower": -0.02, "upper": 0.02, "cells": 40, "boundary": "dirichlet"}
FREE = {"name": "free", "shape": {"kind": "sphere", "centre": [-0.01, 0, 0], "radius": 3e-3}, "charge": 1e-13}
BEAM = {
    "distribution": "gaussian",
    "species": "proton",
    "sigma": 2e-3,
    "cutoff": 3,
    "centre": [0, 0, -8e-3],
    "velocity": [0, 0, 3e5],
    "charge": 1e-12,
    "particles": 1500,
}


def scene(folder: Path | None = None, **changes: Any) -> Scene:
    """A bunch that flies onto a ball and past another one that floats, in a grounded box."""
    data: dict[str, Any] = {
        "domain": {"lower": -0.02, "upper": 0.02, "cells": 16, "boundary": "dirichlet"},
        "bunches": [BEAM],
        "electrodes": [BALL, FREE],
        "motion": {"kind": "leapfrog", "dt": 4e-9},
        "schedule": {"steps": 20},
        "solver": {"tolerance": 1e-10},
        "output": {"directory": str(folder), "write": ["series", "losses", "checkpoint"], "checkpoint_every": 8},
    }
    return Scene.from_dict({**data, **changes})


def run(comm: Any, described: Scene) -> Simulation:
    simulation = Simulation(comm, described)
    simulation.run(log="silent")
    return simulation


def wave(volts: float = 100.0) -> dict[str, Any]:
    return {**BALL, "voltage": f"{volts} V*cos(2*pi*20 MHz*t)"}


def test_a_voltage_that_varies_gives_what_solves_at_each_time_give():
    """The sum of unit solutions is compared with a solver that has the voltage of the time and all charge at once."""
    simulation = Simulation(MPI.COMM_SELF, scene(electrodes=[wave(), FREE]))
    electrodes = [section.value for section in simulation.scene.electrodes]
    for steps in (2, 3):
        state = simulation.advance(steps)
        solver = amrpic.PoissonSolver(simulation.hierarchy, electrodes=electrodes, tolerance=1e-11)
        phi, report = solver.solve(state.rho, time=state.time)
        assert abs((phi - state.phi).max_abs()) < 1e-7 * phi.max_abs()
        assert simulation.report.charges == pytest.approx(report.charges, rel=1e-8)
        assert simulation.report.voltages == pytest.approx(report.voltages, rel=1e-8)
        assert simulation.report.voltages["ball"] == pytest.approx(100 * np.cos(4e7 * np.pi * state.time), rel=1e-12)
        for ours, other in zip(state.efield.components, solver.electric_field(phi).components, strict=True):
            assert (ours - other).max_abs() < 1e-6 * other.max_abs()


def test_steps_that_a_run_chooses_follow_a_voltage_that_swings():
    """They are 1/640 of its period if automatic; if they grow, 1/100; and a remark is made below 20."""
    period, beam = 50e-9, {**BEAM, "velocity": [0, 0, 1e3], "charge": 1e-20}
    described = scene(electrodes=[wave(1e-6), FREE], bunches=[beam], motion={"kind": "leapfrog", "dt": "auto"})
    assert Simulation(MPI.COMM_SELF, described).state.staggered.dt == pytest.approx(period / 640, rel=0.1)
    growing = {"kind": "leapfrog", "dt": period / 400, "growth": 0.2}
    simulation = Simulation(MPI.COMM_SELF, scene(electrodes=[wave(1e-6), FREE], bunches=[beam], motion=growing))
    simulation.advance(24)
    assert simulation.state.staggered.dt == pytest.approx(period / 100, rel=0.1)
    coarse = {"kind": "leapfrog", "dt": period / 12}
    [remark] = Simulation(MPI.COMM_SELF, scene(electrodes=[wave(1e-6), FREE], bunches=[beam], motion=coarse)).remarks
    assert "steps per swing of the voltage of ball" in remark


@pytest.mark.parametrize(
    ("voltage", "span", "expected"),
    [
        ("cos(2*pi*1e6*t)", 1e-3, 1e-6),
        ("1e3 + cos(2*pi*1e6*t)", 1.0, 1e-6),
        ("5*t", 1e-3, 2.2e-3),
    ],
)
def test_how_fast_a_voltage_swings_is_found_by_its_values(voltage, span, expected):
    electrode = amrpic.Electrode("ball", amrpic.shapes.Sphere((0, 0, 0), 1), voltage=voltage)
    assert swing(electrode, 7e-3, span) == pytest.approx(expected, rel=0.1)


def test_a_voltage_that_jumps_or_stays_asks_for_no_step():
    for voltage in ("100*(1 + tanh((t - 1e-4)/1e-12))", "min(1e6*t, 100)"):
        electrode = amrpic.Electrode("ball", amrpic.shapes.Sphere((0, 0, 0), 1), voltage=voltage)
        assert swing(electrode, 1e-5, 1e-3) > 2e-3


def test_metal_is_cut_anew_on_a_mesh_that_follows_the_bunch():
    """The ball is in a refined box that stays, the bunch in one that moves; the answer is that of a solver made for it."""
    rule = {
        "kind": "any",
        "of": [
            {"kind": "static", "boxes": [{"level": 1, "lower": [-8e-3, -8e-3, 0], "upper": [8e-3, 8e-3, 16e-3]}]},
            {"kind": "charge-density", "relative": 0.2},
        ],
    }
    simulation = Simulation(
        MPI.COMM_SELF,
        scene(
            domain={**FINE, "cells": 32},
            electrodes=[{**wave(), "shape": {"kind": "sphere", "centre": [0, 0, 8e-3], "radius": 4e-3}}],
            bunches=[{**BEAM, "centre": [-7e-3, 0, -14e-3], "sigma": 1e-3}],
            refinement={"levels": 1, "regrid_every": 4, "rule": rule},
        ),
    )
    before = simulation.hierarchy
    state = simulation.advance(6)
    assert state.hierarchy is not before and state.hierarchy.levels == 2
    electrodes = [section.value for section in simulation.scene.electrodes]
    phi, report = amrpic.PoissonSolver(state.hierarchy, electrodes=electrodes, tolerance=1e-11).solve(
        state.rho, time=state.time
    )
    assert (phi - state.phi).max_abs() < 1e-7 * phi.max_abs()
    assert state.solution.charges == pytest.approx(report.charges, rel=1e-8)


def test_field_energy_is_that_outside_the_metal(tmp_path):
    """½ Σ Q V of the sheets of a capacitor and of a ball in a box, as E goes on into metal for the clouds alone."""
    gap: list[dict[str, Any]] = [
        {"name": "low", "shape": {"kind": "box", "lower": -0.03, "upper": [0.03, 0.03, -0.009]}, "voltage": 0},
        {"name": "high", "shape": {"kind": "box", "lower": [-0.03, -0.03, 0.011], "upper": 0.03}, "voltage": 100},
    ]
    ball = [{**BALL, "shape": {"kind": "sphere", "centre": 0, "radius": 9e-3}}]
    sides = {"x": "periodic", "y": "periodic", "z": "dirichlet"}
    cases: list[tuple[list[dict[str, Any]], dict[str, Any], float]] = [
        (gap, {"boundary": sides, "potential": {"z": [0, 100]}}, 1e-8),
        (ball, {}, 0.03),
    ]
    for electrodes, faces, within in cases:
        domain = {**FINE, **faces}
        described = scene(tmp_path, domain=domain, electrodes=electrodes, bunches=[], schedule={"steps": 0})
        simulation = run(MPI.COMM_SELF, described)
        charge = simulation.state.solution.charges[electrodes[-1]["name"]]
        energy = time_series.read(tmp_path / "series.csv")["field_energy"][-1]
        assert energy == pytest.approx(charge * 100 / 2, rel=within)


def test_charge_of_all_electrodes_and_walls_is_minus_that_of_the_beam_inside(tmp_path):
    """Gauss's law in a hollow block that holds a bunch, part of whose clouds lie in the metal."""
    hollow = {
        "kind": "difference",
        "of": [
            {"kind": "box", "lower": -0.018, "upper": 0.018},
            {"kind": "box", "lower": -0.0093, "upper": [0.0093, 0.0093, 0.011]},
        ],
    }
    held = [{"name": "block", "shape": hollow, "voltage": 30}]
    bunch = {**BEAM, "centre": [0.0075, 0, 0], "cutoff": 1.2, "velocity": [0, 0, 0]}
    simulation = Simulation(MPI.COMM_SELF, scene(electrodes=held, bunches=[bunch]))
    state = simulation.state
    outside = Simulation(MPI.COMM_SELF, scene(electrodes=held, bunches=[])).state.solution.charges["block"]
    inside = state.rho.integral()
    assert state.solution.charges["block"] - outside == pytest.approx(-inside, rel=1e-8)


def test_charge_of_hits_leaves_a_held_electrode_and_stays_on_one_that_floats(tmp_path):
    free = {**FREE, "shape": {"kind": "sphere", "centre": [-2e-3, 0, 0], "radius": 2e-3}}
    simulation = run(MPI.COMM_SELF, scene(tmp_path, electrodes=[BALL, free]))
    series = time_series.read(tmp_path / "series.csv")
    lost = simulation.lost
    for name in ("ball", "free"):
        mine = lost.cause == lost.names.index(name)
        charge = float((lost.particles.weight * lost.particles.charge)[mine].sum())
        assert mine.sum() > 50
        assert series[f"hit_charge_{name}"][-1] == pytest.approx(charge, rel=1e-12)
    # what floats has its own charge and that of the hits, at each step
    assert series["charge_free"] == pytest.approx(1e-13 + series["hit_charge_free"], rel=1e-9)
    assert (series["current_free"] == 0).all()
    # the supply's current adds up to the change of the charge without hits
    supplied = np.sum(series["current_ball"][1:] * np.diff(series["time"]))
    change = series["charge_ball"][-1] - series["charge_ball"][0] - series["hit_charge_ball"][-1]
    assert supplied == pytest.approx(change, rel=1e-9)
    assert series["particles"][-1] + series["lost_particles"][-1] == BEAM["particles"]


def test_hits_are_where_straight_ways_meet_the_surface(tmp_path):
    """Places, angles and energies of a cold beam without charge on a ball and a plate, by geometry."""
    beam = {**BEAM, "charge": 1e-22, "cutoff": 2.0}
    plate = {"name": "plate", "shape": {"kind": "disk", "centre": [0, 0, 0.015], "radius": 0.01}, "voltage": 0}
    ball = {**BALL, "voltage": 0, "shape": {"kind": "sphere", "centre": [0, 0, 8e-3], "radius": 2e-3}}
    described = scene(tmp_path, bunches=[beam], electrodes=[ball, plate], schedule={"steps": 26})
    start = Simulation(MPI.COMM_SELF, described).particles
    x, y, _ = np.array(start.position)[np.argsort(start.id)].T
    run(MPI.COMM_SELF, described)
    with h5py.File(tmp_path / "losses.h5") as file:
        [species] = file[next(iter(file["data"].values())).name + "/particles"].values()
        number, status = species["id"][:], species["particleStatus"][:]
        place = np.stack([species[f"position/{axis}"][:] for axis in "xyz"], axis=1)
        incidence, causes = species["incidence"][:], list(file["amrpic/causes"].asstr()[:])
    radius = np.hypot(x, y)
    hit = np.array(causes)[status - 2]
    assert set(number[hit == "ball"]) == set(np.flatnonzero(radius < 2e-3))
    assert len(hit) == len(x)
    r = radius[number]
    expected = np.where(hit == "ball", 8e-3 - np.sqrt(np.maximum(4e-6 - r**2, 0)), 0.015)
    assert place[:, 2] == pytest.approx(expected, abs=1e-9)
    assert incidence == pytest.approx(np.where(hit == "ball", np.arcsin(np.minimum(r / 2e-3, 1)), 0.0), abs=1e-4)


def test_currents_are_those_of_shockley_and_ramo():
    """Charge that moves by v induces -q φ₁ on an electrode whose potential is φ₁ with it at 1 V and all else at zero."""
    simulation = Simulation(MPI.COMM_SELF, scene(electrodes=[{**BALL, "voltage": 0}], domain=FINE))
    electrodes = [section.value for section in simulation.scene.electrodes]
    unit = amrpic.PoissonSolver(simulation.hierarchy, electrodes=electrodes, tolerance=1e-10).unit_potential("ball")
    charges, expected = [], []
    for steps in (0, 3):
        state = simulation.advance(steps)
        charges.append(state.solution.charges["ball"])
        expected.append(-(state.rho * unit).integral())
    assert charges == pytest.approx(expected, rel=2e-3)
    assert charges[1] - charges[0] == pytest.approx(expected[1] - expected[0], rel=5e-3)


def test_electrodes_stay_in_the_laboratory_while_a_window_moves_on(tmp_path):
    domain = {"lower": [-0.01, -0.01, -0.015], "upper": [0.01, 0.01, 0.015], "cells": [20, 20, 30], "boundary": "open"}
    small = {"kind": "sphere", "centre": [2e-3, 0, 2e-3], "radius": 2e-3}
    described = scene(
        tmp_path,
        domain=domain,
        bunches=[{**BEAM, "centre": [0, 0, -5e-3], "sigma": 1e-3}],
        electrodes=[{"name": "ball", "shape": small, "voltage": "50 V*cos(2*pi*5 MHz*t)"}],
        motion={"kind": "leapfrog", "dt": 2e-9, "window": "reference"},
        schedule={"steps": 10},
    )
    simulation = run(MPI.COMM_SELF, described)
    state = simulation.state
    assert state.window.origin[2] == pytest.approx(3e5 * 2e-8, rel=0.05)
    volts = 50 * np.cos(2 * np.pi * 5e6 * state.time)
    centre = np.array(small["centre"]) - state.window.origin
    assert state.phi.sample([centre])[0] == pytest.approx(volts, rel=1e-6)
    place = np.array(simulation.lost.particles.position)[simulation.lost.cause == simulation.lost.names.index("ball")]
    assert len(place) > 20
    assert np.linalg.norm(place - small["centre"], axis=1) == pytest.approx(2e-3, rel=1e-9)


@pytest.mark.parametrize("electrodes", [[BALL, FREE], [wave(), FREE]], ids=["constant", "varies"])
def test_a_restart_goes_on_bit_by_bit(tmp_path, electrodes):
    whole = Simulation(MPI.COMM_SELF, scene(electrodes=electrodes))
    whole.advance(11)
    whole.checkpoint(tmp_path / "half")
    whole.advance(3)
    again = Simulation.restart(MPI.COMM_SELF, tmp_path / "half")
    again.advance(3)
    assert len(whole.lost) > 0
    for ours, other in ((whole.particles.position, again.particles.position), (whole.lost.time, again.lost.time)):
        assert np.array_equal(ours, other)
    assert np.array_equal(whole.phi.array(0), again.phi.array(0))
    assert whole.state.solution.charges == again.state.solution.charges
    assert whole.state.solution.voltages == again.state.solution.voltages


@pytest.mark.mpi(ranks=3, timeout=180)
def test_ranks_change_the_last_digits_at_most(comm, tmp_path):
    alone: Any = None
    for ranks in (1, 2, 3):
        part = first_ranks(ranks)
        if part:
            simulation = run(part, scene(tmp_path / str(ranks), electrodes=[wave(), FREE], schedule={"steps": 10}))
            series = time_series.read(tmp_path / str(ranks) / "series.csv") if part.rank == 0 else None
            if series is not None:
                columns = [name for name in series.dtype.names if name.endswith(("_ball", "_free"))]
                alone = series if ranks == 1 else alone
                for name in [*columns, "lost_particles", "mean_z", "rms_x"]:
                    scale = abs(alone[name]).max()
                    assert series[name] == pytest.approx(alone[name], abs=1e-8 * scale)
            assert simulation.step == 10
        wait_quietly(comm)


def test_a_scene_without_electrodes_has_no_columns_and_no_solves_for_them(tmp_path):
    run(MPI.COMM_SELF, scene(tmp_path, electrodes=[], schedule={"steps": 2}))
    series = time_series.read(tmp_path / "series.csv")
    assert not [name for name in series.dtype.names if name.startswith(("voltage_", "hit_charge_", "current_"))]


# ---- fast bunches beside metal ----

C = 299792458.0
PIPE = {
    "kind": "difference",
    "of": [
        {"kind": "box", "lower": [-0.02, -0.02, -1], "upper": [0.02, 0.02, 1]},
        {"kind": "cylinder", "start": [0, 0, -2], "end": [0, 0, 2], "radius": 8e-3},
    ],
}
IRIS = {
    "kind": "difference",
    "of": [
        {"kind": "cylinder", "start": [0, 0, -1e-3], "end": [0, 0, 1e-3], "radius": 7e-3},
        {"kind": "cylinder", "start": [0, 0, -1], "end": [0, 0, 1], "radius": 4e-3},
    ],
}


def fast(gamma: float, shape: dict[str, Any], boundary: Any, **changes: Any) -> Scene:
    """A bunch that flies fast up z beside metal."""
    momentum = PROTON_MASS * C * np.sqrt(gamma**2 - 1)
    beam = {
        **BEAM,
        "momentum": [0, 0, momentum],
        "sigma": [6e-4, 6e-4, 8e-3],
        "centre": [2e-3, 0, 0],
        "sampling": "sobol",
    }
    del beam["velocity"]
    data: dict[str, Any] = {
        "domain": {
            "lower": [-0.01, -0.01, -0.04],
            "upper": [0.01, 0.01, 0.04],
            "cells": [40, 40, 40],
            "boundary": boundary,
        },
        "bunches": [{**beam, "particles": 8192, **changes.pop("beam", {})}],
        "electrodes": [{"name": "metal", "shape": shape, "voltage": changes.pop("voltage", 0)}],
        "motion": {"kind": "leapfrog", "dt": 1e-12},
    }
    return scene(**data, **changes)


@pytest.mark.parametrize("gamma", [1.2, 5.0, 100.0])
def test_a_round_pipe_pulls_a_fast_bunch_as_the_image_of_a_line_charge(gamma):
    """Within 0.4 % for a bunch that is nine times as long as the pipe is wide; half of that by clouds of 1/6 of its length."""
    x0, b, sigma = 2e-3, 8e-3, 72e-3
    domain = {"lower": [-0.01, -0.01, -5 * sigma], "upper": [0.01, 0.01, 5 * sigma], "cells": [40, 40, 60]}
    described = fast(gamma, PIPE, "dirichlet", beam={"sigma": [6e-4, 6e-4, sigma]}).to_dict()
    faces = {"x": "dirichlet", "y": "dirichlet", "z": "periodic"}
    simulation = Simulation(MPI.COMM_SELF, Scene.from_dict({**described, "domain": {**domain, "boundary": faces}}))
    # the line density of a Gaussian with the cutoff at 3 sigma, at its own charge
    density = 1e-12 / (2 * np.sqrt(np.pi) * sigma) * math.erf(3) / math.erf(3 / math.sqrt(2)) ** 2
    expected = ELEMENTARY_CHARGE * density / (2 * np.pi * epsilon_0) / (b**2 / x0 - x0) / gamma**2
    before = np.array(simulation.particles.momentum)
    simulation.advance(2)
    change = (np.array(simulation.particles.momentum)[:, 0].mean() - before[:, 0].mean()) / 2e-12
    assert change == pytest.approx(expected, rel=0.01)
    assert any("uniform along the motion" in note for note in simulation._setup.remarks.notes)
    assert not simulation.remarks


def test_voltages_beside_a_fast_bunch_are_solved_at_rest_and_have_no_magnetic_field():
    described = fast(5.0, IRIS, "open", voltage="3 kV", beam={"charge": 1e-24, "cutoff": 2, "sigma": 6e-4})
    simulation = Simulation(MPI.COMM_SELF, described)
    electrodes = [section.value for section in described.electrodes]
    phi, _ = amrpic.PoissonSolver(simulation.hierarchy, electrodes=electrodes, tolerance=1e-10).solve(
        amrpic.Field(simulation.hierarchy)
    )
    assert (phi - simulation.phi).max_abs() < 1e-6 * 3e3
    speed = 3e3 / 1e-2 / C  # what the field would make of it
    assert max(part.max_abs() for part in simulation.bfield.components) < 1e-9 * speed


def test_images_that_do_not_move_along_are_estimated_and_refused_where_they_are_all():
    near = {"sigma": [6e-4, 6e-4, 1e-3], "centre": [1e-3, 0, -2e-3], "cutoff": 3}
    far = {"sigma": [6e-4, 6e-4, 1e-3], "centre": [0, 0, -2.5e-2], "cutoff": 3}
    [remark] = Simulation(MPI.COMM_SELF, fast(2.0, IRIS, "open", beam=near)).remarks
    assert "electrodes are not uniform along the motion: about" in remark
    assert Simulation(MPI.COMM_SELF, fast(2.0, IRIS, "open", beam=far)).remarks == []
    with pytest.raises(InputError, match="more than an estimate holds for: images in surfaces across z"):
        Simulation(MPI.COMM_SELF, fast(30.0, IRIS, "open", beam={**near, "centre": [2.8e-3, 0, -2e-3]}))


def test_the_estimate_is_what_a_plate_leaves_out():
    """Beside a wall of the domain images move against the bunch, which is solved for: a plate in its place differs by that."""

    def force(domain: dict[str, Any], plate: list[Any]) -> tuple[np.ndarray, Simulation]:
        beam = {**BEAM, "momentum": [0, 0, PROTON_MASS * C * np.sqrt(3)], "sigma": 6e-4, "centre": [0, 0, 2e-3]}
        beam = {key: value for key, value in beam.items() if key != "velocity"}
        motion = {"kind": "leapfrog", "dt": 1e-13}
        simulation = Simulation(MPI.COMM_SELF, scene(domain=domain, bunches=[beam], electrodes=plate, motion=motion))
        before = np.array(simulation.particles.momentum)[np.argsort(simulation.particles.id)]
        first = simulation.state
        simulation.advance(2)
        after = np.array(simulation.particles.momentum)[np.argsort(simulation.particles.id)]
        simulation.state = first
        return ((after - before) / 2e-13 / ELEMENTARY_CHARGE)[:, :2], simulation

    upper = [0.01, 0.01, 0.012]
    of_wall = {"lower": [-0.01, -0.01, 0], "upper": upper, "cells": [40, 40, 24]}
    of_plate = {"lower": [-0.01, -0.01, -0.003], "upper": upper, "cells": [40, 40, 30], "boundary": "open"}
    plate = [{"name": "plate", "shape": {"kind": "disk", "radius": 9e-3}, "voltage": 0}]
    beside_wall, _ = force({**of_wall, "boundary": {"x": "open", "y": "open", "z": ["dirichlet", "open"]}}, [])
    beside_plate, simulation = force(of_plate, plate)
    state = simulation.state
    drive = simulation._setup.drive(state.time, state.window, state.lost)
    beam = MeshedParticles(state.particles, state.hierarchy, state.solution.frames, drive=drive)
    difference = np.sqrt(((beside_wall - beside_plate) ** 2).sum(axis=1).mean())
    assert neglected(beam, state.solution) == pytest.approx(difference, rel=0.2)


def test_electrodes_that_float_beside_fast_bunches_are_refused():
    with pytest.raises(InputError, match="beside an electrode that floats"):
        Simulation(MPI.COMM_SELF, scene(bunches=[{**BEAM, "velocity": [0, 0, 0.2 * C]}]))


# ---- ions in a trap of hyperbolic electrodes ----

R0, VOLTS, RADIO = 5e-3, 20.0, 1e6  # m, V, Hz
MASS = 40 * PROTON_MASS


def trap(cells: int, steps: int) -> Scene:
    """A trap of a ring and two end caps with so many time steps a period, filled to the walls; ions without charge."""
    bounds = {"lower": -2.4 * R0, "upper": 2.4 * R0}
    hyperboloid = f"{R0**2} - x^2 - y^2 + 2*z^2"
    return Scene.from_dict(
        {
            "domain": {"lower": -2 * R0, "upper": 2 * R0, "cells": cells, "boundary": "dirichlet"},
            "electrodes": [
                {
                    "name": "ring",
                    "voltage": f"{VOLTS}*cos(2*pi*{RADIO}*t)",
                    "shape": {"kind": "level-set", "formula": hyperboloid, **bounds},
                },
                {
                    "name": "caps",
                    "voltage": 0,
                    "shape": {"kind": "level-set", "formula": f"{R0**2} + x^2 + y^2 - 2*z^2", **bounds},
                },
            ],
            "bunches": [
                {
                    "distribution": "arrays",
                    "species": {"charge": ELEMENTARY_CHARGE, "mass": MASS},
                    "position": [[R0 / 20, 0, R0 / 25], [0, R0 / 20, -R0 / 25]],
                    "momenta": [[0.0, 0.0, 0.0], [0.0, 0.0, 0.0]],
                    "weight": [0.0, 0.0],
                }
            ],
            "motion": {"kind": "leapfrog", "dt": 1 / RADIO / steps},
            "schedule": {"steps": 1},
            "solver": {"tolerance": 1e-10},
        }
    )


def phase_advance(volts_per_square: float) -> float:
    """Return the angle by which an ion swings in a period of x'' = k cos(2π f t) x, by the trace of its transfer matrix."""

    def motion(t: float, y: np.ndarray) -> list[float]:
        force = volts_per_square * np.cos(2 * np.pi * RADIO * t)
        return [y[1], force * y[0], y[3], force * y[2]]

    ends = solve_ivp(motion, (0, 1 / RADIO), [1, 0, 0, 1], rtol=1e-11, atol=1e-14).y[:, -1]
    return float(np.arccos((ends[0] + ends[3]) / 2))


def measured_advance(cells: int, steps: int, periods: int) -> np.ndarray:
    """Return the angles along x and z in a run: x(n + 1) + x(n - 1) = 2 cos(angle) x(n), once a period."""
    simulation = Simulation(MPI.COMM_SELF, trap(cells, steps))
    places = []
    for period in range(periods + 1):
        simulation.advance(steps if period else 0)
        places.append(np.array(simulation.particles.position)[np.argsort(simulation.particles.id)])
    x = np.array(places)[:, 0, [0, 2]]
    now, beside = x[1:-1], x[2:] + x[:-2]
    return np.arccos((now * beside).sum(axis=0) / (now**2).sum(axis=0) / 2)


@pytest.mark.parametrize(
    "cells, steps, periods, within",
    [(24, 30, 6, 6e-3), pytest.param(32, 120, 16, 1e-3, marks=pytest.mark.long)],
    ids=["short", "sharp"],
)
def test_ions_swing_in_a_paul_trap_as_mathieu_says(cells, steps, periods, within):
    strength = ELEMENTARY_CHARGE / MASS * VOLTS / R0**2
    expected = [phase_advance(-strength), phase_advance(2 * strength)]
    assert measured_advance(cells, steps, periods) == pytest.approx(expected, rel=within)

"""Potential and fields of a run, wherever they are shown, are those that its particles feel."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from mpi4py import MPI

import amrpic
from amrpic.io.field_reader import open_dump
from amrpic.mesh.field import Field, VectorField
from amrpic.pic.state import State
from amrpic.units import ELECTRON_MASS, ELEMENTARY_CHARGE, SPEED_OF_LIGHT, VACUUM_PERMITTIVITY

MC = ELECTRON_MASS * SPEED_OF_LIGHT
PLATES = {"boundary": {"x": "dirichlet", "y": "neumann", "z": "periodic"}, "potential": {"x": ["0 V", "1 kV"]}}
SLOPES = {"boundary": {"x": "dirichlet", "y": "neumann", "z": "open"}, "slope": {"y": ["3e4 V/m", "-5e4 V/m"]}}
BOTH = {**SLOPES, "potential": {"x": ["-200 V", "1 kV"]}}
WINDOW = {"window": "reference", "dt": "20 ps"}
CATHODE = {"boundary": {"x": "open", "y": "open", "z": ["dirichlet", "open"]}}
ACROSS = {"boundary": {"x": "dirichlet", "y": "open", "z": "dirichlet"}, "potential": {"z": ["-1 kV", "0 V"]}}
REFINED = {
    "levels": 1,
    "rule": {"kind": "static", "boxes": [{"level": 1, "lower": ["-1 mm"] * 3, "upper": ["1 mm", "1 mm", "2 mm"]}]},
}


def scene(
    u: list[float], domain: dict[str, Any], motion: dict[str, Any] | None = None, charge: Any = "-50 pC", **more: Any
) -> amrpic.Scene:
    """Bunches of electrons with these mean βγ along z in a cube of 1 cm."""
    bunch = {"distribution": "gaussian", "species": "electron", "sigma": "1 mm", "charge": charge, "particles": 400}
    return amrpic.Scene.from_dict(
        {
            "domain": {"lower": "-5 mm", "upper": "5 mm", "cells": 16, **domain},
            "bunches": [{**bunch, "sampling": "sobol", "momentum": [0, 0, one * MC]} for one in u],
            "particles": {"interface": "own-level"},
            "motion": {"kind": "leapfrog", "dt": "1 ps", **(motion or {})},
            "output": {"write": []},
            **more,
        }
    )


SCENES = {
    "walls": scene([0.6], PLATES),
    "walls of a slow beam": scene([0.001], PLATES),
    "walls of counter-moving beams": scene([-0.6, 0.6], PLATES),
    "slopes": scene([5.0], SLOPES),
    "slopes and walls": scene([20.0], BOTH),
    "slopes and walls of two energies": scene([2.0, 20.0], BOTH),
    "slopes and walls of two energies, order 4": scene([2.0, 20.0], BOTH, solver={"order": 4}),
    "three energies": scene([2.0, 20.0, 200.0], {}),
    "window": scene([50.0], {}, WINDOW),
    "window and walls": scene([50.0], BOTH, WINDOW),
    "window and two energies, refined": scene([4.0, 6.0], {}, WINDOW, refinement=REFINED),
    "walls, refined": scene([5.0], BOTH, refinement=REFINED),
    "a cathode": scene([5.0], CATHODE),
    "a cathode, two energies": scene([4.0, 6.0], CATHODE, refinement=REFINED),
    "a cathode, one energy of two fast": scene([0.05, 3.0], CATHODE),
    "a cathode left behind": scene([5.0], CATHODE, WINDOW),
    "a cathode left behind, two energies": scene([4.0, 6.0], CATHODE, WINDOW, solver={"order": 4}),
    "plates across": scene([5.0], ACROSS),
    "walls, drift first, Boris's turn": scene([30.0], PLATES, {"form": "drift-kick-drift", "pusher": "boris"}),
}


def impulse(before: np.ndarray, after: np.ndarray, e: np.ndarray, b: np.ndarray, time: float) -> np.ndarray:
    """What Higuera and Cary (Phys. Plasmas 24, 052104, 2017) give: q (E + v × B) with the velocity of the mean momentum."""
    mean = (before + after) / 2
    velocity = mean / ELECTRON_MASS / np.sqrt(1 + (mean**2).sum(axis=1, keepdims=True) / MC**2)
    return -ELEMENTARY_CHARGE * time * (e + np.cross(velocity, b))


def sampled(comm: MPI.Comm, state: State) -> tuple[np.ndarray, np.ndarray]:
    """E and B where a rank's particles are. Collective."""
    places = comm.allgather(np.array(state.particles.position))
    own = slice(sum(map(len, places[: comm.rank])), sum(map(len, places[: comm.rank + 1])))
    points = np.concatenate(places)
    return state.efield.sample(points)[own], state.solution.bfield.sample(points)[own]


@pytest.mark.mpi(ranks=(1, 2))
@pytest.mark.parametrize("name", SCENES)
def test_fields_sampled_at_particles_are_those_of_the_push(comm: MPI.Comm, name: str) -> None:
    run = amrpic.Simulation(comm, SCENES[name])
    for _ in range(3):
        state = run.state
        staggered = state.staggered
        e, b = sampled(comm, state)
        now = state.synchronized.momentum
        half = run._setup.dt / 2
        bound = 1e-10 * ELEMENTARY_CHARGE * np.abs(e).max(initial=1.0) * half + 1e-15 * np.abs(now).max(initial=0)
        drifts = "drift" in name and state.step == 0
        if staggered.lag_to_keep > 0:  # else it is half of both parts together, whose whole counts
            found = now - state.particles.momentum
            assert np.abs(found - impulse(state.particles.momentum, now, e, b, half)).max(initial=0) < bound
        if not drifts and (staggered.lag_to_keep > 0 or state.step == 0):
            after = staggered.moved.momentum
            assert np.abs(after - now - impulse(now, after, e, b, half)).max(initial=0) < bound
        run.advance()


def test_potential_field_and_energy_between_plates_are_the_same_at_all_energies() -> None:
    """Without charge to speak of: 0.5 kV in the middle, 100 kV/m, and the energy of that field in 1 cm³."""
    for u in ([0.0], [0.009], [0.3], [30.0], [0.3, 3.0]):
        run = amrpic.Simulation(MPI.COMM_SELF, scene(u, PLATES, charge=-1e-20))
        assert run.phi.sample([(0, 0, 0)])[0] == pytest.approx(500, rel=1e-6)
        assert run.efield.sample([(0, 0, 0)])[0] == pytest.approx([-1e5, 0, 0], abs=0.1)
        energy = run.efield.integral_of_square() * VACUUM_PERMITTIVITY / 2
        assert energy == pytest.approx(VACUUM_PERMITTIVITY / 2 * 1e10 * 1e-6, rel=1e-6)


@pytest.mark.parametrize("domain", [{}, BOTH], ids=["open", "walls"])
def test_potential_of_parts_sampled_is_the_sum_of_their_potentials_in_fourth_order(domain: dict[str, Any]) -> None:
    """Means of cells as those of one part are, which sampling takes for what they are."""
    solution = amrpic.Simulation(MPI.COMM_SELF, scene([2.0, 20.0], domain, solver={"order": 4})).state.solution
    parts = [*solution.parts, *(solution.walls or ())[:1]]
    points = np.random.default_rng(1).uniform(-3e-3, 3e-3, (20, 3))
    assert len(solution.parts) == 2 and {field.holds for field in [solution.potential, *parts]} == {"means"}
    of_parts = sum(part.sample(points, order=4) for part in parts)
    assert solution.potential.sample(points, order=4) == pytest.approx(of_parts, rel=1e-12)


def test_rules_of_refinement_see_what_walls_hold() -> None:
    """φ of more than 900 V: a tenth of the way between plates at 0 and 1 kV, at any energy, at the start and later."""
    for u in ([0.0], [3.0]):
        rule = {"kind": "potential", "absolute": "900 V"}
        refinement = {"levels": 1, "rule": rule, "blocking_factor": 2, "buffer": 0, "regrid_every": 1}
        run = amrpic.Simulation(MPI.COMM_SELF, scene(u, PLATES, charge=-1e-20, refinement=refinement))
        for _ in range(2):
            boxes = run.hierarchy.boxes(1)
            assert boxes[:, 0].min() == 28 and boxes[:, 3].max() == 31  # fine cells along x: 2 of 16 base cells
            run.advance()


def fields_of(run: amrpic.Simulation) -> dict[str, Field | VectorField]:
    return {"phi": run.phi, "E": run.efield, "B": run.bfield}


@pytest.mark.mpi(ranks=(1, 2))
@pytest.mark.parametrize(
    "name",
    [
        "walls",
        "slopes and walls of two energies",
        "window",
        "a cathode",
        "a cathode left behind, two energies",
        "plates across",
    ],
)
def test_files_hold_what_acts_and_a_restart_goes_on_bit_by_bit(comm: MPI.Comm, tmp_path: Path, name: str) -> None:
    given = SCENES[name].to_dict()
    given["output"] = {"directory": str(tmp_path / "run"), "write": ["fields", "checkpoint"], "fields_every": 2}
    given["output"]["checkpoint_every"], given["schedule"] = 2, {"steps": 2}
    run = amrpic.Simulation(comm, amrpic.Scene.from_dict(given))
    run.run(log="silent")
    shown = fields_of(run)
    points = np.random.default_rng(1).uniform(-3e-3, 3e-3, (20, 3))
    dumped = amrpic.open(comm, tmp_path / "run").fields[2]
    moved = run.state.course.window.shift  # files show the mesh where it is in the laboratory
    with open_dump(tmp_path / "run" / "checkpoint_00000002") as held:
        for of, field in shown.items():
            rounding = 1e-11 * max(part.max_abs() for part in field.parts)
            assert dumped[of].sample(points + moved) == pytest.approx(field.sample(points), rel=0, abs=rounding)
            assert held.unit(of) == field.unit == dumped[of].parts[0].unit
            values = np.concatenate([held.values(of, 0, box).ravel() for box in range(len(held.levels[0].boxes))])
            ours = sum((np.square(part.array(0)).sum() for part in field.parts), 0.0)
            assert np.square(values).sum() == pytest.approx(comm.allreduce(ours), rel=1e-12)
    again = amrpic.Simulation.restart(comm, tmp_path / "run" / "checkpoint_00000002")
    for of, field in fields_of(again).items():
        assert np.array_equal(field.sample(points), shown[of].sample(points)) and field.unit == shown[of].unit
    run.advance(2)
    again.advance(2)
    assert np.array_equal(again.particles.momentum, run.particles.momentum)
    assert np.array_equal(again.particles.position, run.particles.position)

"""Steps that grow with what goes on: their order, and restarts."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
from mpi4py import MPI
from test_emitting_walls import gun

from amrpic.errors import SceneError
from amrpic.pic.simulation import Simulation
from amrpic.scene.scene import Scene
from amrpic.units import ELECTRON_MASS, ELEMENTARY_CHARGE, SPEED_OF_LIGHT

GRADIENT = 1e6  # V/m²
OMEGA = math.sqrt(ELEMENTARY_CHARGE * GRADIENT / ELECTRON_MASS)  # 1/s
PERIOD = 2 * math.pi / OMEGA  # s


def error_of_swing(finer: int, magnetic: float) -> tuple[float, float]:
    """Error of the place of a test particle after an eighth of a swing, and by how much steps have grown."""
    motion = {
        "kind": "leapfrog", "dt": PERIOD / 4000 / finer, "growth": 1.04 ** (1 / finer) - 1, "longest": PERIOD / 500 / finer,
    }  # fmt: skip
    bunch = {"distribution": "arrays", "species": "electron", "weight": [0.0]}
    bunch |= {"position": [[0, 0, 1e-3]], "momenta": [[0, 0, 0]]}
    elements = [{"kind": "constant-focusing", "gradient": [0, 0, -GRADIENT]}]
    elements += [{"kind": "uniform", "magnetic_field": [0, 0, magnetic]}] if magnetic else []
    scene = Scene.from_dict(
        {
            "domain": {"lower": -2e-3, "upper": 2e-3, "cells": 8},
            "bunches": [bunch],
            "elements": elements,
            "motion": motion,
            "schedule": {"steps": 10**6},
            "output": {"write": []},
        }
    )
    run = Simulation(MPI.COMM_SELF, scene)
    first = run.state.staggered.dt
    while run.time < PERIOD / 8:
        run.advance()
    exact = 1e-3 * math.cos(OMEGA * run.time)
    return abs(float(run.particles.position[0, 2]) - exact), run.state.staggered.dt / first


@pytest.mark.parametrize("magnetic", [0.0, 1e-4])
def test_steps_that_grow_keep_second_order(magnetic):
    (coarse, growth), (fine, _) = (error_of_swing(finer, magnetic) for finer in (1, 2))
    assert growth == pytest.approx(8.0)
    assert math.log2(coarse / fine) > 1.85


def growing(**changes: Any) -> Scene:
    motion = {**gun().motion.model_dump(), "dt": "0.1 ps", "growth": 0.05, "longest": "0.5 ps"}
    source = {**gun().sources[0].model_dump(), "pulse": {"shape": "flat", "length": "1 ps"}, "particles": 1000}
    return gun(motion=motion, refinement={"levels": 0}, sources=[source], **changes)


@pytest.mark.mpi(ranks=(1, 2))
def test_a_restart_amid_growth_goes_on_bit_by_bit(comm, tmp_path):
    folder = comm.bcast(tmp_path)
    whole, steps = Simulation(comm, growing()), []
    whole.advance(12)
    whole.checkpoint(folder / "amid")
    rest = Simulation.restart(comm, folder / "amid")
    for _ in range(12):
        whole.advance(), rest.advance()
        steps.append(whole.state.staggered.dt)
    for name in ("position", "momentum", "weight", "id"):
        np.testing.assert_array_equal(getattr(rest.particles, name), getattr(whole.particles, name))
    assert (rest.time, rest.state.staggered.dt) == (whole.time, whole.state.staggered.dt)
    assert steps[-1] > 1.2 * steps[0] and max(steps) <= 0.5e-12


def test_charge_is_balanced_and_born_with_growing_steps():
    run = Simulation(MPI.COMM_SELF, growing())
    run.advance(40)
    tally, lost = run.state.tallies.of[0], run.lost.particles.own_charge
    assert tally.particles == 1000
    assert abs(run.particles.own_charge + lost - tally.charge) < 1e-13 * abs(tally.charge)


ELEMENTS = {
    "quadrupole": {"kind": "quadrupole", "gradient": 1e-3, "length": "20 mm", "fringe": "enge", "gap": "2 mm"},
    "coil": {"kind": "solenoid", "field": 1e-6, "length": "20 mm", "fringe": "sheet", "radius": "4 mm"},
}


@pytest.mark.mpi(ranks=(1, 2))
@pytest.mark.parametrize("name", sorted(ELEMENTS))
@pytest.mark.parametrize(("centre", "short"), [(0.0, True), (0.02, True), (-0.5, False), (0.5, False)])
def test_steps_grow_where_elements_are_far(comm, name, centre, short):
    """A fringe and a coil of 8 mm are passed in a hundred steps; half a metre away the one does nothing, the other little."""
    bunch = {"distribution": "gaussian", "species": "electron", "sigma": "1 mm", "charge": "-1e-20 C", "particles": 100}
    scene = Scene.from_dict(
        {
            "domain": {"lower": -8e-3, "upper": 8e-3, "cells": 8},
            "bunches": [{**bunch, "kinetic_energy": "5 MeV"}],
            "elements": [{**ELEMENTS[name], "centre": [0, 0, centre]}],
            "motion": {"kind": "leapfrog", "window": "reference", "dt": "0.2 ps", "growth": 0.2, "longest": "1 ps"},
            "schedule": {"steps": 30},
            "output": {"write": []},
        }
    )
    run = Simulation(comm, scene)
    run.advance(30)
    expected = 8e-3 / SPEED_OF_LIGHT / 100 if short else 1e-12
    assert run.state.staggered.dt == pytest.approx(expected, rel=0.01)


@pytest.mark.parametrize(
    ("motion", "words"),
    [
        ({"growth": 0.1, "form": "drift-kick-drift"}, "not known yet"),
        ({"longest": "1 ps"}, "do not grow"),
        ({"growth": 0.1, "longest": "0.01 ps"}, "is below dt"),
        ({"growth": 0.5}, "growth"),
    ],
)
def test_bad_growth_is_refused_in_one_sentence(motion, words):
    with pytest.raises(SceneError) as refused:
        gun(motion={"kind": "leapfrog", "dt": "0.1 ps", **motion})
    text = str(refused.value)
    assert words in text and "motion" in text and "\n" not in text

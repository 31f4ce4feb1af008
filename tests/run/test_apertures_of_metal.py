"""Apertures of any shape, and those that the field ends on: the same metal as that of electrodes."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from mpi4py import MPI

from amrpic import Scene, Simulation
from amrpic.errors import SolverError

BALL = {"kind": "sphere", "centre": [0, 0, 4e-3], "radius": 3e-3}
PLATE = {"kind": "box", "lower": [-0.1, -0.1, 0.002], "upper": [0.1, 0.1, 0.006]}
LONG = [0, 0, 0.1]
# An aperture, and the same body as a shape
BODIES: dict[str, tuple[dict[str, Any], dict[str, Any]]] = {
    "a ball": ({"kind": "solid", "shape": BALL}, BALL),
    "a round hole": (
        {"kind": "round", "centre": [0, 0, 4e-3], "length": 4e-3, "radius": 3e-3},
        {
            "kind": "difference",
            "of": [PLATE, {"kind": "cylinder", "start": [0, 0, -0.1], "end": LONG, "radius": 3e-3}],
        },
    ),
    "a rectangular hole, rolled": (
        {
            "kind": "rectangular",
            "centre": [0, 0, 4e-3],
            "length": 4e-3,
            "half_widths": [2e-3, 4e-3],
            "roll": "90 deg",
        },
        {
            "kind": "difference",
            "of": [PLATE, {"kind": "box", "lower": [-4e-3, -2e-3, -0.1], "upper": [4e-3, 2e-3, 0.1]}],
        },
    ),
}


def simulation(**changes: Any) -> Simulation:
    data: dict[str, Any] = {
        "domain": {"lower": -0.01, "upper": 0.01, "cells": 16, "boundary": "dirichlet"},
        "bunches": [
            {
                "distribution": "gaussian",
                "species": "proton",
                "sigma": 2e-3,
                "cutoff": 2.5,
                "centre": [0, 0, -5e-3],
                "velocity": [0, 0, 3e5],
                "charge": 1e-12,
                "particles": 500,
            }
        ],
        "motion": {"kind": "leapfrog", "dt": 5e-9},
        "schedule": {"steps": 6},
        "solver": {"tolerance": 1e-11},
    }
    out = Simulation(MPI.COMM_SELF, Scene.from_dict({**data, **changes}))
    out.advance(6)
    return out


def lost_at(of: Simulation, name: str) -> tuple[np.ndarray, np.ndarray]:
    """Return ids and places of those that were lost there, by id."""
    lost = of.lost
    mine = np.flatnonzero(lost.cause == lost.names.index(name))
    mine = mine[np.argsort(np.array(lost.particles.id)[mine])]
    return np.array(lost.particles.id)[mine], np.array(lost.particles.position)[mine]


@pytest.mark.parametrize("name", BODIES)
def test_an_aperture_with_a_field_is_an_electrode_at_no_voltage(name):
    aperture, shape = BODIES[name]
    ours = simulation(apertures=[{**aperture, "name": "it", "field": True}])
    other = simulation(electrodes=[{"name": "it", "shape": shape, "voltage": 0}])
    assert np.array(ours.phi.array(0)) == pytest.approx(np.array(other.phi.array(0)), abs=1e-9 * other.phi.max_abs())
    assert ours.state.solution.charges["it"] == pytest.approx(other.state.solution.charges["it"], rel=1e-8)
    (ids, places), (of_other, places_there) = lost_at(ours, "it"), lost_at(other, "it")
    assert len(ids) > 20 and np.array_equal(ids, of_other)
    assert places == pytest.approx(places_there, abs=1e-12)


@pytest.mark.parametrize("name", BODIES)
def test_without_one_the_field_does_not_see_it(name):
    aperture, shape = BODIES[name]
    ours = simulation(apertures=[{**aperture, "name": "it"}])
    ids, places = lost_at(ours, "it")
    assert len(ids) > 20
    body = Scene.from_dict(
        {
            "domain": {"lower": -1, "upper": 1, "cells": 8},
            "electrodes": [{"name": "a", "shape": shape, "voltage": 0}],
        }
    )
    around = body.electrodes[0].value.shape
    inside = [around.inside(places + 1e-8 * (np.array(step) - 1)) for step in np.ndindex(3, 3, 3)]
    assert np.any(inside, axis=0).all() and not np.any(np.all(inside, axis=0))  # on the surface
    assert not ours.state.solution.charges


def test_metal_without_ends_at_an_open_face_is_refused():
    pipe = {"kind": "round", "radius": 8e-3, "field": True}
    with pytest.raises(SolverError, match="an electrode meets an open face"):
        simulation(apertures=[pipe], domain={"lower": -0.01, "upper": 0.01, "cells": 16, "boundary": "open"})

"""Elements for tracking codes, each beside its host; skipped where it is missing."""

from __future__ import annotations

import copy
import pickle
from typing import Any

import numpy as np
import pytest

import amrpic
from amrpic.hosts import pyat, xsuite
from amrpic.units import ELEMENTARY_CHARGE, SPEED_OF_LIGHT

PROTON = 938.27208943e6  # eV
GAMMA, NUMBER, WEIGHT = 1.5, 2000, 1e6
BETA = np.sqrt(1 - GAMMA**-2)
SETTINGS: dict[str, Any] = {"cells": 16, "levels": 1}


def bunch() -> np.ndarray:
    """x, y and z (3, n) in m."""
    return np.random.default_rng(1).normal(size=(3, NUMBER)) * np.array([[1e-3], [2e-3], [5e-3]])


def expected(places: np.ndarray) -> np.ndarray:
    ratio = SPEED_OF_LIGHT**2 / PROTON
    charge = WEIGHT * ELEMENTARY_CHARGE
    x, y, z = places
    return amrpic.SpaceCharge(**SETTINGS).kick(x, y, z, charge, 0.7, BETA, GAMMA, ratio)


def test_xsuite_particles_get_the_kick():
    xtrack = pytest.importorskip("xtrack")
    x, y, z = bunch()
    particles = xtrack.Particles(x=x, y=y, zeta=z, weight=WEIGHT, mass0=PROTON, q0=1, gamma0=GAMMA)
    element = xsuite.SpaceCharge(0.7, **SETTINGS)
    element.track(particles)
    kick = expected(bunch())
    for found, change in zip((particles.px, particles.py, particles.delta), kick.T, strict=True):
        assert found == pytest.approx(change, rel=1e-9, abs=1e-12 * np.abs(kick).max())
    other = element.copy()
    assert copy.deepcopy(element).length == pickle.loads(pickle.dumps(element)).length == element.length
    assert other.to_dict() == element.to_dict() and other.charges is not element.charges


def test_pyat_particles_get_the_kick():
    at = pytest.importorskip("at")
    x, y, z = bunch()
    element = pyat.space_charge(
        "charge", 0.7, WEIGHT * ELEMENTARY_CHARGE, PROTON, GAMMA * PROTON, charge_number=1, **SETTINGS
    )
    rin = np.asfortranarray(np.stack([x, 0 * x, y, 0 * x, 0 * x, -z / BETA]))
    rin[0, 5] = np.nan  # lost
    lattice = at.Lattice([element], energy=GAMMA * PROTON, particle=at.Particle("proton"), periodicity=1)
    out, *_ = lattice.track(rin, nturns=1)
    alive = np.arange(NUMBER) != 5
    kick = expected(bunch()[:, alive])
    found = np.asarray(out)[[1, 3, 4], :, 0, 0][:, alive].T
    assert found == pytest.approx(kick, rel=1e-6, abs=1e-12 * np.abs(kick).max())
    for other in (copy.deepcopy(element), pickle.loads(pickle.dumps(element))):
        assert other.charges.settings == element.charges.settings


def test_particles_of_different_references_are_refused():
    with pytest.raises(amrpic.InputError, match="p0c"):
        xsuite._reference([1.0, 2.0])

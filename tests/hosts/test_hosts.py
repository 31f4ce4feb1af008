"""Elements for tracking codes, each beside its host; skipped where it is missing."""

from __future__ import annotations

import copy
import pickle
from typing import Any

import numpy as np
import pytest

import amrpic
from amrpic.hosts import impactx, pyat, xsuite
from amrpic.units import ELEMENTARY_CHARGE, SPEED_OF_LIGHT, VACUUM_PERMITTIVITY
from exact.bunches import quiet_ellipsoid

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


def test_pyat_and_xsuite_particles_get_the_same_kick():
    at, xtrack = pytest.importorskip("at"), pytest.importorskip("xtrack")
    x, y, z = bunch()
    particles = xtrack.Particles(x=x, y=y, zeta=z, weight=WEIGHT, mass0=PROTON, q0=1, gamma0=GAMMA)
    xsuite.SpaceCharge(0.7, **SETTINGS).track(particles)
    element = pyat.space_charge(
        "charge", 0.7, WEIGHT * ELEMENTARY_CHARGE, PROTON, GAMMA * PROTON, charge_number=1, **SETTINGS
    )
    rin = np.asfortranarray(np.stack([x, 0 * x, y, 0 * x, 0 * x, -z / BETA]))
    lattice = at.Lattice([element], energy=GAMMA * PROTON, particle=at.Particle("proton"), periodicity=1)
    out, *_ = lattice.track(rin, nturns=1)
    for row, theirs in ((1, particles.px), (3, particles.py), (4, particles.delta)):
        assert np.abs(np.asarray(out)[row, :, 0, 0] - theirs).max() < 1e-13


# ---- ImpactX ----
KINETIC, ELECTRON, RADIUS, BALL = 250e6, 0.510998950e6, 1e-3, 1e-9  # eV, eV, m, C


@pytest.fixture
def simulation() -> Any:
    """One of ImpactX with a reference electron and no particles; its own space charge is off."""
    impactx = pytest.importorskip("impactx")
    made = impactx.ImpactX()
    made.particle_shape, made.space_charge, made.verbose = 2, False, 0
    made.slice_step_diagnostics = made.diagnostics = made.tiny_profiler = False
    made.init_grids()
    made.beam.ref.set_charge_qe(-1.0).set_mass_MeV(ELECTRON / 1e6).set_kin_energy_MeV(KINETIC / 1e6)
    yield made
    made.finalize()


def put_ball(simulation: Any, number: int) -> None:
    """Cold electrons that fill a ball of `RADIUS`, as it is where they are at rest."""
    from amrex.space3d import PODVector_real_std

    reference = simulation.beam.ref
    x, y, z = quiet_ellipsoid(number, RADIUS * np.array([1, 1, 1 / reference.gamma])).T
    still = np.zeros(number)
    columns = []
    for values in (x, y, -z / reference.beta, still, still, still):
        columns.append(PODVector_real_std())
        for value in values:
            columns[-1].push_back(float(value))
    simulation.beam.add_n_particles(*columns, -1 / ELECTRON, bunch_charge=BALL)


def ball_sizes(simulation: Any) -> np.ndarray:
    """The rms sizes (3,) at one time, m."""
    from impactx import CoordSystem, coordinate_transformation

    coordinate_transformation(simulation.beam, CoordSystem.t)
    tiles = impactx._tiles(simulation.beam)
    sizes = [np.concatenate([tile[name][:] for tile in tiles]).std() for name in impactx.PLACES]
    coordinate_transformation(simulation.beam, CoordSystem.s)
    return np.array(sizes)


def test_a_ball_in_impactx_expands_as_it_should(simulation):
    """ImpactX's benchmark of an expanding beam with 40 kicks of ours: R'' = k/R² where the ball is at rest."""
    from impactx import elements
    from scipy.integrate import solve_ivp

    put_ball(simulation, 2**14)
    before = ball_sizes(simulation)
    kicks, length, reference = 40, 6.0, simulation.beam.ref
    half = elements.Drift(name="half", ds=length / kicks / 2)
    charge = impactx.SpaceCharge(length / kicks, cells=32, levels=1, compensation="clouds-and-mesh")
    simulation.lattice.extend([half, charge.element(), half] * kicks)
    time = length / (reference.beta * reference.gamma * SPEED_OF_LIGHT)
    strength = BALL * SPEED_OF_LIGHT**2 / (4 * np.pi * VACUUM_PERMITTIVITY * ELECTRON)
    radius = solve_ivp(lambda _, r: [r[1], strength / r[0] ** 2], (0, time), [RADIUS, 0], rtol=1e-10, atol=1e-15).y[
        0, -1
    ]
    simulation.track_particles()
    assert ball_sizes(simulation) / before == pytest.approx(np.full(3, radius / RADIUS), rel=2e-3)
    for other in (copy.copy(charge), copy.deepcopy(charge), pickle.loads(pickle.dumps(charge))):
        assert other.length == charge.length and other.charges.settings == charge.charges.settings


def test_particles_of_different_references_are_refused():
    with pytest.raises(amrpic.InputError, match="p0c"):
        xsuite._reference([1.0, 2.0])

"""The motion of one particle in given fields, against what is known exactly."""

from __future__ import annotations

import numpy as np
import pytest
from mpi4py import MPI
from scipy.integrate import solve_ivp

import amrpic
from amrpic.particles.particles import Particles
from amrpic.particles.species import SPECIES, SpeciesTable
from amrpic.stages.migrate import migrate
from amrpic.stages.push import PUSHERS, push
from amrpic.units import ELECTRON_MASS, ELEMENTARY_CHARGE, SPEED_OF_LIGHT

MC = ELECTRON_MASS * SPEED_OF_LIGHT
POSITRON = SpeciesTable((SPECIES["positron"],))


class Orbit:
    """One positron that starts in the middle of a large periodic domain without a field of its own."""

    def __init__(self, momentum: tuple[float, float, float]) -> None:
        domain = amrpic.Domain((-1e3,) * 3, (1e3,) * 3, (8, 8, 8), boundary="periodic")
        self.hierarchy = amrpic.Hierarchy(MPI.COMM_SELF, domain)
        nothing = amrpic.Field(self.hierarchy)
        self.field = amrpic.VectorField(nothing, nothing, nothing)
        self.particles = Particles(np.zeros((1, 3)), np.array([momentum]) * MC, np.ones(1), np.zeros(1), POSITRON)

    def fly(self, e: np.ndarray, b: np.ndarray, dt: float, steps: int, pusher: str = "higuera-cary") -> Orbit:
        """Let it fly in uniform fields, V/m and T; momenta belong to the time of positions at both ends."""
        for step in range(steps + 1):
            here, _ = migrate(self.particles, self.hierarchy)
            last = step == steps
            self.particles = push(
                self.field,
                here,
                dt / 2 if step else 0.0,
                0.0 if last else dt / 2,
                0.0 if last else dt,
                electric=e[None, :],
                magnetic=b[None, :],
                pusher=pusher,
            )
        return self

    @property
    def momentum(self) -> np.ndarray:
        """Over m c."""
        return self.particles.momentum[0] / MC

    @property
    def position(self) -> np.ndarray:
        return self.particles.position[0]


def order(errors: list[float]) -> float:
    """Of convergence, from errors at steps that are halved each time."""
    return float(np.log2(errors[-2] / errors[-1]))


@pytest.mark.parametrize("pusher", PUSHERS)
@pytest.mark.parametrize("u", [1e-3, 1.0, 30.0])
def test_a_uniform_magnetic_field_turns_and_keeps_the_magnitude(pusher, u):
    b, gamma = np.array([0.0, 0.0, 0.1]), np.hypot(1, u)
    period = 2 * np.pi * gamma * ELECTRON_MASS / (ELEMENTARY_CHARGE * 0.1)
    errors = []
    for per_period in (100, 200):
        orbit = Orbit((u, 0.0, 0.3 * u)).fly(np.zeros(3), b, period / per_period, 100 * per_period, pusher)
        # The period above is that of a particle without its momentum along the field.
        turns = 100 * gamma / np.sqrt(1 + 1.09 * u**2)
        angle = -np.arctan2(orbit.momentum[1], orbit.momentum[0])
        missed = (angle - 2 * np.pi * turns + np.pi) % (2 * np.pi) - np.pi
        errors.append(abs(missed) / (2 * np.pi * turns))
        assert np.linalg.norm(orbit.momentum) == pytest.approx(np.sqrt(1.09) * u, rel=1e-12)
    assert errors[1] < 1e-4 and order(errors) > 1.9


@pytest.mark.parametrize("pusher", PUSHERS)
def test_a_uniform_electric_field_gives_its_impulse(pusher):
    """Hyperbolic motion: momentum to rounding, place to second order."""
    e, time = np.array([0.0, 0.0, 1e7]), 1e-9
    gained = ELEMENTARY_CHARGE * 1e7 * time / MC
    errors = []
    for steps in (50, 100, 200):
        orbit = Orbit((0.5, 0.0, 0.0)).fly(e, np.zeros(3), time / steps, steps, pusher)
        assert orbit.momentum == pytest.approx([0.5, 0.0, gained], rel=1e-12)
        energy = np.hypot(1, 0.5)
        scale = MC * SPEED_OF_LIGHT / (ELEMENTARY_CHARGE * 1e7)
        exact = np.array([0.5 * np.arcsinh(gained / energy), 0, np.hypot(energy, gained) - energy]) * scale
        errors.append(float(np.abs(orbit.position - exact).max()))
    assert order(errors) > 1.9


@pytest.mark.parametrize("pusher", PUSHERS)
def test_orbits_in_crossed_fields_are_those_of_scipy(pusher):
    b, e = np.array([0.02, 0.0, 0.1]), np.array([0.0, 1e7, 1e6])
    time, start = 3e-9, (0.4, -0.3, 0.2)

    def change(_: float, y: np.ndarray) -> np.ndarray:
        velocity = y[3:] / np.sqrt(1 + y[3:] @ y[3:]) * SPEED_OF_LIGHT
        return np.concatenate([velocity, ELEMENTARY_CHARGE / MC * (e + np.cross(velocity, b))])

    exact = solve_ivp(change, (0, time), [0, 0, 0, *start], method="DOP853", rtol=1e-12, atol=1e-12).y[:, -1]
    errors = []
    for steps in (400, 800, 1600):
        orbit = Orbit(start).fly(e, b, time / steps, steps, pusher)
        errors.append(
            float(np.abs(orbit.position - exact[:3]).max() / np.abs(exact[:3]).max())
            + float(np.abs(orbit.momentum - exact[3:]).max())
        )
    assert order(errors) > 1.9 and errors[-1] < 1e-3


def test_higuera_and_cary_keep_what_feels_no_force():
    """E + v × B = 0: Boris's pusher gives momentum across, which does not belong there."""
    u = 5.0
    velocity = SPEED_OF_LIGHT * u / np.hypot(1, u)
    b = np.array([0.0, 0.1, 0.0])
    e = -np.cross([0.0, 0.0, velocity], b)
    across = {}
    for pusher in PUSHERS:
        orbit = Orbit((0.0, 0.0, u))
        particles = orbit.particles
        for _ in range(40):  # momenta half a step behind all the time
            here, _ = migrate(particles, orbit.hierarchy)
            particles = push(
                orbit.field, here, 1e-10, 1e-10, 2e-10, electric=e[None, :], magnetic=b[None, :], pusher=pusher
            )
        across[pusher] = float(np.abs(particles.momentum / MC - [0, 0, u]).max())
    assert across["higuera-cary"] < 1e-12
    assert across["boris"] > 1e-2

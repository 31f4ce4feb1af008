"""The motion of one particle in given fields, against what is known exactly."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from amrpic.errors import ParticleError
from amrpic.stages.migrate import migrate
from amrpic.stages.push import PUSHERS, push
from amrpic.units import ELEMENTARY_CHARGE, SPEED_OF_LIGHT
from exact.orbits import MC, STEPS, Orbits, accelerated, turning


@pytest.mark.parametrize("drift", [0.0, pytest.param(0.3, marks=pytest.mark.long)])
@pytest.mark.parametrize("pusher", PUSHERS)
def test_a_uniform_magnetic_field_turns_and_keeps_the_magnitude(pusher, drift):
    """The phase errs by a 48th of the square of the angle in a step, of two turns of half of it; by less with their g."""
    errors, change = turning(pusher, drift)
    known = (2 * np.pi / STEPS[-1]) ** 2 / 48
    assert (errors[-1] < (1e-4 if drift else 1.01 * known)).all() and (errors[-2] / errors[-1] > 2**1.9).all()
    assert drift or pusher != "boris" or errors[-1] == pytest.approx(known, rel=0.01)
    assert drift or (change < 1e-12).all()


@pytest.mark.parametrize("pusher", PUSHERS)
def test_a_uniform_electric_field_gives_its_impulse(pusher):
    """Hyperbolic motion: momentum to rounding, place to second order."""
    momentum, order = accelerated(pusher)
    assert momentum < 1e-12 and order > 1.9


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
        orbit = Orbits(np.array([start])).fly(e[None], b[None], time / steps, steps, pusher)
        errors.append(
            float(np.abs(orbit.position - exact[:3]).max() / np.abs(exact[:3]).max())
            + float(np.abs(orbit.momentum - exact[3:]).max())
        )
    assert np.log2(errors[-2] / errors[-1]) > 1.9 and errors[-1] < 1e-3


def test_higuera_and_cary_keep_what_feels_no_force():
    """E + v × B = 0: Boris's pusher gives momentum across, which does not belong there."""
    u = 5.0
    velocity = SPEED_OF_LIGHT * u / np.hypot(1, u)
    b = np.array([0.0, 0.1, 0.0])
    e = -np.cross([0.0, 0.0, velocity], b)
    across = {}
    for pusher in PUSHERS:
        orbit = Orbits(np.array([[0.0, 0.0, u]]))
        for _ in range(40):  # momenta half a step behind all the time
            orbit.push(e[None], b[None], 1e-10, 1e-10, pusher)
        across[pusher] = float(np.abs(orbit.momentum - [0, 0, u]).max())
    assert across["higuera-cary"] < 1e-12
    assert across["boris"] > 1e-2


def test_fields_at_particles_may_have_any_layout_but_one_row_each():
    e, b = np.array([[1e5, 2e5, 3e5], [0.0, 0.0, 1e5]]), np.array([[0.1, 0.2, 0.3], [0.3, 0.0, 0.1]])
    momenta = np.array([[0.1, 0.2, 0.3], [0.3, 0.1, 0.0]])
    together = Orbits(momenta).fly(e, b, 1e-11, 10)
    alone = [Orbits(momenta[i : i + 1]).fly(e[i : i + 1], b[i : i + 1], 1e-11, 10).momentum[0] for i in range(2)]
    assert np.abs(together.momentum - alone).max() < 1e-15
    with pytest.raises(ParticleError, match="1 electric fields are given for 2 particles; give one for each"):
        push(together.field, migrate(together.particles, together.hierarchy)[0], 0, 0, 0, electric=e[:1])

"""Single particles in uniform fields, against their exact orbits."""

from __future__ import annotations

import numpy as np
from mpi4py import MPI

from amrpic.mesh.domain import Domain
from amrpic.mesh.field import Field, VectorField
from amrpic.mesh.hierarchy import Hierarchy
from amrpic.particles.particles import Particles
from amrpic.particles.species import SPECIES, SpeciesTable
from amrpic.stages.migrate import migrate
from amrpic.stages.push import push
from amrpic.units import ELECTRON_MASS, ELEMENTARY_CHARGE, SPEED_OF_LIGHT

MC = ELECTRON_MASS * SPEED_OF_LIGHT
MOMENTA = (1e-3, 1.0, 30.0)  # βγ across B; along it a third of that
TURNS = 100
STEPS = (50, 100, 200)  # a turn
PERIOD = 1e-9  # s


class Orbits:
    """Positrons that start in the middle of a large periodic domain without a field of its own; momenta (n, 3) over m c."""

    def __init__(self, momenta: np.ndarray) -> None:
        self.hierarchy = Hierarchy(MPI.COMM_SELF, Domain((-1e3,) * 3, (1e3,) * 3, (8, 8, 8), boundary="periodic"))
        nothing, count = Field(self.hierarchy), len(momenta)
        self.field = VectorField(nothing, nothing, nothing)
        positrons = SpeciesTable((SPECIES["positron"],))
        self.particles = Particles(
            np.zeros((count, 3)), np.array(momenta) * MC, np.ones(count), np.arange(count), positrons
        )

    def fly(self, e: np.ndarray, b: np.ndarray, dt: float, steps: int, pusher: str = "higuera-cary") -> Orbits:
        """Let them fly in uniform fields (n, 3), V/m and T; momenta belong to the time of positions at both ends."""
        for step in range(steps + 1):
            self.push(e, b, dt / 2 if step else 0.0, dt / 2 if step < steps else 0.0, pusher)
        return self

    def push(self, e: np.ndarray, b: np.ndarray, before: float, after: float, pusher: str) -> None:
        """Let fields act for `before` s and `after` s, and particles fly for twice `after`."""
        here, _ = migrate(self.particles, self.hierarchy)
        self.particles = push(
            self.field, here, before, after, 2 * after, electric=e[here.id], magnetic=b[here.id], pusher=pusher
        )

    @property
    def momentum(self) -> np.ndarray:
        """(n, 3), over m c."""
        return self.particles.momentum[np.argsort(self.particles.id)] / MC

    @property
    def position(self) -> np.ndarray:
        """(n, 3), m."""
        return self.particles.position[np.argsort(self.particles.id)]


def turning(pusher: str, drift: float) -> tuple[np.ndarray, np.ndarray]:
    """Errors of the phase over the whole phase, a row for each of STEPS, and the relative changes of |p| at the last.

    Of one positron for each of MOMENTA in B along z and E along y, whose E × B / B² is `drift` of its velocity.
    """
    start = np.outer(MOMENTA, (1.0, 0.0, 0.3))
    beta = drift * np.linalg.norm(start, axis=1) / _gamma(start)
    seen = boosted(start, beta)
    # In the frame that drifts B is B/γ, and the turn takes 2π γ' m / (q B/γ), in the laboratory γ times that.
    magnetic = 2 * np.pi / PERIOD * _gamma(seen) / (1 - beta**2) * ELECTRON_MASS / ELEMENTARY_CHARGE
    zero, whole = np.zeros_like(beta), 2 * np.pi * TURNS
    e = np.stack([zero, beta * SPEED_OF_LIGHT * magnetic, zero], axis=1)
    b = np.stack([zero, zero, magnetic], axis=1)
    errors = []
    for per_turn in STEPS:
        found = Orbits(start).fly(e, b, PERIOD / per_turn, TURNS * per_turn, pusher).momentum
        now = boosted(found, beta)  # whole turns have brought the exact one back to its start
        missed = np.angle((now[:, 0] + 1j * now[:, 1]) / (seen[:, 0] + 1j * seen[:, 1]))
        errors.append(np.abs(missed) / whole)
    change = np.abs(np.linalg.norm(found, axis=1) / np.linalg.norm(start, axis=1) - 1)
    return np.array(errors), change


def accelerated(pusher: str) -> tuple[float, float]:
    """Error of the momentum over what is gained, and order of the error of the place, in E along z: hyperbolic motion."""
    strength, time, u = 1e7, 1e-9, 0.5
    gained = ELEMENTARY_CHARGE * strength * time / MC
    energy, scale = np.hypot(1, u), MC * SPEED_OF_LIGHT / (ELEMENTARY_CHARGE * strength)
    exact = scale * np.array([u * np.arcsinh(gained / energy), 0, np.hypot(energy, gained) - energy])
    errors, momentum = [], 0.0
    for steps in (50, 100, 200):
        orbit = Orbits(np.array([[u, 0.0, 0.0]]))
        orbit.fly(np.array([[0.0, 0.0, strength]]), np.zeros((1, 3)), time / steps, steps, pusher)
        momentum = max(momentum, float(np.abs(orbit.momentum[0] - [u, 0, gained]).max()) / gained)
        errors.append(float(np.abs(orbit.position[0] - exact).max()))
    return momentum, float(np.log2(errors[0] / errors[2]) / 2)


def boosted(u: np.ndarray, beta: np.ndarray) -> np.ndarray:
    """Momenta (n, 3) over m c in frames that move with `beta` (n,) c along x."""
    out = u.copy()
    out[:, 0] = (u[:, 0] - beta * _gamma(u)) / np.sqrt(1 - beta**2)
    return out


def _gamma(u: np.ndarray) -> np.ndarray:
    return np.sqrt(1 + (u**2).sum(axis=1))

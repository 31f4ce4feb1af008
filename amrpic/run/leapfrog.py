"""Leapfrog: momenta that are staggered in time against positions, in kick, drift, kick form.

The second half kick of a step and the first one of the next use the same field, so they are taken together.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..mesh.field import VectorField
from ..particles.arrays import empty_columns
from ..particles.particles import Particles
from ..stages.push import push
from .plan import Plan


@dataclass(frozen=True, eq=False)
class Staggered:
    """Where leapfrog takes the particles of a state next, and by how much their momenta lag positions.

    Momenta of the particles lag the state's time by `lag` (0 or Δt/2), those of `moved` lead it by Δt/2.
    """

    moved: Particles  # after the kick by `lag` + Δt/2 and a drift by Δt; not sorted
    lag: float  # s

    @property
    def weight(self) -> float:
        """Of the momenta of `moved` in the mean with the lagging ones that gives those of the state's time."""
        return 0.5 if self.lag > 0 else 0.0

    def synchronized(self, particles: Particles) -> Particles:
        """Return the particles of the state with momenta of the time of their positions, to rounding."""
        if self.weight == 0:
            return particles
        lagging, out = particles.momentum, empty_columns(len(particles))
        np.subtract(self.moved.momentum, lagging, out=out)
        out *= self.weight
        out += lagging
        return particles.replace(momentum=out)


def kick_and_drift(efield: VectorField, particles: Particles, lag: float, plan: Plan) -> Staggered:
    """Return where particles go whose momenta lag positions by `lag` s. Collective."""
    return Staggered(push(efield, particles, lag, plan.dt / 2, plan.dt, plan.clouds), lag)


def kick(efield: VectorField, particles: Particles, lag: float, plan: Plan) -> Particles:
    """Return the particles with momenta of the time of their positions. Collective.

    In all digits those on the way to `moved`; `Staggered.synchronized` has them to rounding, without a pass over the field.
    """
    kicked = push(efield, particles, lag, 0.0, 0.0, plan.clouds)
    return particles.replace(momentum=kicked.momentum)

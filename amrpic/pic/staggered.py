"""Momenta that are staggered in time against positions."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..particles.arrays import empty_columns
from ..particles.particles import Particles
from ..stages.beam_diagnostics import Beam
from .course import Course


@dataclass(frozen=True, eq=False)
class Staggered:
    """The particles of a state, by how much their momenta lag positions, and where they go next.

    Momenta of `particles` lag the state's time by `lag` (0, or half of the step before), those of `moved` lead it by Δt/2.
    Without a magnetic field, elements or fields from Python those of the state's time lie between both; with them they are
    kept, as `between`.
    Where motion follows no field nothing lags, and `moved` are the particles as they are.
    """

    particles: Particles  # sorted on the mesh
    moved: Particles  # after the kick by `lag` + Δt/2 and a drift by Δt; not sorted; from the origin of the next window
    course: Course  # then
    lag: float = 0.0  # s
    flight: float = 0.0  # s, of that drift: Δt, and Δt/2 without a kick at the start of drift, kick, drift
    between: np.ndarray | None = None  # (n, 3) kg m/s
    dt: float = 0.0  # s, of the step that begins: Δt

    @property
    def synchronized(self) -> Particles:
        """The particles with momenta of the time of their positions, to rounding; made anew each time."""
        if self.lag == 0:
            return self.particles
        if self.between is not None:
            return self.particles.replace(momentum=self.between)
        lagging, out = self.particles.momentum, empty_columns(len(self.particles))
        np.subtract(self.moved.momentum, lagging, out=out)
        out *= self._part_behind
        out += lagging
        return self.particles.replace(momentum=out)

    @property
    def beam(self) -> Beam:
        """The particles with what gives their momenta at the time of their positions."""
        if self.between is not None:
            now = self.synchronized
            return Beam(now, now)
        return Beam(self.particles, self.moved, self._part_behind)

    @property
    def _part_behind(self) -> float:
        """Which part of the kick lies before the time of positions."""
        return self.lag / (self.lag + self.dt / 2) if self.lag > 0 else 0.0

    @property
    def lag_to_keep(self) -> float:
        """The lag, s, if momenta of the particles say more than those of the time of positions: a checkpoint keeps both."""
        return 0.0 if self.between is None else self.lag

"""Space charge as an element of a lattice of ImpactX, which its own is switched off for: `simulation.space_charge = False`."""

from __future__ import annotations

from typing import Any

import numpy as np

from ..space_charge.engine import SpaceCharge as Engine
from ..units import ELEMENTARY_CHARGE, SPEED_OF_LIGHT

PLACES = ("position_x", "position_y", "position_t")  # at one time; the last is z from the reference particle, m
MOMENTA = ("momentum_x", "momentum_y", "momentum_t")  # over that of the reference particle, without its own


class SpaceCharge:
    """A kick by the field of all particles for a path of `length` (m), where its element stands.

    `settings`: those of `amrpic.SpaceCharge`. Copies and pickles hold settings, and make elements of their own.
    """

    def __init__(self, length: float, **settings: Any) -> None:
        self.length, self.charges = length, Engine(**settings)

    def element(self, name: str = "space_charge") -> Any:
        """Return an element that kicks, to be put into a lattice between drifts; it may stand at several places."""
        from impactx import elements

        out = elements.Programmable(name=name)
        out.push = self
        return out

    def __call__(self, particles: Any, step: int = 0, period: int = 0) -> None:
        """Kick the particles of a container. Collective over the ranks of the engine."""
        from impactx import CoordSystem, coordinate_transformation

        coordinate_transformation(particles, CoordSystem.t)
        tiles, reference = _tiles(particles), particles.ref

        def column(name: str) -> np.ndarray:
            return np.concatenate([tile[name][:] for tile in tiles]) if tiles else np.zeros(0)

        x, y, z = (column(name) for name in PLACES)
        kick = self.charges.kick(
            x,
            y,
            z,
            column("weighting") * (reference.charge_qe * ELEMENTARY_CHARGE),
            self.length,
            reference.beta,
            reference.gamma,
            reference.charge_qe * SPEED_OF_LIGHT**2 / (reference.mass_MeV * 1e6),
        )
        first = 0
        for tile in tiles:
            count = len(tile["weighting"])
            for name, change in zip(MOMENTA, kick[first : first + count].T, strict=True):
                tile[name][:] += change
            first += count
        coordinate_transformation(particles, CoordSystem.s)


def _tiles(particles: Any) -> list[Any]:
    """Return the columns of each tile of this rank's particles, which are views."""
    from impactx import ImpactXParIter

    return [
        tile.soa().to_numpy().real
        for level in range(particles.finest_level + 1)
        for tile in ImpactXParIter(particles, level=level)
    ]

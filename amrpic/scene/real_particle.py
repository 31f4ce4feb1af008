"""A real particle of a scene: its species and how it moves."""

from __future__ import annotations

import math
from typing import Self

from pydantic import Field, model_validator

from ..particles.species import LARGEST_MOMENTUM, SPECIES
from ..units import SPEED_OF_LIGHT
from .section import Section
from .species_of_bunches import Species
from .units import Energy, Momentum3, Velocity3


class RealParticle(Section):
    """Species and momentum; the latter given as one of three."""

    species: Species = Field(
        default=SPECIES["proton"],
        description="A name, or charge (C) and mass (kg) of one real particle. The default is a proton: "
        "only motion depends on the species, the field on the charge of the bunch alone.",
    )
    momentum: Momentum3 | None = Field(default=None, description="Mean momentum of one real particle, kg m/s.")
    velocity: Velocity3 | None = Field(default=None, description="Mean velocity, m/s, in place of the momentum.")
    kinetic_energy: Energy | None = Field(
        default=None, ge=0, description="Of a real particle with the mean momentum, J, in place of the momentum."
    )
    direction: tuple[float, float, float] | None = Field(
        default=None, description="Of the momentum, for kinetic_energy; any length. By default along z."
    )

    @model_validator(mode="after")
    def _one_momentum(self) -> Self:
        keys = [key for key in ("momentum", "velocity", "kinetic_energy") if getattr(self, key) is not None]
        if len(keys) > 1:
            first, second = keys[:2]
            self.refuse(second, f"is given as well as {first}", "keep one of the two")
        if self.direction is not None and (self.kinetic_energy is None or not any(self.direction)):
            reason = (
                "has no length" if self.kinetic_energy is not None else "is that of a kinetic_energy, which is missing"
            )
            self.refuse("direction", reason, "leave it out, or complete it")
        speed = math.hypot(*(self.velocity or (0.0,)))
        if speed >= SPEED_OF_LIGHT:
            self.refuse("velocity", f"is {speed / SPEED_OF_LIGHT:.3g} c", "stay below c, or give a momentum")
        over_mc = math.hypot(*self.mean_momentum) / (self.species.mass * SPEED_OF_LIGHT)
        if over_mc > LARGEST_MOMENTUM:
            self.refuse(
                keys[0],
                f"is {over_mc:.3g} m c of its species, more than {LARGEST_MOMENTUM:g}",
                'plain numbers are SI; give a unit, such as "100 MeV/c" or "100 MeV"',
            )
        return self

    @property
    def mean_momentum(self) -> tuple[float, float, float]:
        """Mean momentum of one real particle in kg m/s."""
        if self.momentum is not None:
            return self.momentum
        if self.kinetic_energy is not None:
            over_mc = self.kinetic_energy / (self.species.mass * SPEED_OF_LIGHT**2)  # gamma - 1
            size = math.sqrt(over_mc * (over_mc + 2)) * self.species.mass * SPEED_OF_LIGHT
            direction = self.direction or (0.0, 0.0, 1.0)
            x, y, z = (size * d / math.hypot(*direction) for d in direction)
            return (x, y, z)
        velocity = self.velocity or (0.0, 0.0, 0.0)
        beta = math.hypot(*velocity) / SPEED_OF_LIGHT
        x, y, z = (self.species.mass * v / math.sqrt((1 - beta) * (1 + beta)) for v in velocity)
        return (x, y, z)

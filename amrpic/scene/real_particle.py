"""A real particle of a scene: its species, which is a name, or charge and mass, and how it moves."""

from __future__ import annotations

import math
from dataclasses import asdict
from typing import Annotated, Any, Self

from pydantic import Field, GetCoreSchemaHandler, GetJsonSchemaHandler, model_validator
from pydantic_core import CoreSchema, core_schema

from ..particles import species
from ..particles.species import LARGEST_MOMENTUM, SPECIES
from ..units import SPEED_OF_LIGHT
from .complaints import close_match, complaint
from .section import Section
from .units import Charge, Energy, Mass, Momentum3, Velocity3


class SpeciesSection(Section):
    """One real particle; momentum and weight of the macroparticles refer to it."""

    name: str = Field(default="", description="Its name in the outputs; filled in for those that are known by name.")
    charge: Charge = Field(description="Charge of one real particle, C.")
    mass: Mass = Field(gt=0, description="Mass of one real particle, kg; motion divides by it.")

    @model_validator(mode="before")
    @classmethod
    def _by_name(cls, data: Any) -> Any:
        if isinstance(data, species.Species):
            return asdict(data)
        if not isinstance(data, str):
            return data
        if data not in species.SPECIES:
            raise complaint(
                "is not a known species",
                f"give its charge and mass, or a name; {close_match(data, species.SPECIES)}",
                found=data,
            )
        return asdict(species.SPECIES[data])

    @classmethod
    def __get_pydantic_json_schema__(cls, schema: CoreSchema, handler: GetJsonSchemaHandler) -> dict[str, Any]:
        return {"anyOf": [{"enum": list(species.SPECIES)}, handler(schema)]}


class _FromSection:
    """Annotation of a field that holds a species and is written as `SpeciesSection`."""

    @staticmethod
    def __get_pydantic_core_schema__(source: Any, handler: GetCoreSchemaHandler) -> CoreSchema:
        return core_schema.no_info_after_validator_function(
            lambda section: species.Species(**dict(section)),
            handler.generate_schema(SpeciesSection),
            serialization=core_schema.plain_serializer_function_ser_schema(asdict),
        )


Species = Annotated[species.Species, _FromSection]


MOMENTUM = ("kinetic_energy", "velocity", "momentum")  # the keys that give it


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
        self.require_at_most_one(*MOMENTUM)
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
                self.given(*MOMENTUM)[0],
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

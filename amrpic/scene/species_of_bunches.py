"""The species of a bunch in a scene: a name, or charge and mass."""

from __future__ import annotations

from dataclasses import asdict
from typing import Annotated, Any

from pydantic import Field, GetCoreSchemaHandler, GetJsonSchemaHandler, model_validator
from pydantic_core import CoreSchema, core_schema

from ..particles import species
from .complaints import close_match, complaint
from .section import Section
from .units import Charge, Mass


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

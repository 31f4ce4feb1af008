"""Species: charge and mass of one real particle, and which particles are of which species."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Any, Self

import numpy as np
from pydantic import Field, GetJsonSchemaHandler, model_validator
from pydantic_core import CoreSchema

from .complaints import close_match
from .section import Section
from .units import SPECIES, Charge, Mass, complaint


class Species(Section):
    """One real particle; momentum and weight of the macroparticles refer to it."""

    name: str = Field(default="", description="Its name in the outputs; filled in for those that are known by name.")
    charge: Charge = Field(description="Charge of one real particle, C.")
    mass: Mass = Field(gt=0, description="Mass of one real particle, kg; motion divides by it.")

    @model_validator(mode="before")
    @classmethod
    def _by_name(cls, data: Any) -> Any:
        if not isinstance(data, str):
            return data
        if data not in SPECIES:
            raise complaint(
                "is not a known species",
                f"give its charge and mass, or a name; {close_match(data, SPECIES)}",
                found=data,
            )
        return dict(zip(("name", "charge", "mass"), (data, *SPECIES[data]), strict=True))

    @classmethod
    def __get_pydantic_json_schema__(cls, schema: CoreSchema, handler: GetJsonSchemaHandler) -> dict[str, Any]:
        return {"anyOf": [{"enum": list(SPECIES)}, handler(schema)]}

    def weight(self, charge: float, count: int) -> float:
        """Real particles that each of `count` macroparticles stands for if they carry `charge` (C) together."""
        return charge / (count * self.charge) if count else 0.0


@dataclass(frozen=True)
class SpeciesTable:
    """Which species each particle is of, told by its id, so that particles carry no column for it.

    Ids from `starts[r]` to `starts[r + 1] - 1` are of the species `kinds[members[r]]`. The same on all ranks.
    """

    kinds: tuple[Species, ...]
    starts: tuple[int, ...] = (0,)
    members: tuple[int, ...] = (0,)

    @classmethod
    def of_runs(cls, runs: Iterable[tuple[int, Species]]) -> Self:
        """Return the table for runs of ids: their first ids, ascending from 0, and their species."""
        firsts, species = zip(*runs, strict=True)
        kinds = tuple(dict.fromkeys(species))
        return cls(kinds, firsts, tuple(kinds.index(kind) for kind in species))

    @classmethod
    def from_dict(cls, data: Mapping[str, Any]) -> Self:
        """Return the table that `to_dict` described."""
        kinds = tuple(Species(**kind) for kind in data["kinds"])
        return cls(kinds, tuple(data["starts"]), tuple(data["members"]))

    def to_dict(self) -> dict[str, Any]:
        """Return what JSON can hold; numbers keep every bit."""
        kinds = [kind.model_dump() for kind in self.kinds]
        return {"kinds": kinds, "starts": list(self.starts), "members": list(self.members)}

    @cached_property
    def charges(self) -> np.ndarray:
        """Charge of one real particle of each species, C."""
        return np.array([kind.charge for kind in self.kinds])

    @cached_property
    def masses(self) -> np.ndarray:
        """Mass of one real particle of each species, kg."""
        return np.array([kind.mass for kind in self.kinds])

    @property
    def names(self) -> list[str]:
        """A name for each species, no two alike."""
        plain = [kind.name or "particles" for kind in self.kinds]
        return [name if plain.count(name) == 1 else f"{name}_{i}" for i, name in enumerate(plain)]

    def find(self, ids: np.ndarray) -> np.ndarray:
        """Return the index of the species of each id."""
        return np.array(self.members)[np.searchsorted(self.starts, ids, side="right") - 1]

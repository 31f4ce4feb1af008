"""Species: charge and mass of one real particle, and which particles are of which species."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from dataclasses import KW_ONLY, asdict, dataclass
from functools import cached_property
from typing import Any, Self

import numpy as np

from ..errors import ParticleError
from ..units import ALPHA_MASS, DEUTERON_MASS, ELECTRON_MASS, ELEMENTARY_CHARGE, PROTON_MASS


@dataclass(frozen=True)
class Species:
    """One real particle; momentum and weight of the macroparticles refer to it. `Species("electron")` is known by its name.

    Raises ParticleError for a charge that is not finite, a mass that is not positive, and an unknown name without them.
    """

    name: str = ""  # in the outputs
    _: KW_ONLY
    charge: float = math.nan  # C
    mass: float = math.nan  # kg; motion divides by it

    def __post_init__(self) -> None:
        if math.isnan(self.charge) and math.isnan(self.mass):
            self._become_known()
        if not np.isfinite(self.charge):
            raise ParticleError(f"the charge of a species is {self.charge} C; give a finite number")
        if not 0 < self.mass < np.inf:
            raise ParticleError(f"the mass of a species is {self.mass} kg; give a positive number")

    def _become_known(self) -> None:
        constants = SPECIES.get(self.name)
        if constants is None:
            raise ParticleError(
                f'the species "{self.name}" has neither charge nor mass; give both, or one of the names {", ".join(SPECIES)}'
            )
        object.__setattr__(self, "charge", constants.charge)
        object.__setattr__(self, "mass", constants.mass)

    def weight(self, charge: float, count: int) -> float:
        """Real particles that each of `count` macroparticles stands for if they carry `charge` (C) together."""
        return charge / (count * self.charge) if count else 0.0


LARGEST_MOMENTUM = 1e9  # over m c: beyond it the units of a momentum are wrong, and 1/γ² is below rounding

SPECIES = {
    name: Species(name=name, charge=charge, mass=mass)
    for name, charge, mass in (
        ("electron", -ELEMENTARY_CHARGE, ELECTRON_MASS),
        ("positron", ELEMENTARY_CHARGE, ELECTRON_MASS),
        ("proton", ELEMENTARY_CHARGE, PROTON_MASS),
        ("antiproton", -ELEMENTARY_CHARGE, PROTON_MASS),
        ("deuteron", ELEMENTARY_CHARGE, DEUTERON_MASS),
        ("alpha", 2 * ELEMENTARY_CHARGE, ALPHA_MASS),
        ("H-", -ELEMENTARY_CHARGE, PROTON_MASS + 2 * ELECTRON_MASS),
    )
}


@dataclass(frozen=True)
class SpeciesTable:
    """Which species each particle is of, known from its id, so that particles carry no column for it.

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

    @property
    def runs(self) -> list[tuple[int, Species]]:
        """The first id of each run, and its species."""
        return [(start, self.kinds[member]) for start, member in zip(self.starts, self.members, strict=True)]

    @classmethod
    def from_dict(cls, data: Mapping[str, Any]) -> Self:
        """Return the table that `to_dict` described."""
        kinds = tuple(Species(**kind) for kind in data["kinds"])
        return cls(kinds, tuple(data["starts"]), tuple(data["members"]))

    def to_dict(self) -> dict[str, Any]:
        """Return what JSON can hold; numbers keep every bit."""
        kinds = [asdict(kind) for kind in self.kinds]
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
        """A name for each species, no two the same."""
        plain = [kind.name or "particles" for kind in self.kinds]
        return [name if plain.count(name) == 1 else f"{name}_{i}" for i, name in enumerate(plain)]

    def find(self, ids: np.ndarray) -> np.ndarray:
        """Return the index of the species of each id."""
        return np.array(self.members)[np.searchsorted(self.starts, ids, side="right") - 1]

"""The key `lattice` of a scene: a file of another code, whose elements become those of the scene."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any, Literal

import numpy as np
from pydantic import Field, model_validator

from ..errors import InputError
from ..lattice import madx, pals
from ..lattice.convert import Converted, LatticeSettings, converted
from ..lattice.pieces import Beamline, LatticeReference, OrbitFrame
from ..mesh.window import axes
from ..particles.species import SPECIES
from ..units import SPEED_OF_LIGHT
from .real_particle import Species
from .section import Section
from .units import Energy, Length, Length3

PALS = (".yaml", ".yml")


class LatticeSection(Section):
    """A lattice of another code."""

    file: str = Field(
        description="In YAML of PALS (.yaml), or a sequence of MAD-X, which xtrack reads; relative to the scene file."
    )
    line: str | None = Field(default=None, description="Which line, branch or sequence, if the file has several.")
    species: Species | None = Field(default=None, description="In place of what the file says.")
    kinetic_energy: Energy | None = Field(
        default=None, gt=0, description="Of the reference particle, J, in place of what the file says."
    )
    missing: Literal["refuse", "drift"] = Field(
        default="refuse",
        description="What has no counterpart: refuse names it and its place; drift leaves it out. `amrpic lattice` lists it.",
    )
    reach: Length = Field(
        default=LatticeSettings.reach, gt=0, description="Distance from their axes within which elements act, m."
    )
    thin: Length = Field(default=LatticeSettings.thin, gt=0, description="Length that thin elements get, m.")
    position: Length3 = Field(default=(0.0, 0.0, 0.0), description="Where the line begins, m.")
    direction: tuple[float, float, float] = Field(default=(0.0, 0.0, 1.0), description="Where it goes to then.")

    @model_validator(mode="before")
    @classmethod
    def _by_name(cls, data: Any) -> Any:
        return {"file": data} if isinstance(data, str) else data

    def converted(self) -> Converted:
        """Return what the lattice becomes. InputError, in one sentence, for a file that is not understood."""
        line = (pals if Path(self.file).suffix.lower() in PALS else madx).read(self.file, self.line)
        start = OrbitFrame(np.array(self.position), np.array(axes(self.direction, 0.0)))
        return converted(
            line, self._reference(line), LatticeSettings(self.missing == "drift", self.reach, self.thin, start)
        )

    def _reference(self, line: Beamline) -> LatticeReference:
        species, momentum = self.species or line.species, line.momentum
        if species is not None and self.kinetic_energy is not None:
            over_mc = self.kinetic_energy / (species.mass * SPEED_OF_LIGHT**2)  # γ - 1
            momentum = species.mass * SPEED_OF_LIGHT * (over_mc * (over_mc + 2)) ** 0.5
        if species is None or momentum is None:
            raise InputError(
                f"lattice {self.file} does not say species and momentum of its reference particle; give species and "
                "kinetic_energy in [lattice]"
            )
        return LatticeReference(species, momentum)


def with_lattice(data: Mapping[str, Any]) -> dict[str, Any]:
    """Return the data of a scene with the elements, apertures and screens of its lattice in place of that, and with its
    reference particle where the mesh is to go with one and the scene gives none."""
    out = dict(data)
    lattice = out.pop("lattice")
    of = (lattice if isinstance(lattice, LatticeSection) else LatticeSection.model_validate(lattice)).converted()
    for key, sections in (("elements", of.elements), ("apertures", of.apertures), ("screens", of.screens)):
        if sections:
            out[key] = [*(out.get(key) or []), *sections]
    motion = out.get("motion")
    if isinstance(motion, Mapping) and motion.get("window") == "reference" and "reference" not in motion:
        out["motion"] = {**motion, "reference": _particle(of)}
    return out


def _particle(of: Converted) -> dict[str, Any]:
    start, species = of.placed[0].entry if of.placed else of.end, of.reference.species
    named = SPECIES.get(species.name) == species
    return {
        "species": species.name if named else {"name": species.name, "charge": species.charge, "mass": species.mass},
        "momentum": (of.reference.momentum * start.axes[2]).tolist(),
        "position": start.origin.tolist(),
    }

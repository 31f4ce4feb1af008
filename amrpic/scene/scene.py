"""The scene: everything that a run depends on, as one frozen model that TOML files and Python share."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping
from pathlib import Path
from typing import Any, Self

from pydantic import model_validator

from .. import tables
from ..particles.groups import NamedBunches
from .electrode_shapes import anchor_files
from .fits_together import check
from .lattice_file import with_lattice
from .obstacles import out_of_reach
from .parts import SceneParts
from .section import Section
from .thermal_bunch import ThermalBunch


class Scene(SceneParts):
    """A run, described: where, what charge, how refined, how solved, how moved, how long, what written."""

    @model_validator(mode="before")
    @classmethod
    def _lattice_in_elements(cls, data: Any) -> Any:
        return with_lattice(data) if isinstance(data, Mapping) and data.get("lattice") is not None else data

    @model_validator(mode="after")
    def _fits_together(self) -> Self:
        check(self)
        return self

    @staticmethod
    def _anchor_files(data: dict[str, Any], folder: Path) -> None:
        match data.get("lattice"):
            case str() as file:
                data["lattice"] = {"file": str(folder / file)}
            case {"file": str() as file, **rest}:
                data["lattice"] = {**rest, "file": str(folder / file)}
        for key in ("bunches", "sources", "elements"):
            members = data.get(key)
            for member in members if isinstance(members, list) else []:
                if isinstance(member, dict) and isinstance(member.get("file"), str):
                    member["file"] = str(folder / member["file"])
        for key in ("apertures", "electrodes"):
            anchor_files(data.get(key), folder)

    def with_clouds(self, **changes: str) -> Self:
        """Return the scene with other values of some keys of `particles`."""
        return self.model_copy(update={"particles": self.particles.model_copy(update=changes)})

    def particle_count(self) -> int:
        """Macroparticles of the whole scene at its start."""
        return sum(bunch.number * bunch.copies for bunch in self.bunches)

    @property
    def source_names(self) -> list[str]:
        """What the sources are called in outputs."""
        return [source.name or f"source_{number}" for number, source in enumerate(self.sources)]

    def named_bunches(self) -> list[NamedBunches]:
        """Return what the particles of each run of ids are called: bunches in their order, and behind them sources."""
        sources = [NamedBunches(name, 1, 0) for name in self.source_names]
        return [*(NamedBunches(bunch.name, bunch.copies, bunch.number) for bunch in self.bunches), *sources]

    @property
    def extrapolates_potential(self) -> bool:
        """Whether solves start from what the potentials of the two steps before lead to: of particles that fly on, where few
        cycles are enough."""
        return self.motion.follows_fields and self.solver.tolerance == "discretization"

    def summary(self) -> str:
        """Return in one line what the scene is."""
        cells = "x".join(map(str, self.domain.cells))
        count = sum(bunch.copies for bunch in self.bunches)
        bunches = f"{count} bunch" if count == 1 else f"{count} bunches"
        of_files = " and those in files" if any(bunch.source for bunch in self.bunches) else ""
        of_files += f", {len(self.sources)} source{'s' * (len(self.sources) > 1)}" if self.sources else ""
        return (
            f"{self.name}: {cells} cells and {self.refinement.levels} refined levels, {bunches} of "
            f"{self.particle_count()} particles in all{of_files}, {self.schedule.last_step} steps after the first solve"
        )

    def _repr_html_(self) -> str:
        rows: list[tuple[str, str]] = []
        for key in sorted(self.model_fields_set - {"name"}, key=list(type(self).model_fields).index):
            value = getattr(self, key)
            members = (
                {f"{key}.{n}": section for n, section in enumerate(value)} if isinstance(value, list) else {key: value}
            )
            rows += [(where, _brief(section)) for where, section in members.items()]
        return tables.html(("key", "value, where it is not the default"), rows, f"Scene: {self.summary()}")

    def remarks(self) -> list[str]:
        """Return one sentence for each thing that is legal and yet may not be meant."""
        out = self.domain.remarks()
        if self.particle_count() == 0 and not self.sources and not any(bunch.source for bunch in self.bunches):
            out.append("the scene has zero particles; the field is that of the boundary alone")
        if self.elements and not self.motion.follows_fields:
            out.append(f'elements act on nothing, since motion.kind is "{self.motion.kind}"; set it to "leapfrog"')
        for number, bunch in enumerate(self.bunches):
            if isinstance(bunch, ThermalBunch) and not math.isclose(bunch.length, self.domain.value.period(2)):
                out.append(
                    f"bunches.{number} is a piece of a continuous beam, {bunch.length:g} m long, which a domain would continue "
                    "that is periodic along z over this length"
                )
        if self.screens and self.motion.kind == "none":
            out.append('nothing passes screens, since motion.kind is "none"; set it to "leapfrog"')
        if self.motion.window == "none":
            out += out_of_reach(self.apertures, self.screens, self.domain.lower[2], self.domain.upper[2])
        tests = [str(number) for number, bunch in enumerate(self.bunches) if not bunch.self_field]
        if tests and any(getattr(self.bunches[int(number)], "charge", None) for number in tests):
            out.append(f"bunches.{', '.join(tests)} makes no field (self_field = false), and its charge counts as 0")
        flat = [str(number) for number, bunch in enumerate(self.bunches) if bunch.zero_size()]
        if flat:
            out.append(f"bunches.{', '.join(flat)} has zero size; its field is limited by the cell width alone")
        return out


def _brief(value: Any) -> str:
    """Return what a section holds besides defaults, after its kind if it has one; other values as they are."""
    if not isinstance(value, Section):
        return str(value)
    kind = getattr(value, "kind", None) or getattr(value, "distribution", None)
    settings = value.model_dump(mode="json", exclude_defaults=True, exclude_none=True)
    text = ", ".join(f"{key} = {json.dumps(setting, ensure_ascii=False)}" for key, setting in settings.items())
    return f"{kind}: {text}" if kind else text

"""What the sources of a run have given up to a state."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass
from typing import Any, Self

import numpy as np

from ..errors import InputError
from ..particles.species import Species, SpeciesTable
from ..scene.scene import Scene
from ..scene.sources import first_ids
from ..units import Column
from .emitters import Emitter

PARTS = 32  # of the map of a source, along either axis of its surface
SOURCES = "sources.csv"
TABLE = (
    Column("step", counts=True),
    Column("time", "s"),
    Column("source", is_text=True),
    Column("born_particles", counts=True),
    Column("born_charge", "C"),
    Column("current", "A"),  # mean of the latest step
)
EMISSION_MAP = "emission.csv"
MAP_COLUMNS = (
    Column("source", is_text=True),
    Column("x", "m"),
    Column("y", "m"),
    Column("area", "m^2"),
    Column("charge", "C"),
)


@dataclass(frozen=True)
class Tally:
    """What a source has given, on all ranks."""

    used: int = 0  # of its particles' numbers that are used up
    particles: int = 0  # macroparticles that were born in the domain
    charge: float = 0.0  # C, theirs
    latest: float = 0.0  # C, of those of the latest step
    map: tuple[
        float, ...
    ] = ()  # C, of parts of its surface, PARTS along either axis; none of a source without a surface

    def after(self, used: int, particles: int, charges: np.ndarray) -> Tally:
        """Return the tally after a step that gives charges to parts of a surface, (PARTS²,) or all to one, (1,), in C."""
        before = np.array(self.map) if self.map else np.zeros(len(charges))
        charge = float(charges.sum())
        map_ = tuple((before + charges).tolist()) if len(charges) > 1 else ()
        return Tally(max(self.used, used), self.particles + particles, self.charge + charge, charge, map_)


@dataclass(frozen=True)
class Tallies:
    """Those of all sources of a scene."""

    of: tuple[Tally, ...] = ()

    @classmethod
    def of_scene(cls, scene: Scene, earlier: Sequence[Mapping[str, Any]] = ()) -> Self:
        """Return those before the first birth; what is `earlier`, by `to_list`, goes on."""
        return cls(
            (
                *(Tally(**{**of, "map": tuple(of.get("map", ()))}) for of in earlier),
                *(Tally() for _ in scene.sources[len(earlier) :]),
            )
        )

    def rows(self, scene: Scene, duration: float) -> Iterator[dict[str, float | str]]:
        """Yield what `SOURCES` has of each source, after a latest step of so many s."""
        for name, tally in zip(scene.source_names, self.of, strict=True):
            current = tally.latest / duration if duration > 0 else 0.0
            yield {"source": name, "born_particles": tally.particles, "born_charge": tally.charge, "current": current}

    def map_rows(self, scene: Scene, emitters: Sequence[Emitter]) -> Iterator[dict[str, float | str]]:
        """Yield what `EMISSION_MAP` has: a row per source and part of its surface, with the middle along its own axes."""
        for name, emitter, tally in zip(scene.source_names, emitters, self.of, strict=True):
            if emitter.extent is None or not tally.map:
                continue
            lower, upper = emitter.extent
            width = (upper - lower) / PARTS
            for place, charge in zip(np.ndindex(PARTS, PARTS), tally.map, strict=True):
                x, y = (lower + width * (np.array(place) + 0.5)).tolist()
                yield {"source": name, "x": x, "y": y, "area": float(width.prod()), "charge": charge}

    def to_list(self) -> list[dict[str, Any]]:
        """Return what JSON can hold; numbers keep every bit."""
        return [asdict(tally) for tally in self.of]


def with_sources(earlier: Iterable[tuple[int, Species]], scene: Scene) -> SpeciesTable:
    """Return the species of runs of ids and of sources, which may have none yet. InputError if a source had others before."""
    runs = dict(earlier)
    for number, (first, source) in enumerate(zip(first_ids(scene.sources), scene.sources, strict=True)):
        if runs.setdefault(first, source.species) != source.species:
            raise InputError(
                f"sources.{number} is of {source.species}, and was of {runs[first]} up to the checkpoint; give it "
                "that species, and add another source behind the others"
            )
    return SpeciesTable.of_runs(sorted(runs.items()))

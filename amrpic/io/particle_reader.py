"""Reading all particles of a dump at once, for pictures: of checkpoints, and of openPMD files."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from ..errors import InputError
from ..mesh.domain import Domain
from ..mesh.window import window_of
from ..particles.groups import Groups
from ..particles.particles import Particles, concatenate
from ..particles.species import SpeciesTable
from ..scene.scene import Scene
from . import openpmd_reader
from .checkpoint import is_checkpoint, open_vetted
from .writer_ranks import one_line


@dataclass(frozen=True)
class ParticleDump:
    """The particles of a dump in the laboratory, and how they are grouped."""

    path: Path
    step: int
    time: float  # s
    particles: Particles
    groups: Groups
    domain: Domain | None  # in which they are, where that is known


def read(path: Path) -> ParticleDump:
    """Return the particles of a checkpoint, of an openPMD file, or of the latest of those in a run's folder.

    Serial. Raises InputError if there are none. An openPMD file knows species, but no bunches.
    """
    path = Path(path)
    if is_checkpoint(path):
        return _of_checkpoint(path)
    if not path.is_dir():
        return _of_openpmd(path)
    dumps = [*path.glob("particles_????????.h5"), *path.glob("checkpoint_????????")]
    if not dumps:
        raise InputError(
            f"{path} holds neither checkpoint_* nor particles_*.h5; name a folder that a run wrote into, or a dump in it"
        )
    latest = max(dumps, key=lambda dump: (dump.stem.rpartition("_")[2], dump.is_dir()))
    return _of_checkpoint(latest) if latest.is_dir() else _of_openpmd(latest)


def _of_checkpoint(path: Path) -> ParticleDump:
    h5, contents = open_vetted(path)
    header = contents.header
    with h5:
        try:
            position, momentum, weight, ids = (
                h5[f"particles/{column}"][:] for column in ("position", "momentum", "weight", "id")
            )
        except (OSError, KeyError) as error:
            raise InputError(f"checkpoint {path} cannot be read: {one_line(error)}; draw another one") from None
    table = SpeciesTable.from_dict(header.extra["species"])
    scene = Scene.from_dict(header.about.scene, source=f"the scene in {path}")
    window = window_of(header.extra.get("course", {}).get("window", {}))
    particles = Particles(position, momentum, weight, ids, table).in_laboratory(window)
    return ParticleDump(
        path,
        header.step,
        header.time,
        particles,
        Groups.of(table, scene.named_bunches()),
        window.shown(scene.domain.value),
    )


def _of_openpmd(path: Path) -> ParticleDump:
    names = openpmd_reader.groups(path)
    parts: list[Particles] = []
    for name in names:
        first = sum(map(len, parts))
        parts.append(openpmd_reader.read(path, lambda count: (0, count), group=name or None, first_id=first))
    ends = np.cumsum([0, *map(len, parts)])
    table = SpeciesTable.of_runs((int(end), part.species.kinds[0]) for end, part in zip(ends[:-1], parts, strict=True))
    particles = concatenate([Particles(*part.arrays, table) for part in parts])
    step, time = openpmd_reader.when(path)
    return ParticleDump(path, step, time or 0.0, particles, Groups.of_species(table), openpmd_reader.domain_of(path))

"""What a run wrote, read back: its scene, tables, fields, particles and losses."""

from __future__ import annotations

import json
import re
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from types import ModuleType
from typing import TYPE_CHECKING, Any

import numpy as np

from .. import tables
from ..errors import InputError
from ..io import openpmd_reader, particle_reader, time_series
from ..io.atomic_files import REPLACED, TEMPORARY
from ..io.checkpoint import is_checkpoint
from ..io.field_reader import open_dump
from ..mesh.domain import AXES
from ..mpi import MPI
from ..parallel import own, share, together, world_by_default
from ..particles.particles import Particles
from ..scene.scene import Scene
from ..units import ELEMENTARY_CHARGE, SPEED_OF_LIGHT
from .dumped_fields import DumpedFields, is_of_points, scene_of

if TYPE_CHECKING:
    import pandas
    from beamphysics import ParticleGroup

SERIES = "series.csv"
LOSSES = "losses.h5"
PARTICLES = "particles_*.h5", "checkpoint_*"  # what holds some


@dataclass(frozen=True, repr=False)
class Results:
    """What lies in the folder of a run, or in a dump or checkpoint of one; read when it is asked for.

    All ranks of `comm` ask together; tables are the same on all. Raises InputError on all ranks for what is not there.
    """

    comm: MPI.Comm
    path: Path
    stopped: str | None = None  # why the run ended before its last step, if it did and this process ran it

    @classmethod
    @world_by_default
    def open(cls, comm: MPI.Comm, path: str | Path) -> Results:
        """Return what a run wrote, by its folder, or what one of its dumps or checkpoints holds. Collective.

        `comm` may be left out: all ranks. Raises InputError on all ranks if there is no such path.
        """
        folder = Path(path)
        with together(comm, InputError):
            if not folder.exists():
                raise InputError(f"{folder} does not exist; give the folder of a run, or a dump or checkpoint in it")
        return cls(own(comm), folder)

    @property
    def folder(self) -> Path:
        """That of the run."""
        return self.path if self.path.is_dir() and not is_checkpoint(self.path) else self.path.parent

    @cached_property
    def scene(self) -> Scene:
        """The resolved scene. Collective."""
        with together(self.comm, InputError):
            return scene_of(self._scene(), self.path)

    @property
    def of_points(self) -> bool:
        """Whether the run was of material points, of which tables alone are read back here. Local."""
        return is_of_points(self._scene())

    def _scene(self) -> Mapping[str, Any]:
        if self.folder == self.path and (series := self.folder / SERIES).exists():
            return time_series.scene_of(series)
        with open_dump(self.path) as dump:
            return json.loads(dump.scene_text)

    def __repr__(self) -> str:
        return f"Results({str(self.path)!r}: {'; '.join(f'{attribute}: {content}' for attribute, content in self._content())})"

    def _repr_html_(self) -> str:
        return tables.html(("what", "there is"), self._content(), f"Results of {self.path}")

    def _content(self) -> list[tuple[str, str]]:
        """What lies there, by the names of attributes that read it. Local."""
        tables = sorted(file.stem for file in self.folder.glob("*.csv")) if self.folder == self.path else []
        contents = {
            "tables": ", ".join(tables),
            "fields of steps": ", ".join(map(str, self.fields)),
            "particles of steps": ", ".join(map(str, sorted(self._dumps(*PARTICLES)))),
            "losses": LOSSES if self.folder == self.path and (self.folder / LOSSES).exists() else "",
        }
        return [(attribute, content or "none") for attribute, content in contents.items()]

    # ---- tables ----

    @property
    def series(self) -> pandas.DataFrame:
        """A row per step: see `amrpic.stages.diagnostics.quantities`. Collective."""
        return self.table("series")

    @property
    def residuals(self) -> pandas.DataFrame:
        """The residual before the first and after each cycle of every solve. Collective."""
        return self.table("residuals")

    @property
    def beam(self) -> pandas.DataFrame:
        """A row per group of particles at some steps: emittances, Twiss parameters, halo. Collective."""
        return self.table("beam")

    def table(self, name: str) -> pandas.DataFrame:
        """Return a table of the run: "series", "residuals", "beam", "slices", "losses" (the map along z), "own_…". Collective.

        Its `attrs["units"]` give the unit of each column.
        """
        with together(self.comm, InputError):
            return _frame(self.folder, f"{name}.csv")

    # ---- dumps ----

    @cached_property
    def fields(self) -> Mapping[int, DumpedFields]:
        """The fields by step, of field files and, where there are none, of checkpoints."""
        return Dumps(self.comm, self._dumps("fields_*.vtkhdf", "checkpoint_*"))

    def particles(self, step: int | None = None) -> Particles:
        """Return this rank's share of the particles at a step, the latest if none is given, in the laboratory. Collective."""
        with together(self.comm, InputError):
            all_of_them = particle_reader.read(self._particle_dump(step)).particles
            return all_of_them.select(slice(*share(self.comm, len(all_of_them))))

    def particle_group(self, step: int | None = None, species: str | None = None) -> ParticleGroup:
        """Return all particles of a species, which may be left out if there is one, for openPMD-beamphysics. Collective."""
        with together(self.comm, InputError):
            return _particle_group(particle_reader.read(self._particle_dump(step)), species)

    @property
    def losses(self) -> pandas.DataFrame:
        """A row per lost particle: id, species, where and when it was lost, its momentum, and at what. Collective."""
        with together(self.comm, InputError):
            return _losses(self.folder / LOSSES)

    def _particle_dump(self, step: int | None) -> Path:
        dumps = self._dumps(*PARTICLES)
        if step is None and dumps:
            step = max(dumps)
        if step not in dumps:
            raise InputError(
                f"{self.path} holds no particles{'' if step is None else f' of step {step}'}; {_choice(dumps)}"
            )
        return dumps[step]

    def _dumps(self, *patterns: str) -> dict[int, Path]:
        """Dumps by step; those of the first pattern come first."""
        paths = [self.path] if self.folder != self.path else []
        for pattern in patterns if not paths else ():
            paths += sorted(self.folder.glob(pattern))
        by_step: dict[int, Path] = {}
        for path in paths:
            step = re.fullmatch(r"[a-z]+_(\d{8,})(\.\w+)?", path.name)
            if step and path.suffix not in (TEMPORARY, REPLACED):
                by_step.setdefault(int(step[1]), path)
        return by_step


class Dumps(Mapping[int, DumpedFields]):
    """Field dumps by step, opened when they are asked for."""

    def __init__(self, comm: MPI.Comm, paths: Mapping[int, Path]) -> None:
        self._comm, self._paths = comm, dict(sorted(paths.items()))

    def __getitem__(self, step: int) -> DumpedFields:
        if step not in self._paths:
            raise InputError(f"there are no fields of step {step}; {_choice(self._paths)}")
        return DumpedFields.read(self._comm, self._paths[step])

    def __iter__(self) -> Iterator[int]:
        return iter(self._paths)

    def __len__(self) -> int:
        return len(self._paths)

    def __repr__(self) -> str:
        return f"fields of steps {', '.join(map(str, self._paths)) or 'none'}"


def rows_of(folder: Path) -> np.ndarray:
    """Return the rows of the series of a run. Raises InputError if there are none."""
    rows = time_series.read(folder / SERIES)
    if len(rows) == 0:
        raise InputError(f"{folder / SERIES} has no rows yet; let the run make its first step")
    return rows


def _choice(steps: Mapping[int, Path]) -> str:
    return f"choose among {', '.join(map(str, sorted(steps)))}" if steps else "see output.write of the scene"


def _frame(folder: Path, name: str) -> pandas.DataFrame:
    pandas = _pandas()
    path = folder / name
    if not path.exists():
        tables = sorted(file.stem for file in folder.glob("*.csv"))
        choice = f"choose among {', '.join(tables)}" if tables else "it has no tables"
        raise InputError(f"{folder} holds no {name}; {choice}")
    frame = pandas.DataFrame(time_series.read(path))
    frame.attrs["units"] = time_series.units_of(path)
    return frame


def _particle_group(dump: particle_reader.ParticleDump, species: str | None) -> ParticleGroup:
    try:
        from beamphysics import ParticleGroup
    except ImportError:
        raise InputError("a ParticleGroup needs openpmd-beamphysics, which is not installed") from None
    table = dump.particles.species
    names = [name for name in table.names if species in (None, name)]
    if len(names) != 1:
        raise InputError(f"{dump.path} holds the species {', '.join(table.names)}; name one of them")
    kind = table.names.index(names[0])
    particles = dump.particles.select(dump.particles.kind == kind)
    in_ev = particles.momentum * (SPEED_OF_LIGHT / ELEMENTARY_CHARGE)
    count = len(particles)
    return ParticleGroup(
        data={
            **dict(zip(AXES, particles.position.T, strict=True)),
            **{f"p{axis}": momentum for axis, momentum in zip(AXES, in_ev.T, strict=True)},
            "t": np.full(count, dump.time),
            "status": np.ones(count),
            "weight": particles.weight * abs(table.charges[kind]),
            "species": names[0],
            "id": particles.id,
        }
    )


def _losses(path: Path) -> pandas.DataFrame:
    pandas = _pandas()
    columns = [
        {
            "id": record.id,
            "species": np.full(len(record.id), record.species),
            "time": record.time,
            **dict(zip(AXES, record.position.T, strict=True)),
            **{f"p{axis}": momentum for axis, momentum in zip(AXES, record.momentum.T, strict=True)},
            "weight": record.weight,
            "at": record.cause,
        }
        for record in openpmd_reader.records(path)
    ]
    return pandas.concat(map(pandas.DataFrame, columns), ignore_index=True)


def _pandas() -> ModuleType:
    try:
        import pandas
    except ImportError:
        raise InputError("tables need pandas, which is not installed; pip install pandas") from None
    return pandas

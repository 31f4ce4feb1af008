"""Particle dumps: openPMD files with the BeamPhysics extension.

A file is openPMD 1.1 with, in addition, what BeamPhysics asks for. Momenta, times and places are in SI units, numbers of real
particles as such (`weighting`, beside BeamPhysics's `weight` in C), so that they read back bit for bit.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import Any

import h5py
import numpy as np
from numpy.typing import NDArray

from ..mesh.domain import AXES
from ..mesh.window import Window
from ..mpi import MPI
from ..particles.particles import Particles
from ..particles.species import Species
from . import shared_file
from .openpmd_files import describe_file, set_text
from .provenance import Moment, Provenance
from .shared_file import RowTable
from .writer_ranks import BY_SIZE, Attempts, Writers

CATHODE, ALIVE = 0, 1  # of BeamPhysics's particleStatus
DEAD = 2  # the first of those that say how a particle ended

# Powers of length, mass, time, current, temperature, amount, luminous intensity.
LENGTH, TIME, NONE = (1, 0, 0, 0, 0, 0, 0), (0, 0, 1, 0, 0, 0, 0), (0, 0, 0, 0, 0, 0, 0)
MOMENTUM, MASS, CHARGE = (1, 1, -1, 0, 0, 0, 0), (0, 1, 0, 0, 0, 0, 0), (0, 0, 1, 1, 0, 0, 0)

Array = NDArray[Any]


def path_of(directory: Path, step: int) -> Path:
    """Return where the particles of a step lie in a run's directory."""
    return Path(directory) / f"particles_{step:08d}.h5"


def write(
    comm: MPI.Comm,
    path: Path,
    particles: Particles,
    moment: Moment,
    about: Provenance,
    columns: Mapping[str, Array] | None = None,
    causes: Sequence[str] = (),
    writers: Writers = BY_SIZE,
) -> None:
    """Write all particles into the file `path`, which is there whole and synced on return, or unchanged. Collective.

    A group for each species holds its particles in the order of their ids, which is the same on any number of ranks; in a file
    of several parts (`shared_file`) each part is in this order, and holds the particles of a group of ranks, wherever they are.
    Particles of a window are written along the axes of the laboratory, their places from its origin, with this as the offset.
    `columns` (n,) are records besides, of float64 or int64; of those that else have one value for all, `time` (s) may be among
    them, by which equal ids are ordered, and `particleStatus`, that of a dead particle being `DEAD` and the index of its cause.
    Raises OutputError on all ranks.
    """
    own = columns or {}
    path = Path(path)
    attempts = Attempts(f"cannot write particles {path}")
    attempts.on_rank_0(comm, partial(path.parent.mkdir, parents=True, exist_ok=True))
    kinds, kind, window = particles.species.kinds, particles.kind, moment.window
    root = f"/data/{moment.step}/particles"
    groups = {f"{root}/{name}": species for name, species in zip(particles.species.names, kinds, strict=True)}
    charges = [particles.weight.sum(where=kind == number) * abs(kind_.charge) for number, kind_ in enumerate(kinds)]
    total = comm.allreduce(np.array(charges))
    tables = {
        group: _table(particles, kind == number, window, own, abs(species.charge))
        for number, (group, species) in enumerate(groups.items())
    }

    def describe(h5: h5py.File) -> None:
        describe_file(h5, path, moment, about)
        set_text(h5, "particlesPath", "particles/")
        if causes:
            h5["amrpic/causes"] = list(causes)
        h5.require_group(root)
        for (group, species), charge in zip(groups.items(), total.tolist(), strict=True):
            _describe(h5, group, species, charge, moment, own)

    shared_file.write(comm, path, tables, describe, attempts, writers)


def _table(particles: Particles, chosen: Array, window: Window, own: Mapping[str, Array], charge: float) -> RowTable:
    """Return those particles that are `chosen`, (n,) bool, as rows of records in the order of ids; `charge` of one in C."""
    vectors = [(f"{name}/{axis}", float) for name in ("position", "momentum") for axis in AXES]
    scalars = [("weighting", float), ("weight", float), ("id", np.uint64)]
    dtype = np.dtype([*vectors, *scalars, *((name, column.dtype) for name, column in own.items())])
    numbers = np.flatnonzero(chosen)
    keys = {"id": particles.id[numbers], **({"time": own["time"][numbers]} if "time" in own else {})}
    numbers = numbers[np.lexsort(list(reversed(keys.values())))]

    def rows(numbers: Array) -> Array:
        out = np.empty(len(numbers), dtype)
        for name, vectors in (("position", particles.position), ("momentum", particles.momentum)):
            turned = window.to_laboratory(vectors[numbers]) if window.is_turned else None
            for i, axis in enumerate(AXES):
                out[f"{name}/{axis}"] = vectors[:, i][numbers] if turned is None else turned[:, i]
        out["weighting"], out["id"] = particles.weight[numbers], particles.id[numbers]
        out["weight"] = out["weighting"] * charge
        for name, column in own.items():
            out[name] = column[numbers]
        return out

    return RowTable(dtype, numbers, rows, list(keys))


def _describe(
    h5: h5py.File,
    group: str,
    species: Species,
    charge: float,
    moment: Moment,
    own: Mapping[str, Array],
) -> None:
    """Add units, and what holds for all particles of a species but what they have `own` columns for."""
    dimensions = {"position": LENGTH, "momentum": MOMENTUM, "weight": CHARGE, "time": TIME}
    for name in [f"{record}/{axis}" for record in ("position", "momentum") for axis in AXES]:
        _set_units(h5, f"{group}/{name}", dimensions[name[:-2]])
    for name in ("weighting", "weight", "id", *own):
        _set_units(h5, f"{group}/{name}", dimensions.get(name, NONE))
    member, count = h5[group], len(h5[f"{group}/id"])
    set_text(member, "speciesType", species.name or "other")
    member.attrs.update(numParticles=count, totalCharge=charge, chargeUnitSI=1.0)
    for axis, offset in zip(AXES, moment.window.origin, strict=True):
        _constant(h5, f"{group}/positionOffset/{axis}", offset, count, LENGTH)
    for name, value, dimension in (
        ("charge", species.charge, CHARGE),
        ("mass", species.mass, MASS),
        ("time", moment.time, TIME),
        ("particleStatus", ALIVE, NONE),
    ):
        if name not in own:
            _constant(h5, f"{group}/{name}", value, count, dimension)


def _constant(h5: h5py.File, name: str, value: float, count: int, dimension: tuple[int, ...]) -> None:
    component = h5.create_group(name)
    component.attrs.update(value=value, shape=np.array([count], dtype=np.uint64))
    _set_units(h5, name, dimension)


def _set_units(h5: h5py.File, name: str, dimension: tuple[int, ...]) -> None:
    """Set what openPMD asks of a component and of its record, which are one for a scalar."""
    h5[name].attrs["unitSI"] = 1.0
    record = h5[name] if name.rpartition("/")[2] not in AXES else h5[name].parent
    # Momentum, charge and mass are those of a real particle; the rest does not know the difference.
    record.attrs.update(unitDimension=np.array(dimension, dtype=np.float64), timeOffset=0.0)
    record.attrs.update(macroWeighted=np.uint32(name.endswith(("/weighting", "/weight"))), weightingPower=1.0)

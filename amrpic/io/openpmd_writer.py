"""Particle dumps: openPMD files with the BeamPhysics extension.

A file is openPMD 1.1 with, in addition, what BeamPhysics asks for. Momenta, times and places are in SI units, numbers of real
particles as such (`weighting`, beside BeamPhysics's `weight` in C), so that they read back bit for bit.
"""

from __future__ import annotations

import contextlib
from collections.abc import Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import Any

import h5py
import numpy as np
from mpi4py import MPI
from numpy.typing import NDArray

from ..errors import OutputError
from ..mesh.domain import AXES
from ..mesh.window import AT_REST, Window
from ..particles.particles import Particles
from ..particles.species import Species
from .atomic_files import Hdf5Writer, publish, remove, temporary
from .provenance import Provenance
from .writer_ranks import Attempts, Rows, collect

ALIVE = 1  # of BeamPhysics's particleStatus
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
    step: int,
    time: float,
    about: Provenance,
    window: Window = AT_REST,
    columns: Mapping[str, Array] | None = None,
    causes: Sequence[str] = (),
) -> None:
    """Write all particles into the file `path`, which is there whole and synced on return, or unchanged. Collective.

    A group for each species holds its particles in the order of their ids, which is the same on any number of ranks. Rank 0
    writes what it receives in small pieces. Particles of a `window` are written along the axes of the laboratory, their places
    from its origin, with this as the offset. `columns` (n,) are records besides, of float64 or int64; of those that else have
    one value for all, `time` (s) may be among them, by which equal ids are ordered, and `particleStatus`, that of a dead
    particle being `DEAD` and the index of its cause. Raises OutputError on all ranks.
    """
    columns = columns or {}
    path = Path(path)
    attempts = Attempts(f"cannot write particles {path}", "free some space or choose another output folder")
    if window.is_turned:
        particles = particles.replace(*map(window.to_laboratory, (particles.position, particles.momentum)))
    ordered, columns = _by_id(comm, particles, columns)
    writer = attempts.attempt(_open, path, step, time, about, causes) if comm.rank == 0 else None
    for kind, (name, species) in enumerate(zip(ordered.species.names, ordered.species.kinds, strict=True)):
        group = f"/data/{step}/particles/{name}"
        mine = ordered.kind == kind
        own = {name: column[mine] for name, column in columns.items()}
        _write_species(comm, writer, group, species, ordered.select(mine), own, time, window, attempts)
    if writer is not None:
        attempts.always(writer.close)
    if comm.rank == 0:
        attempts.attempt(publish, path)
        with contextlib.suppress(OSError):
            remove(temporary(path))  # it is gone already unless an attempt failed
    attempts.settle(comm, OutputError)


def _by_id(comm: MPI.Comm, particles: Particles, columns: Mapping[str, Array]) -> tuple[Particles, Mapping[str, Array]]:
    """Return the particles with this rank's equal share of the ids, in their order, and the columns. Collective."""
    position, momentum, weight, id = particles.arrays
    order = np.argsort(id, kind="stable")
    more = [column.view(np.float64) for column in columns.values()]
    rows = np.column_stack([position, momentum, weight, id.view(np.float64), *more])[order]
    last = np.array(id.max(initial=-1), dtype=np.int64)
    comm.Allreduce(MPI.IN_PLACE, last, MPI.MAX)
    end = int(last) + 1
    edges = np.searchsorted(id[order], [end * rank // comm.size for rank in range(comm.size + 1)])
    sent, received = np.diff(edges), np.empty(comm.size, dtype=edges.dtype)
    comm.Alltoall(sent, received)
    width = rows.shape[1]
    out = np.empty((received.sum(), width))
    comm.Alltoallv([rows, width * sent], [out, width * received])
    of_columns = {name: out[:, 8 + i].copy().view(column.dtype) for i, (name, column) in enumerate(columns.items())}
    number = out[:, 7].copy().view(np.int64)
    order = np.lexsort((of_columns.get("time", np.zeros(len(out))), number))
    found = Particles(out[:, :3], out[:, 3:6], out[:, 6], number, particles.species)
    return found.select(order), {name: column[order] for name, column in of_columns.items()}


def _open(path: Path, step: int, time: float, about: Provenance, causes: Sequence[str]) -> Hdf5Writer:
    path.parent.mkdir(parents=True, exist_ok=True)
    writer = Hdf5Writer(temporary(path))
    name = path.name.replace(f"{step:08d}", "%08T")
    texts = {
        "openPMD": "1.1.0",
        "basePath": "/data/%T/",
        "particlesPath": "particles/",
        "iterationEncoding": "fileBased",
        "iterationFormat": name if "%08T" in name else "%T",
        "software": "amrpic",
        "softwareVersion": about.version,
    }
    for key, text in texts.items():
        _set_text(writer.h5, key, text)
    writer.h5.attrs["openPMDextension"] = np.uint32(0)
    writer.h5["amrpic/scene"] = about.scene_text
    if causes:
        writer.h5["amrpic/causes"] = list(causes)
    writer.h5.create_group(f"/data/{step}/particles")
    writer.h5[f"/data/{step}"].attrs.update(time=time, dt=0.0, timeUnitSI=1.0)
    return writer


def _write_species(
    comm: MPI.Comm,
    writer: Hdf5Writer | None,
    group: str,
    species: Species,
    particles: Particles,
    own: Mapping[str, Array],
    time: float,
    window: Window,
    attempts: Attempts,
) -> None:
    """Write the particles of one species. Collective."""
    counts = comm.allgather(len(particles))
    total = comm.reduce(float(particles.weight.sum() * abs(species.charge)))
    if writer is not None:
        attempts.attempt(_describe, writer.h5, group, species, sum(counts), total, time, window, own)
    columns: Mapping[str, tuple[Array, tuple[int, ...]]] = {
        **{f"position/{axis}": (particles.position[:, i], LENGTH) for i, axis in enumerate(AXES)},
        **{f"momentum/{axis}": (particles.momentum[:, i], MOMENTUM) for i, axis in enumerate(AXES)},
        "weighting": (particles.weight, NONE),
        "weight": (particles.weight * abs(species.charge), CHARGE),
        "id": (particles.id.astype(np.uint64), NONE),
        **{name: (column, TIME if name == "time" else NONE) for name, column in own.items()},
    }
    for name, (rows, dimension) in columns.items():
        place = f"{group}/{name}"
        dataset = attempts.attempt(_create, writer.h5, place, rows, sum(counts), dimension) if writer else None
        collect(comm, range(comm.size), counts, rows, partial(attempts.attempt, _store, dataset))


def _describe(
    h5: h5py.File,
    group: str,
    species: Species,
    count: int,
    charge: float,
    time: float,
    window: Window,
    own: Mapping[str, Array],
) -> None:
    """Add what holds for all particles of a species, but what they have `own` columns for."""
    member = h5.create_group(group)
    _set_text(member, "speciesType", species.name or "other")
    member.attrs.update(numParticles=count, totalCharge=charge, chargeUnitSI=1.0)
    for axis, offset in zip(AXES, window.origin, strict=True):
        _constant(h5, f"{group}/positionOffset/{axis}", offset, count, LENGTH)
    for name, value, dimension in (
        ("charge", species.charge, CHARGE),
        ("mass", species.mass, MASS),
        ("time", time, TIME),
        ("particleStatus", ALIVE, NONE),
    ):
        if name not in own:
            _constant(h5, f"{group}/{name}", value, count, dimension)


def _constant(h5: h5py.File, name: str, value: float, count: int, dimension: tuple[int, ...]) -> None:
    component = h5.create_group(name)
    component.attrs.update(value=value, shape=np.array([count], dtype=np.uint64))
    _set_units(h5, name, dimension)


def _create(h5: h5py.File, name: str, rows: Rows, count: int, dimension: tuple[int, ...]) -> h5py.Dataset:
    dataset = h5.create_dataset(name, shape=(count,), dtype=rows.dtype)
    _set_units(h5, name, dimension)
    return dataset


def _store(dataset: h5py.Dataset, offset: int, piece: Array) -> None:
    dataset[offset : offset + len(piece)] = piece


def _set_units(h5: h5py.File, name: str, dimension: tuple[int, ...]) -> None:
    """Set what openPMD asks of a component and of its record, which are one for a scalar."""
    h5[name].attrs["unitSI"] = 1.0
    record = h5[name] if name.rpartition("/")[2] not in AXES else h5[name].parent
    # Momentum, charge and mass are those of a real particle; the rest does not know the difference.
    record.attrs.update(unitDimension=np.array(dimension, dtype=np.float64), timeOffset=0.0)
    record.attrs.update(macroWeighted=np.uint32(name.endswith(("/weighting", "/weight"))), weightingPower=1.0)


def _set_text(target: h5py.Group, key: str, text: str) -> None:
    target.attrs.create(key, np.bytes_(text.encode()))

"""Particles as openPMD files with the BeamPhysics extension: reading the share of a rank, and writing.

A file is openPMD 1.1 with, in addition, what BeamPhysics asks for. Momenta, times and places are written in SI units and
numbers of real particles as such (`weighting`, beside BeamPhysics's `weight` in C), so that they read back bit for bit.
"""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import Any

import h5py
import numpy as np
from mpi4py import MPI
from numpy.typing import NDArray
from pydantic import ValidationError

from ..errors import InputError, OutputError
from ..hierarchy import AXES
from ..particles import Particles
from ..species import Species, SpeciesTable
from ..units import SPECIES
from .collect import Attempts, Rows, collect, one_line
from .durable import Hdf5Writer, publish, remove, temporary
from .provenance import Provenance

ALIVE = 1  # of BeamPhysics's particleStatus

# Powers of length, mass, time, current, temperature, amount, luminous intensity.
LENGTH, TIME, NONE = (1, 0, 0, 0, 0, 0, 0), (0, 0, 1, 0, 0, 0, 0), (0, 0, 0, 0, 0, 0, 0)
MOMENTUM, MASS, CHARGE = (1, 1, -1, 0, 0, 0, 0), (0, 1, 0, 0, 0, 0, 0), (0, 0, 1, 1, 0, 0, 0)

Array = NDArray[Any]


# ---- reading ----


def read(
    file: str | Path,
    share: Callable[[int], tuple[int, int]],
    iteration: int | None = None,
    group: str | None = None,
    species: Species | None = None,
    first_id: int = 0,
) -> Particles:
    """Return those particles of a file whose rows `share(number of rows)` names, in order; ids count the rows.

    Only these rows are read. `iteration` and `group` must be told if the file holds several, `species` if it does not know its
    own. Raises InputError, naming what is wrong with the file.
    """
    path = Path(file)
    try:
        with h5py.File(path, "r", locking=False) as h5:
            source = _Source(path, _find(path, h5, iteration, group))
            return source.particles(share, species, first_id)
    except FileNotFoundError:
        raise InputError(
            f"particle file {path} does not exist; mend the path (relative ones start at the scene file)"
        ) from None
    except (OSError, KeyError, TypeError, ValueError) as reason:
        raise InputError(
            f"particle file {path} cannot be read as openPMD ({one_line(reason)}); write it anew, for instance by "
            "ParticleGroup.write of openpmd-beamphysics"
        ) from None


def _find(path: Path, h5: h5py.File, iteration: int | None, group: str | None) -> h5py.Group:
    """Return the group of particles that is meant."""
    base = _text(h5.attrs["basePath"])
    if "%T" in base:
        before, after = base.split("%T")
        base = before + _chosen(path, "iteration", list(h5[before]), iteration) + after
    particles = h5[base + _text(h5.attrs["particlesPath"])]
    if "position" in particles:
        return particles
    names = [name for name, member in particles.items() if "position" in member]
    return particles[_chosen(path, "group", names, group)]


def _chosen(path: Path, key: str, names: Sequence[str], wanted: str | int | None) -> str:
    found = [name for name in names if wanted is None or name == wanted or (name.isdigit() and int(name) == wanted)]
    if len(found) == 1:
        return found[0]
    what = f"no {key} {wanted}" if wanted is not None else f"{len(names)} {key}s"
    raise InputError(f"particle file {path} holds {what}; set {key} to one of {', '.join(names) or 'another file'}")


class _Source:
    """A group of particles in a file."""

    def __init__(self, path: Path, group: h5py.Group) -> None:
        self.path, self.group = path, group
        x = group["position/x"]
        self.count = int(np.atleast_1d(x.attrs["shape"])[0]) if "shape" in x.attrs else len(x)
        self.rows = slice(0, self.count)

    def particles(self, share: Callable[[int], tuple[int, int]], species: Species | None, first_id: int) -> Particles:
        start, stop = share(self.count)
        self.rows = slice(start, stop)
        species = species or self._species()
        weight = self._weight(species)
        position, momentum = (self._vector(name) for name in ("position", "momentum"))
        attributes = self.group["momentum"].attrs
        if attributes.get("macroWeighted", 0):
            momentum /= weight ** float(attributes.get("weightingPower", 1))
        for what, values in (("place", position), ("momentum", momentum)):
            finite = np.logical_and.reduce(np.isfinite(values))
            self._require(f"a {what} that is not finite", finite, "remove or mend it")
        self._require("no positive weight", weight > 0, "remove or mend it")
        self._require_alive_at_one_time()
        ids = np.arange(first_id + start, first_id + stop, dtype=np.int64)
        return Particles(position.T, momentum.T, weight, ids, SpeciesTable((species,)))

    def _values(self, name: str, rows: slice | None = None) -> Array:
        """Return this share of a component in SI units."""
        rows = rows or self.rows
        if name not in self.group:
            raise ValueError(f"{self.group.name}/{name} is missing")
        component = self.group[name]
        unit = float(component.attrs.get("unitSI", 1.0))
        if "value" in component.attrs:
            return np.full(rows.stop - rows.start, unit * float(component.attrs["value"]))
        values = np.asarray(component[rows], dtype=np.float64)
        if len(component) != self.count:
            raise ValueError(f"{name} has {len(component)} rows where position/x has {self.count}")
        return values if unit == 1.0 else unit * values

    def _with_offset(self, record: str, component: str = "") -> Array:
        values, offset = self._values(record + component), f"{record}Offset"
        return values + self._values(offset + component) if offset in self.group else values

    def _vector(self, record: str) -> Array:
        return np.stack([self._with_offset(record, f"/{axis}") for axis in AXES])

    def _weight(self, species: Species) -> Array:
        """Return real particles per macroparticle."""
        if "weighting" in self.group:
            return self._values("weighting")
        if species.charge == 0:
            raise InputError(
                f"particle file {self.path} tells weights as charges, but its species has none; give it weighting"
            )
        if "weight" in self.group:
            return np.abs(self._values("weight") / species.charge)
        attributes = self.group.attrs
        total = float(np.ravel(attributes["totalCharge"] * attributes.get("chargeUnitSI", 1.0))[0])
        return np.full(self.rows.stop - self.rows.start, abs(total / self.count / species.charge))

    def _species(self) -> Species:
        name = _text(self.group.attrs.get("speciesType", self.group.name.rpartition("/")[2]))
        constants = {}
        for key in ("charge", "mass"):
            attributes = self.group[key].attrs if key in self.group else {}
            if "value" in attributes and not attributes.get("macroWeighted", 0):
                constants[key] = float(attributes["value"]) * float(attributes.get("unitSI", 1.0))
        try:
            if len(constants) == 2:
                return Species(name=name, **constants)
            return Species.model_validate(name)
        except ValidationError:
            raise InputError(
                f'particle file {self.path} holds the species "{name}", whose charge and mass are not known; '
                f"give the bunch a species, such as one of {', '.join(SPECIES)}"
            ) from None

    def _require_alive_at_one_time(self) -> None:
        if "particleStatus" in self.group:
            alive = self._values("particleStatus") == ALIVE
            self._require("the status of a lost particle", alive, "write the file with those alone that are alive")
        if "time" in self.group and self.count:
            first = self._values("time", slice(0, 1))
            same = self._with_offset("time") == self._with_first_offset(first)
            self._require(
                "another time than the first", same, "drift all to one time, as ParticleGroup.drift_to_t does"
            )

    def _with_first_offset(self, first: Array) -> Array:
        return first + self._values("timeOffset", slice(0, 1)) if "timeOffset" in self.group else first

    def _require(self, what: str, holds: Array, remedy: str) -> None:
        if not holds.all():
            row = self.rows.start + int(np.argmin(holds))
            raise InputError(f"particle file {self.path} has {what} in row {row} of {self.count}; {remedy}")


def _text(value: Any) -> str:
    return value.decode() if isinstance(value, bytes) else str(value)


# ---- writing ----


def path_of(directory: Path, step: int) -> Path:
    """Return where the particles of a step lie in a run's directory."""
    return Path(directory) / f"particles_{step:08d}.h5"


def write(comm: MPI.Comm, path: Path, particles: Particles, step: int, time: float, about: Provenance) -> None:
    """Write all particles into the file `path`, which is there whole and synced on return, or unchanged. Collective.

    A group for each species holds its particles in the order of their ids, which is the same on any number of ranks. Rank 0
    writes what it receives in small pieces. Raises OutputError, alike on all ranks.
    """
    path = Path(path)
    attempts = Attempts(f"cannot write particles {path}", "free some space or choose another output folder")
    ordered = _by_id(comm, particles)
    writer = attempts.attempt(_open, path, step, time, about) if comm.rank == 0 else None
    for kind, (name, species) in enumerate(zip(ordered.species.names, ordered.species.kinds, strict=True)):
        group = f"/data/{step}/particles/{name}"
        _write_species(comm, writer, group, species, ordered.select(ordered.kind == kind), time, attempts)
    if writer is not None:
        attempts.always(writer.close)
    if comm.rank == 0:
        attempts.attempt(publish, path)
        with contextlib.suppress(OSError):
            remove(temporary(path))  # it is gone already unless an attempt failed
    attempts.settle(comm, OutputError)


def _by_id(comm: MPI.Comm, particles: Particles) -> Particles:
    """Return the particles with this rank's equal share of the ids, in their order. Collective."""
    position, momentum, weight, id = particles.arrays
    order = np.argsort(id)
    rows = np.column_stack([position, momentum, weight, id.view(np.float64)])[order]
    end = comm.allreduce(int(id.max(initial=-1)), MPI.MAX) + 1
    edges = np.searchsorted(id[order], [end * rank // comm.size for rank in range(comm.size + 1)])
    sent, received = np.diff(edges), np.empty(comm.size, dtype=edges.dtype)
    comm.Alltoall(sent, received)
    width = rows.shape[1]
    out = np.empty((received.sum(), width))
    comm.Alltoallv([rows, width * sent], [out, width * received])
    out = out[np.argsort(out[:, 7].copy().view(np.int64))]
    return Particles(out[:, :3], out[:, 3:6], out[:, 6], out[:, 7].copy().view(np.int64), particles.species)


def _open(path: Path, step: int, time: float, about: Provenance) -> Hdf5Writer:
    path.parent.mkdir(parents=True, exist_ok=True)
    writer = Hdf5Writer(temporary(path))
    name = path.name.replace(f"{step:08d}", "%08T")
    texts = {
        "openPMD": "1.1.0",
        "basePath": "/data/%T/",
        "particlesPath": "particles/",
        "meshesPath": "fields/",
        "iterationEncoding": "fileBased",
        "iterationFormat": name if "%08T" in name else "%T",
        "software": "amrpic",
        "softwareVersion": about.version,
    }
    for key, text in texts.items():
        _set_text(writer.h5, key, text)
    writer.h5.attrs["openPMDextension"] = np.uint32(0)
    writer.h5["amrpic/scene"] = about.scene_text
    writer.h5.create_group(f"/data/{step}/particles")
    writer.h5[f"/data/{step}"].attrs.update(time=time, dt=0.0, timeUnitSI=1.0)
    return writer


def _write_species(
    comm: MPI.Comm,
    writer: Hdf5Writer | None,
    group: str,
    species: Species,
    particles: Particles,
    time: float,
    attempts: Attempts,
) -> None:
    """Write the particles of one species. Collective."""
    counts = comm.allgather(len(particles))
    total = comm.reduce(float(particles.weight.sum() * abs(species.charge)))
    if writer is not None:
        attempts.attempt(_describe, writer.h5, group, species, sum(counts), total, time)
    columns: Mapping[str, tuple[Array, tuple[int, ...]]] = {
        **{f"position/{axis}": (particles.position[:, i], LENGTH) for i, axis in enumerate(AXES)},
        **{f"momentum/{axis}": (particles.momentum[:, i], MOMENTUM) for i, axis in enumerate(AXES)},
        "weighting": (particles.weight, NONE),
        "weight": (particles.weight * abs(species.charge), CHARGE),
        "id": (particles.id.astype(np.uint64), NONE),
    }
    for name, (rows, dimension) in columns.items():
        place = f"{group}/{name}"
        dataset = attempts.attempt(_create, writer.h5, place, rows, sum(counts), dimension) if writer else None
        collect(comm, range(comm.size), counts, rows, partial(attempts.attempt, _store, dataset))


def _describe(h5: h5py.File, group: str, species: Species, count: int, charge: float, time: float) -> None:
    """Add what holds for all particles of a species."""
    member = h5.create_group(group)
    _set_text(member, "speciesType", species.name or "other")
    member.attrs.update(numParticles=count, totalCharge=charge, chargeUnitSI=1.0)
    for axis in AXES:
        _constant(h5, f"{group}/positionOffset/{axis}", 0.0, count, LENGTH)
    for name, value, dimension in (
        ("charge", species.charge, CHARGE),
        ("mass", species.mass, MASS),
        ("time", time, TIME),
        ("particleStatus", ALIVE, NONE),
    ):
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

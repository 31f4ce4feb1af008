"""Reading particles from openPMD files, each rank its share: those of `openpmd_writer`, of BeamPhysics and of other codes."""

from __future__ import annotations

import contextlib
import json
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import h5py
import numpy as np
from numpy.typing import NDArray

from ..errors import InputError, ParticleError
from ..mesh.domain import AXES, Domain
from ..particles.particles import Particles
from ..particles.species import SPECIES, Species, SpeciesTable
from .openpmd_files import base, chosen, dimension_text, opened, text
from .openpmd_writer import ALIVE, CATHODE, CHARGE, DEAD, LENGTH, MASS, MOMENTUM, NONE, TIME

Array = NDArray[Any]
DIMENSIONS = {  # of the records that are read, and their unit
    "position": (LENGTH, "m"),
    "positionOffset": (LENGTH, "m"),
    "momentum": (MOMENTUM, "kg m/s"),
    "momentumOffset": (MOMENTUM, "kg m/s"),
    "weighting": (NONE, "a number"),
    "weight": (CHARGE, "C"),
    "charge": (CHARGE, "C"),
    "mass": (MASS, "kg"),
    "time": (TIME, "s"),
    "timeOffset": (TIME, "s"),
}


def read(
    file: str | Path,
    share: Callable[[int], tuple[int, int]],
    iteration: int | None = None,
    group: str | None = None,
    species: Species | None = None,
    first_id: int = 0,
) -> Particles:
    """Return those particles of a file whose rows `share(number of rows)` names, in order; ids count the rows.

    Only these rows are read. `iteration` and `group` must be given if the file holds several, `species` if it does not know its
    own. A weight of zero is that of a test particle, unless momenta are those of macroparticles. Raises InputError, naming
    what is wrong with the file.
    """
    path = Path(file)
    with _opened(path) as h5:
        source = _Source(path, _find(path, h5, iteration, group))
        return source.particles(share, species, first_id)


def groups(file: str | Path) -> list[str]:
    """Return the names of the groups of particles in a file of one iteration; "" of a group without one. Raises InputError."""
    with _opened(Path(file)) as h5:
        particles = _particles(Path(file), h5, None)
        return [""] if "position" in particles else [name for name, member in particles.items() if "position" in member]


def births(file: str | Path, iteration: int | None, group: str | None, species: Species) -> tuple[Particles, Array]:
    """Return the particles in a file, each at its own time, and these times in s. Raises InputError."""
    path = Path(file)
    with _opened(path) as h5:
        return _Source(path, _find(path, h5, iteration, group)).births(species)


def require_species(path: Path, names: set[str], species: Species) -> None:
    """Raise InputError if a file says that some of its particles are of another species than their source."""
    others = sorted(name for name in names if name in SPECIES and name != species.name)
    if others and species.name in SPECIES:
        raise InputError(
            f"particle file {path} has {others[0]}s, but its source {species.name}s; set the source's species, and write each "
            "species into a file of its own"
        )


@dataclass(frozen=True)
class LossRecord:
    """The lost particles of a species, as `openpmd_writer` writes them."""

    species: str
    id: Array  # (n,) int64
    position: Array  # (n, 3) m, where they were lost
    momentum: Array  # (n, 3) kg m/s
    weight: Array  # (n,) real particles
    time: Array  # (n,) s
    cause: Array  # (n,) names of apertures or faces


def records(file: str | Path) -> list[LossRecord]:
    """Return the losses that a run wrote, by species. Raises InputError."""
    path, out = Path(file), []
    with _opened(path) as h5:
        causes = np.array(h5["amrpic/causes"].asstr()[:])
        for name, group in _particles(path, h5, None).items():
            source = _Source(path, group)
            columns = {key: source._values(key) for key in ("weighting", "time", "particleStatus")}
            cause = causes[columns["particleStatus"].astype(int) - DEAD]
            position, momentum = (source._vector(key).T for key in ("position", "momentum"))
            id = group["id"][:].astype(np.int64)
            out.append(LossRecord(name, id, position, momentum, columns["weighting"], columns["time"], cause))
    return out


def when(file: str | Path, iteration: int | None = None, group: str | None = None) -> tuple[int, float | None]:
    """Return number and time in s of an iteration, the time None where the file does not know. Raises InputError.

    It is that of the particles of a group if they have one, else that of the iteration.
    """
    path = Path(file)
    with _opened(path) as h5:
        where = base(h5, f"particle file {path}", iteration)
        attributes, particles = h5[where].attrs, _particles(path, h5, iteration)
        number = where.rstrip("/").rpartition("/")[2]
        step = int(number) if number.isdigit() else 0
        members = (
            [particles]
            if "position" in particles
            else [member for member in particles.values() if "position" in member]
        )
        of_group = [member for member in members if group is None or member.name.rpartition("/")[2] == group] or members
        time = _Source(path, of_group[0]).time() if of_group else None
        if time is None and "time" in attributes:
            time = float(attributes["time"]) * float(attributes.get("timeUnitSI", 1.0))
        if time is not None and not np.isfinite(time):
            raise InputError(f"particle file {path} is of the time {time} s; write it anew with a finite one")
        return step, time


def domain_of(file: str | Path) -> Domain | None:
    """Return the domain of the run that wrote a file, where it is in the laboratory then. Raises InputError.

    None of another program's file, if it may have turned, or of particles of several times in a domain that moves.
    """
    path = Path(file)
    with _opened(path) as h5:
        text = h5.get("amrpic/scene")
        scene = json.loads(text.asstr()[()]) if isinstance(text, h5py.Dataset) else {}
        domain, origin = scene.get("domain"), np.zeros(3)
        if domain and scene.get("motion", {}).get("window", "none") != "none":
            group = next(iter(_particles(path, h5, None).values()), None)
            turns = all(face == "open" for faces in domain["boundary"].values() for face in faces)
            if turns or group is None or isinstance(group.get("time"), h5py.Dataset):
                return None
            origin = np.array([group[f"positionOffset/{axis}"].attrs["value"] for axis in AXES])
    if not domain:
        return None
    return Domain(
        tuple((domain["lower"] + origin).tolist()),
        tuple((domain["upper"] + origin).tolist()),
        domain["cells"],
        domain["boundary"],
    )


def _opened(path: Path) -> contextlib.AbstractContextManager[h5py.File]:
    """Open a file for a while; what goes wrong becomes InputError."""
    return opened(path, "particle file", "write it anew, for instance by ParticleGroup.write of openpmd-beamphysics")


def _find(path: Path, h5: h5py.File, iteration: int | None, group: str | None) -> h5py.Group:
    """Return the group of particles that is meant."""
    particles = _particles(path, h5, iteration)
    if "position" in particles:
        return particles
    names = [name for name, member in particles.items() if "position" in member]
    return particles[chosen(f"particle file {path}", "group", names, group)]


def _particles(path: Path, h5: h5py.File, iteration: int | None) -> h5py.Group:
    """Return what holds the groups of particles, or is the only one."""
    return h5[base(h5, f"particle file {path}", iteration) + text(h5.attrs["particlesPath"])]


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
        self._require_alive_at_one_time()
        return self._whole(species, first_id)

    def births(self, species: Species) -> tuple[Particles, Array]:
        """Return all particles, and their times of birth in s."""
        require_species(self.path, {text(self.group.attrs.get("speciesType", ""))}, species)
        if "particleStatus" in self.group:
            born = np.isin(self._values("particleStatus"), (CATHODE, ALIVE))
            self._require("the status of a lost particle", born, "write the file with those alone that are alive")
        time = self._with_offset("time") if "time" in self.group else np.zeros(self.count)
        self._require("a time that is not finite", np.isfinite(time), "remove or correct it")
        return self._whole(species, 0), time

    def _whole(self, species: Species | None, first_id: int) -> Particles:
        """Return this share of the particles."""
        start, stop = self.rows.start, self.rows.stop
        self._require_dimensions()
        species = species or self._species()
        weight = self._weight(species)
        position, momentum = (self._vector(name) for name in ("position", "momentum"))
        for what, values in (("place", position), ("momentum", momentum)):
            finite = np.logical_and.reduce(np.isfinite(values))
            self._require(f"a {what} that is not finite", finite, "remove or correct it")
        self._require("a weight that is negative or not finite", (weight >= 0) & (weight < np.inf), "correct it")
        attributes = self.group["momentum"].attrs
        if attributes.get("macroWeighted", 0):
            self._require(
                "a weight of zero, by which the momentum of a macroparticle is divided",
                weight > 0,
                "remove it, or write momenta per real particle",
            )
            momentum /= weight ** float(attributes.get("weightingPower", 1))
        ids = np.arange(first_id + start, first_id + stop, dtype=np.int64)
        return Particles(position.T, momentum.T, weight, ids, SpeciesTable((species,)))

    def time(self) -> float | None:
        """Return the time of the first particle, s; None without particles or times."""
        if "time" not in self.group or not self.count:
            return None
        return float(self._with_first_offset(self._values("time", slice(0, 1)))[0])

    def _require_dimensions(self) -> None:
        """Raise InputError for a record that states another dimension than that of what it is read as."""
        for record, (dimension, unit) in DIMENSIONS.items():
            if record not in self.group:
                continue
            member = self.group[record]
            axes = [member[axis] for axis in AXES if axis in member] if isinstance(member, h5py.Group) else []
            for of_axis in (member, *axes):
                actual = np.ravel(of_axis.attrs.get("unitDimension", dimension))
                if not np.array_equal(actual, dimension):
                    raise InputError(
                        f"particle file {self.path}: record {of_axis.name} has the dimension {dimension_text(actual)}, where "
                        f"that of {unit} is expected; convert its values, and write unitDimension and unitSI of these"
                    )

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
                f"particle file {self.path} gives weights as charges, but its species has none; give it weighting"
            )
        if "weight" in self.group:
            return np.abs(self._values("weight") / species.charge)
        attributes = self.group.attrs
        total = float(np.ravel(attributes["totalCharge"] * attributes.get("chargeUnitSI", 1.0))[0])
        return np.full(self.rows.stop - self.rows.start, abs(total / self.count / species.charge))

    def _species(self) -> Species:
        name = text(self.group.attrs.get("speciesType", self.group.name.rpartition("/")[2]))
        constants = {}
        for key in ("charge", "mass"):
            attributes = self.group[key].attrs if key in self.group else {}
            if "value" in attributes and not attributes.get("macroWeighted", 0):
                constants[key] = float(attributes["value"]) * float(attributes.get("unitSI", 1.0))
        try:
            if len(constants) == 2:
                return Species(name=name, **constants)
            return SPECIES[name]
        except (KeyError, ParticleError):
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

"""What sources give in a step: which particles, with which weights, where, how fast, and when.

A source numbers its particles in the order of their births, from its own first id on. Places, momenta and times of birth follow
from seed and id, so they are the same on any ranks and after a restart.
"""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import Generic, TypeVar

import numpy as np

from .. import _native
from ..conductors.patches import Patches
from ..errors import InputError
from ..io.birth_files import Births, read
from ..mesh.columns import Columns
from ..mesh.periods import nearest, wrapped
from ..mesh.spot_on_wall import SpotOnWall
from ..mpi import MPI
from ..parallel import call_together, from_rank_0, share
from ..particles.particles import Particles
from ..particles.species import SpeciesTable
from ..particles.uniform_numbers import draw
from ..scene.injection import AnySource, FunctionSource
from ..scene.scene import Scene
from ..scene.sources import IDS, FileSource, GivenSource, OfSpecies, Source, WallSource, first_ids
from ..units import SPEED_OF_LIGHT, VACUUM_PERMITTIVITY
from .metal_layer import MetalLayer
from .wall_layer import WallLayer

BIRTH = 4  # stream of the counter-based generator
EVENLY = np.array(
    [0.7548776662466927, 0.5698402909980532]
)  # steps of an even sequence in a square: 1/g, 1/g², g³ = g + 1
Kind = TypeVar("Kind", bound=OfSpecies)
SurfaceKind = TypeVar("SurfaceKind", bound=Source)


@dataclass(frozen=True)
class Span:
    """The time of a step, and how many numbers of a source are used up before it."""

    start: float  # s
    stop: float  # s
    used: int
    layer: WallLayer | MetalLayer | None = None  # at the source's face or electrode, if it is a wall or on one
    added: Callable[[np.ndarray], np.ndarray] | None = None  # E (n, 3) in V/m at places (n, 3), beside that of the mesh


class Emitter(ABC, Generic[Kind]):
    """One source of a scene."""

    def __init__(self, source: Kind, first: int) -> None:
        self.source, self.first = source, first

    @abstractmethod
    def numbers(self, span: Span) -> range:
        """Return the numbers of the particles that may be born in a step; what is not born in it is left out later."""

    @abstractmethod
    def times(self, number: np.ndarray, span: Span) -> np.ndarray:
        """Return when particles are born, s."""

    @abstractmethod
    def newborn(self, comm: MPI.Comm, span: Span, species: SpeciesTable) -> Particles:
        """Return this rank's share of what is born in a step, in the laboratory and at the places of birth. Collective."""

    @abstractmethod
    def largest_energy(self) -> float:
        """Return a kinetic energy in J that particles are born with, about the largest."""

    @property
    def stop_time(self) -> float:
        """When the last particles are born, s, as far as that is known before."""
        return self.source.stop_time

    def expected(self, start: float, stop: float, dt: float) -> int | None:
        """Return how many macroparticles are born between two times in s, by steps of `dt` s; None if no one knows before."""
        return None

    def before(self, start: float) -> tuple[float, float]:
        """Return when the first are born, s, and which part of all charge is born before a time in s; 0 if it has no end."""
        return start, 0.0

    @property
    def extent(self) -> tuple[np.ndarray, np.ndarray] | None:
        """Corners (2,) in m, along its axes, of the surface that emits; None of a source without one."""
        return None

    def part(self, position: np.ndarray, parts: int) -> np.ndarray:
        """Return in which part (n,) of the surface, cut into so many along either axis, places (n, 3) in the laboratory lie."""
        return np.zeros(len(position), dtype=np.int64)

    def own(self, ids: np.ndarray) -> np.ndarray:
        """Return which ids are those of this source."""
        return ids // IDS == self.first // IDS


class OfSurface(Emitter[SurfaceKind]):
    """A source on a surface, whose particles are drawn."""

    def __init__(self, source: SurfaceKind, first: int, scene: Scene) -> None:
        super().__init__(source, first)
        self._seed, self._domain = scene.seed, scene.domain.value
        self._origin, self._axes = source.frame(self._domain.lower, self._domain.upper)
        self._on_wall: SpotOnWall | None = None

    def largest_energy(self) -> float:
        return self.source.emitted.largest_energy()

    @property
    def extent(self) -> tuple[np.ndarray, np.ndarray] | None:
        if self.source.electrode is not None:
            return None
        if self.source.reach is not None:
            return self.source.reach
        lower, upper = (np.array(corner)[self._across] for corner in (self._domain.lower, self._domain.upper))
        return lower, upper

    def part(self, position: np.ndarray, parts: int) -> np.ndarray:
        if self.extent is None:
            return super().part(position, parts)
        lower, upper = self.extent
        share = (self._images(self._axes[:2] @ (position - self._origin).T).T - lower) / (upper - lower)
        return np.clip((share * parts).astype(np.int64), 0, parts - 1) @ [parts, 1]

    def draws(self, first: int, last: int) -> np.ndarray:
        """Return numbers in (0, 1) for places and momenta of particles, (7, n)."""
        return draw("random", self._seed, self.first, first, last)

    @abstractmethod
    def weights(self, number: np.ndarray, span: Span) -> np.ndarray:
        """Return the weights of particles."""

    def newborn(self, comm: MPI.Comm, span: Span, species: SpeciesTable) -> Particles:
        all_ = self.numbers(span)
        first, last = (all_.start + n for n in share(comm, len(all_)))
        number, u = np.arange(first, last), self.draws(first, last)
        time = self.times(number, span)
        places, (normal, *across) = self.source.born(u)
        momentum = np.stack([*across, normal], axis=1)
        if self.source.electrode is None:
            places = self.places(number, places, u[:2], span)
            position = self._origin + places.T @ self._axes[:2]
            momentum = momentum @ self._axes
        else:
            position, normals = self.places_on_metal(number, u[:2], span)
            momentum = np.einsum("ni,nij->nj", momentum, axes_of(normals))
        weight = self.weights(number, span)
        newborn = Particles(position, momentum, weight, number + self.first, species)
        born = (span.start <= time) & (time < span.stop) & (weight > 0)
        return self.limited(newborn.select(np.flatnonzero(born)), comm, span)

    def limited(self, newborn: Particles, comm: MPI.Comm, span: Span) -> Particles:
        """Return the particles of a step with no more weight than the field at the wall takes. Collective."""
        return newborn

    def places(self, number: np.ndarray, of_source: np.ndarray | None, u: np.ndarray, span: Span) -> np.ndarray:
        """Return places (2, n) of particles on the surface, m: those of the source, if it says where."""
        assert self.extent is not None
        lower, upper = self.extent
        return lower[:, None] + (upper - lower)[:, None] * u if of_source is None else of_source

    def places_on_metal(self, number: np.ndarray, u: np.ndarray, span: Span) -> tuple[np.ndarray, np.ndarray]:
        """Return places (n, 3) of particles on an electrode, m, and the normals there."""
        return _metal(span).patches.anywhere(u)

    def pull(self, span: Span) -> np.ndarray:
        """Return how the field pulls particles off the part of each face of the wall that emits, V/m; negative: it pushes."""
        assert span.layer is not None
        field, sign = span.layer.at_wall, np.sign(self.source.species.charge)
        if isinstance(span.layer, MetalLayer):
            patches = span.layer.patches
            added = 0.0 if span.added is None else (span.added(patches.centre) * patches.normal).sum(axis=1)
            return (field + added) * sign
        columns = span.layer.columns
        if span.added is not None:
            field = field + span.added(columns.centre) @ self._axes[2]
        return self.on_wall(columns).inside(field * sign)

    def on_wall(self, columns: Columns) -> SpotOnWall:
        """Return which part of each face of the wall emits."""
        if self._on_wall is None or self._on_wall.columns is not columns:
            self._on_wall = SpotOnWall(columns, None if self.source.spot is None else self._in_spot)
        return self._on_wall

    def _in_spot(self, places: np.ndarray) -> np.ndarray:
        """Return which places (2, n) on a face, or images of them, lie in the spot."""
        assert self.source.spot is not None
        return self.source.spot.holds(self._images(places))

    def _images(self, places: np.ndarray) -> np.ndarray:
        """Return the images of places (2, n) on a face that are nearest to the middle of what emits."""
        if self.source.face_number is None or self.extent is None:
            return places
        along = zip(np.mean(self.extent, axis=0), places, map(self._domain.period, self._across), strict=True)
        return np.array([middle + nearest(x - middle, period) for middle, x, period in along])

    @property
    def _across(self) -> list[int]:
        """The axes of the source's face."""
        assert self.source.face_number is not None
        return [axis for axis in range(3) if axis != self.source.face_number // 2]

    def _uniform(self, number: np.ndarray) -> np.ndarray:
        """Return a number in (0, 1) for the time of birth of each particle."""
        out = np.empty((4, len(number)))
        _native.uniforms(self._seed, BIRTH, 0, number + self.first, out)
        return out[0]


class OfGivenCharge(OfSurface[GivenSource]):
    """Charge that is given in time."""

    def expected(self, start: float, stop: float, dt: float) -> int:
        return self.source.expected(start, stop, dt)

    def before(self, start: float) -> tuple[float, float]:
        total = self.source.total
        return self.source.pulse.start, self.source.charge_until(start) / total if math.isfinite(total) else 0.0

    def draws(self, first: int, last: int) -> np.ndarray:
        return draw(self.source.sampling, self._seed, self.first, first, last)

    def limited(self, newborn: Particles, comm: MPI.Comm, span: Span) -> Particles:
        if not self.source.is_limited or span.layer is None:
            return newborn
        if isinstance(span.layer, MetalLayer):
            column, area = span.layer.patches.nearest(newborn.position), span.layer.patches.area
            charge = newborn.weight * abs(self.source.species.charge)
        else:
            columns = span.layer.columns  # the window is at rest where there is a layer
            lower, upper = np.array(self._domain.lower), np.array(self._domain.upper)
            places = wrapped(newborn.position, lower, upper, self._domain.periodic)
            (column, _), area = columns.find(places), self.on_wall(columns).area
            inside = ((places >= lower) & (places <= upper)).all(axis=1)  # others are not born
            charge = inside * newborn.weight * abs(self.source.species.charge)
        supplied = comm.allreduce(np.bincount(column, charge, len(area)))
        most = VACUUM_PERMITTIVITY * np.maximum(self.pull(span), 0.0) * area
        fraction = np.divide(most, supplied, out=np.ones_like(most), where=supplied > most)[column]
        return newborn.with_weight(newborn.weight * fraction).select(np.flatnonzero(fraction > 0))


class OfOneCharge(OfGivenCharge):
    """Charge that is given in time, by macroparticles of one charge: one is born in each part of the pulse with this charge.

    The last one has what is left, where the charge of the pulse is no multiple of it.
    """

    def numbers(self, span: Span) -> range:
        first, last = (int(self.source.charge_until(time) / self._unit) for time in (span.start, span.stop))
        # rounding may move a part of the pulse over the end of a step
        return range(max(first - 1, 0), math.ceil(min(last + 2, self.source.parts)))

    def times(self, number: np.ndarray, span: Span) -> np.ndarray:
        return self.source.time_of(self._unit * (number + self._filled(number) * self._uniform(number)))

    def weights(self, number: np.ndarray, span: Span) -> np.ndarray:
        return self._filled(number) * (self._unit / self.source.species.charge)

    def _filled(self, number: np.ndarray) -> np.ndarray:
        """Return how much of a macroparticle there is in parts of the pulse (n,): 1 but in the last one."""
        return np.clip(self.source.parts - number, 0.0, 1.0)

    @property
    def _unit(self) -> float:
        assert self.source.unit_charge is not None
        return self.source.unit_charge


class PerStep(OfGivenCharge):
    """Charge that is given in time, by so many macroparticles in each step: one is born in each of as many parts of it."""

    def numbers(self, span: Span) -> range:
        begin, end = self._living(span)
        return range(span.used, span.used + self._most * (begin < end))

    def times(self, number: np.ndarray, span: Span) -> np.ndarray:
        begin, end = self._living(span)
        return begin + (end - begin) * (number - span.used + self._uniform(number)) / self._most

    def weights(self, number: np.ndarray, span: Span) -> np.ndarray:
        begin, end = self._living(span)
        edges = begin + (end - begin) * np.arange(self._most + 1) / self._most
        charge = np.diff([self.source.charge_until(time) for time in edges])
        return charge[number - span.used] / self.source.species.charge

    @property
    def _most(self) -> int:
        assert self.source.per_step is not None
        return self.source.per_step

    def _living(self, span: Span) -> tuple[float, float]:
        """Return the part of a step in which there is any charge, s."""
        return max(span.start, self.source.pulse.start), min(span.stop, self.source.stop_time)


class OfWall(OfSurface[WallSource]):
    """A wall whose field decides what it gives: so many macroparticles in each step from each face of a cell, even in both."""

    def numbers(self, span: Span) -> range:
        begin, end = self._living(span)
        return range(span.used, span.used + self.source.per_face * len(self._emitting(span)) * (begin < end))

    def times(self, number: np.ndarray, span: Span) -> np.ndarray:
        begin, end = self._living(span)
        part = (number - span.used) % self.source.per_face + self._uniform(number)
        return begin + (end - begin) * part / self.source.per_face

    def places(self, number: np.ndarray, of_source: np.ndarray | None, u: np.ndarray, span: Span) -> np.ndarray:
        """Those of a step are the same parts of each face: clouds of even charge then leave it even, without noise."""
        parts = self._parts(number, span)
        spot = self._spot(span)
        assert isinstance(spot, SpotOnWall)
        return spot.places(self._column(number, span), parts)

    def places_on_metal(self, number: np.ndarray, u: np.ndarray, span: Span) -> tuple[np.ndarray, np.ndarray]:
        return _metal(span).patches.places(self._column(number, span), self._parts(number, span))

    def _parts(self, number: np.ndarray, span: Span) -> np.ndarray:
        """Return numbers (2, n) in (0, 1) for places on faces, even in those of a face."""
        start = self.draws(span.used, span.used + 1)[:2]
        return np.asarray((start + EVENLY[:, None] * ((number - span.used) % self.source.per_face)) % 1.0)

    def weights(self, number: np.ndarray, span: Span) -> np.ndarray:
        column = self._column(number, span)
        charge = self.surface_charge(column, span) * self._spot(span).area[column]
        return charge / (abs(self.source.species.charge) * self.source.per_face)

    def surface_charge(self, column: np.ndarray, span: Span) -> np.ndarray:
        """Return what is born in a step on the faces of some columns, C/m² without sign."""
        pull = self.pull(span)[column]
        begin, end = self._living(span)
        supplied = self.source.current_density(pull) * (end - begin)
        most = VACUUM_PERMITTIVITY * np.maximum(pull, 0.0)
        return np.minimum(supplied, most) if self.source.is_limited else supplied

    def _spot(self, span: Span) -> SpotOnWall | Patches:
        assert span.layer is not None
        if isinstance(span.layer, MetalLayer):
            return span.layer.patches
        return self.on_wall(span.layer.columns)

    def _emitting(self, span: Span) -> np.ndarray:
        """Return the columns with a face that reaches into the spot; none where the window has left the wall."""
        return np.zeros(0, dtype=np.int64) if span.layer is None else self._spot(span).emitting

    def _column(self, number: np.ndarray, span: Span) -> np.ndarray:
        return self._emitting(span)[(number - span.used) // self.source.per_face]

    def _living(self, span: Span) -> tuple[float, float]:
        """Return the part of a step in which the wall emits, s."""
        return max(span.start, self.source.start), min(span.stop, self.source.stop_time)


def _metal(span: Span) -> MetalLayer:
    assert isinstance(span.layer, MetalLayer)
    return span.layer


def axes_of(normals: np.ndarray) -> np.ndarray:
    """Return unit vectors (n, 3, 3), two across each normal (n, 3) and it, as rows."""
    least = np.eye(3)[np.abs(normals).argmin(axis=1)]
    x = np.cross(normals, least)
    x /= np.linalg.norm(x, axis=1)[:, None]
    return np.stack([x, np.cross(normals, x), normals], axis=1)


class OfFile(Emitter[FileSource]):
    """Particles that are born as a file says, in the order of their births."""

    def __init__(self, source: FileSource, first: int, births: Births) -> None:
        super().__init__(source, first)
        self._births = births
        self._time = births.time + source.delay

    @property
    def stop_time(self) -> float:
        return float(self._time.max(initial=super().stop_time))

    def expected(self, start: float, stop: float, dt: float) -> int:
        return len(self.numbers(Span(start, stop, 0)))

    def before(self, start: float) -> tuple[float, float]:
        weight = self._births.weight
        return float(self._time.min(initial=start)), float(weight[self._time < start].sum() / (weight.sum() or 1.0))

    def numbers(self, span: Span) -> range:
        return range(*np.searchsorted(self._time, (span.start, span.stop)).tolist())

    def times(self, number: np.ndarray, span: Span) -> np.ndarray:
        return self._time[number]

    def largest_energy(self) -> float:
        most, mass = np.linalg.norm(self._births.momentum, axis=1).max(initial=0.0), self.source.species.mass
        return float(np.hypot(mass * SPEED_OF_LIGHT, most) - mass * SPEED_OF_LIGHT) * SPEED_OF_LIGHT

    def newborn(self, comm: MPI.Comm, span: Span, species: SpeciesTable) -> Particles:
        born = self.numbers(span)
        rows = slice(*(born.start + n for n in share(comm, len(born))))
        ids = self.first + np.arange(rows.start, rows.stop, dtype=np.int64)
        position = self._births.position[rows] + self.source.shift
        return Particles(position, self._births.momentum[rows], self._births.weight[rows], ids, species)


class OfFunction(Emitter[FunctionSource]):
    """Particles that are born as a Python function says."""

    def __init__(self, source: FunctionSource, first: int) -> None:
        super().__init__(source, first)
        self._births = Births(np.zeros(0), np.zeros((0, 3)), np.zeros((0, 3)), np.zeros(0))  # those of the latest step

    def numbers(self, span: Span) -> range:
        return range(span.used, span.used + len(self._births.time))

    def times(self, number: np.ndarray, span: Span) -> np.ndarray:
        return self._births.time[number - span.used]

    def largest_energy(self) -> float:
        return 0.0

    def newborn(self, comm: MPI.Comm, span: Span, species: SpeciesTable) -> Particles:
        what = f"the function of {self.source.name or 'a source'} failed"
        self._births = call_together(comm, lambda: self._called(span), InputError, what)
        rows = slice(*share(comm, len(self._births.time)))
        ids = self.first + span.used + np.arange(rows.start, rows.stop, dtype=np.int64)
        position, momentum, weight = (
            np.ascontiguousarray(of[rows]) for of in (self._births.position, self._births.momentum, self._births.weight)
        )
        return Particles(position, momentum, weight, ids, species)

    def _called(self, span: Span) -> Births:
        """Return what the function gives for a step. Raises ValueError for arrays of other shapes, or times outside of it."""
        time, position, momentum, weight = (
            np.asarray(of, dtype=float) for of in self.source.function(span.start, span.stop)
        )
        n = len(time)
        if (time.shape, position.shape, momentum.shape, weight.shape) != ((n,), (n, 3), (n, 3), (n,)):
            raise ValueError("it must return times (n,), places (n, 3), momenta (n, 3) and weights (n,)")
        if not all(np.isfinite(of).all() for of in (time, position, momentum, weight)):
            raise ValueError("it returned numbers that are not finite")
        if n and not (span.start <= time.min() and time.max() < span.stop):
            raise ValueError(f"it returned times of birth outside of the step, {span.start:g} s <= t < {span.stop:g} s")
        return Births(time, position, momentum, weight)


def emitters_of(comm: MPI.Comm, scene: Scene) -> tuple[Emitter, ...]:
    """Return the sources of a scene as steps use them. Collective; InputError on all ranks for a file that cannot be used."""
    firsts = first_ids(scene.sources)
    return tuple(_emitter(comm, source, first, scene) for source, first in zip(scene.sources, firsts, strict=True))


def _emitter(comm: MPI.Comm, source: AnySource, first: int, scene: Scene) -> Emitter:
    match source:
        case FileSource():
            from_file = partial(read, source.file, source.species, source.iteration, source.group)
            return OfFile(source, first, from_rank_0(comm, from_file, InputError))
        case FunctionSource():
            return OfFunction(source, first)
        case WallSource():
            return OfWall(source, first, scene)
        case GivenSource(unit_charge=None):
            return PerStep(source, first, scene)
        case GivenSource():
            return OfOneCharge(source, first, scene)
    raise TypeError(f"no way to emit from {source}")

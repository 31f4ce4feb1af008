"""What sources give in a step: which particles, with which weights, where, how fast, and when.

A source numbers its particles in the order of their births, from its own first id on. Places, momenta and times of birth follow
from seed and id, so they are the same on any ranks and after a restart.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass
from typing import Generic, TypeVar

import numpy as np
from mpi4py import MPI

from .. import _native
from ..parallel import share
from ..particles.particles import Particles
from ..particles.sampling import draw
from ..particles.species import SpeciesTable
from ..scene.scene import Scene
from ..scene.sources import IDS, GivenSource, Source, first_ids

BIRTH = 4  # stream of the counter-based generator
Kind = TypeVar("Kind", bound=Source)


@dataclass(frozen=True)
class Span:
    """The time of a step, and how many numbers of a source are used up before it."""

    start: float  # s
    stop: float  # s
    used: int


class Emitter(ABC, Generic[Kind]):
    """One source of a scene."""

    def __init__(self, source: Kind, first: int, scene: Scene) -> None:
        self.source, self.first = source, first
        self._seed, self._domain = scene.seed, scene.domain.value
        self._origin, self._axes = source.frame(self._domain.lower, self._domain.upper)

    def draws(self, first: int, last: int) -> np.ndarray:
        """Return numbers in (0, 1) for places and momenta of particles, (7, n)."""
        return draw("random", self._seed, self.first, first, last)

    @abstractmethod
    def numbers(self, span: Span) -> range:
        """Return the numbers of the particles that may be born in a step; what is not born in it is left out later."""

    @abstractmethod
    def times(self, number: np.ndarray, span: Span) -> np.ndarray:
        """Return when particles are born, s."""

    @abstractmethod
    def weights(self, number: np.ndarray, span: Span) -> np.ndarray:
        """Return the weights of particles."""

    def newborn(self, comm: MPI.Comm, span: Span, species: SpeciesTable) -> Particles:
        """Return this rank's share of what is born in a step, in the laboratory and at the places of birth."""
        all_ = self.numbers(span)
        first, last = (all_.start + n for n in share(comm, len(all_)))
        number, u = np.arange(first, last), self.draws(first, last)
        time = self.times(number, span)
        normal, *across = self.source.momenta.momenta(u[2:5], self.source.species.mass)
        position = self._origin + self._places(u[:2]).T @ self._axes[:2]
        momentum = np.stack([*across, normal], axis=1) @ self._axes
        made = Particles(position, momentum, self.weights(number, span), number + self.first, species)
        return made.select(np.flatnonzero((span.start <= time) & (time < span.stop)))

    def own(self, ids: np.ndarray) -> np.ndarray:
        """Return which ids are those of this source."""
        return ids // IDS == self.first // IDS

    def _places(self, u: np.ndarray) -> np.ndarray:
        """Return places (2, n) on the surface, m."""
        if self.source.spot is not None:
            return self.source.spot.place(u)
        assert self.source.face_number is not None
        across = [axis for axis in range(3) if axis != self.source.face_number // 2]
        lower, upper = (np.array(corner)[across, None] for corner in (self._domain.lower, self._domain.upper))
        return lower + (upper - lower) * u

    def _uniform(self, number: np.ndarray) -> np.ndarray:
        """Return a number in (0, 1) for the time of birth of each particle."""
        out = np.empty((4, len(number)))
        _native.uniforms(self._seed, BIRTH, 0, number + self.first, out)
        return out[0]


class OfGivenCharge(Emitter[GivenSource]):
    """Charge that is given in time."""

    def draws(self, first: int, last: int) -> np.ndarray:
        return draw(self.source.sampling, self._seed, self.first, first, last)


class OfOneCharge(OfGivenCharge):
    """Charge that is given in time, by macroparticles of one charge: one is born in each part of the pulse with this charge."""

    def numbers(self, span: Span) -> range:
        first, last = (int(self.source.charge_until(time) / self._unit) for time in (span.start, span.stop))
        end = last + 2  # rounding may move a part of the pulse over the end of a step
        return range(max(first - 1, 0), end if self.source.particles is None else min(end, self.source.particles))

    def times(self, number: np.ndarray, span: Span) -> np.ndarray:
        return self.source.time_of(self._unit * (number + self._uniform(number)))

    def weights(self, number: np.ndarray, span: Span) -> np.ndarray:
        return np.broadcast_to(self._unit / self.source.species.charge, len(number))

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
        pulse = self.source.pulse
        return max(span.start, pulse.start), min(span.stop, pulse.start + pulse.duration)


def emitters_of(scene: Scene) -> tuple[Emitter, ...]:
    """Return the sources of a scene as steps use them."""
    return tuple(
        (OfOneCharge if source.unit_charge is not None else PerStep)(source, first, scene)
        for source, first in zip(scene.sources, first_ids(scene.sources), strict=True)
    )

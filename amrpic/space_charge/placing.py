"""Where the mesh lies: round the bunch, in coordinates that move with it and in which it is at rest."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from ..errors import InputError
from ..mesh.domain import AXES, Domain
from ..mesh.periods import middle, nearest
from ..parallel import Communicator, global_sums_and_largest
from ..particles.frame import SLOW
from .callers_arrays import ColumnSums

ROOM = 0.1  # of the extent, beside it at either side
LEAST_PART = 0.5  # of the extent that the mesh was made for, below which it is made anew at a regrid
FAR_TOO_SMALL = 0.25  # of that of the particles, below which it is made anew at once
FLATTEST = 1e-3  # least extent of the mesh along an axis over the largest
NO_SIZE = 1e-9  # extent over the largest, below which it is rounding
POINT = (
    1e-6  # extent over the distance from the origin of particles that all lie at one place, and m where that is zero
)
ALIKE = 1.5  # times as wide as others: cells along an axis that become as wide as these, so that most are cubes
CELLS, LONG = 32, 2.0  # along an axis; twice as many where cells would be so many times longer than the shortest
STEPS = 64.0  # parts of the extent by which the mesh moves along, so that rounding of the mean moves nothing
PER_SIZE = 8.0  # cells of the finest level per rms size
REACH = 8.0  # rms sizes that the finest level is wide, about
MOST_LEVELS = 16
PER_PARTICLE, ANYHOW = 4, 300_000  # cells of the finest level that `levels_for` allows
BINS, LEAST_BINS = 1024, 32  # of a histogram of places along an axis; fewest of a stretch whose length is good enough
CROWD, CROWD_SIZE = (
    0.25,
    0.6373,
)  # a part of the particles, and the shortest stretch with it over the rms size of a normal bunch
LONGEST = 3.0  # times as many cells per rms size along one axis as along another
STRAY = 2.0  # times as large as by its densest quarter: what is far out decides the rms size then


@dataclass(frozen=True)
class Extent:
    """How many particles and other places there are on all ranks, and where; in m."""

    count: int  # of particles
    mean: np.ndarray  # (3,) of particles
    lower: np.ndarray  # (3,) of particles
    upper: np.ndarray
    reach: tuple[np.ndarray, np.ndarray]  # lower and upper ends of particles and other places
    magnitude: float  # Σ |q|, C


def extent_of(
    comm: Communicator, count: int, magnitude: float, places: Sequence[ColumnSums], others: Sequence[ColumnSums]
) -> Extent:
    """Return the extent of particles, of which x, y and z add up so, and of other places. `magnitude`: Σ |q|, C. Collective."""
    sums, largest = {"count": float(count), "magnitude": magnitude}, {}
    for axis, (of, other) in enumerate(zip(places, others, strict=True)):
        sums[f"sum {axis}"] = of.sum
        for what, values in (("", of), ("other", other)):
            largest[f"{what} lower {axis}"] = -values.least
            largest[f"{what} upper {axis}"] = values.greatest
    totals = global_sums_and_largest(comm, sums, largest)

    def three(name: str) -> np.ndarray:
        return np.array([totals[f"{name} {axis}"] for axis in range(3)])

    lower, upper = -three(" lower"), three(" upper")
    reach = np.minimum(lower, -three("other lower")), np.maximum(upper, three("other upper"))
    return Extent(
        int(totals["count"]), three("sum") / max(totals["count"], 1), lower, upper, reach, totals["magnitude"]
    )


class Sizes(NamedTuple):
    """Those of the particles that lie in a domain, on all ranks."""

    inside: int  # their number
    equal: float  # number of equal particles that would scatter as these do
    rms: np.ndarray  # (3,) m, that of a normal bunch as dense, where few particles far out make all the difference


def sizes_of(comm: Communicator, position: np.ndarray, charge: np.ndarray, magnitude: float, domain: Domain) -> Sizes:
    """Return the sizes of particles at (k, 3) in m that lie in a domain, where space repeats those of images beside each other.

    `magnitude`: Σ |q| of all ranks, C. Collective.
    """
    if any(domain.periodic):
        position = _together(comm, position, domain)
    wall = ~np.array(domain.periodic)
    inside = ((position >= domain.lower) & (position <= domain.upper))[:, wall].all(axis=1)
    position, weight = position[inside], np.abs(charge[inside]) / (magnitude or 1.0)
    sums = [len(position), float(weight.sum()), float(weight @ weight)]
    moments = [*position.sum(axis=0), *np.einsum("kd,kd->d", position, position)]
    count, weights, squares, *moments = comm.allreduce(np.array([*sums, *moments])).tolist()
    mean, square = np.array(moments).reshape(2, 3) / max(count, 1)
    rms = np.sqrt(np.maximum(square - mean**2, 0.0))
    for axis in np.flatnonzero(rms > 0):
        size = _shortest_stretch(comm, position[:, axis], mean[axis], rms[axis], int(count)) / CROWD_SIZE
        if 0 < size < rms[axis] / STRAY:
            rms[axis] = size
    return Sizes(int(count), weights**2 / squares if squares > 0 else 0.0, rms)


def _shortest_stretch(comm: Communicator, places: np.ndarray, mean: float, rms: float, count: int) -> float:
    """Return the length in m of the shortest stretch of an axis that holds CROWD of the particles; 0 if they lie at one place.

    Found by counts in bins, so it is the same for any order of particles on any ranks. Collective.
    """
    needed = max(math.ceil(CROWD * count), 2)
    lower, width = mean - 4 * rms, 8 * rms / BINS  # no more than a sixteenth of all lie outside
    while width > NO_SIZE * rms:
        number = np.floor((places - lower) / width)
        inside = number[(number >= 0) & (number < BINS)].astype(np.int64)
        below = np.concatenate([[0], np.cumsum(comm.allreduce(np.bincount(inside, minlength=BINS)))])
        end = np.searchsorted(below, below + needed)  # of the shortest run of bins from each on
        lengths = np.where(end <= BINS, end - np.arange(BINS + 1), BINS)
        first, length = int(np.argmin(lengths)), int(lengths.min())
        if length >= LEAST_BINS:
            return length * width
        lower += (first - 1) * width
        width *= (length + 2) / BINS
    return 0.0


def _together(comm: Communicator, position: np.ndarray, domain: Domain) -> np.ndarray:
    """Return the images of places that are nearest to their middle along periodic axes, or in the domain. Collective."""
    lower, length = np.array(domain.lower), np.array(domain.upper) - domain.lower
    turns = 2 * np.pi * (position - lower) / length
    sums = comm.allreduce(np.array([np.full(3, len(position)), np.cos(turns).sum(axis=0), np.sin(turns).sum(axis=0)]))
    out = position.copy()
    for axis in np.flatnonzero(domain.periodic):
        count, cosine, sine = sums[:, axis]
        place = middle(cosine / max(count, 1), sine / max(count, 1), max(count, 1))[0]
        centre = lower[axis] + (place if np.isfinite(place) else 0.5) * length[axis]
        out[:, axis] = centre + nearest(position[:, axis] - centre, domain.period(int(axis)))
    return out


class Coordinates(NamedTuple):
    """Those of a mesh: x, y and γz from a centre."""

    centre: np.ndarray  # (3,) m
    gamma: float

    def along(self, axis: int) -> tuple[float, float]:
        """What is subtracted from x, y or z, m, and what the rest is multiplied by."""
        return float(self.centre[axis]), self.gamma if axis == 2 else 1.0


class Placing:
    """The mesh's coordinates: x, y and γz from a centre that follows the bunch, or, in a domain that is given, from its own.

    In them charge that moves along z with γ is at rest, so its field is electrostatic.
    """

    def __init__(self, domain: Domain | None, cells: tuple[int, int, int] | None) -> None:
        self._given, self._cells = domain, cells
        self._extent = self._room = np.zeros(3)  # that the domain was made for, and that it is made for
        self._bunch = np.zeros(3)  # of the particles that it was made for, m
        self.domain: Domain | None = None
        self.centre, self.gamma = np.zeros(3), 1.0

    @property
    def free(self) -> bool:
        """Whether there are no walls and periods, so that a particle alone feels nothing."""
        return self._given is None

    @property
    def coordinates(self) -> Coordinates:
        """The present ones."""
        return Coordinates(self.centre, self.gamma)

    def follow(self, extent: Extent, gamma: float, tighten: bool) -> bool:
        """Move along with particles; return whether the domain is another one now. Local, the same on all ranks.

        `tighten`: also where the bunch has become much smaller.
        """
        before = self.domain
        if self._given is not None:
            if before is None or gamma != self.gamma:
                self.domain = _at_rest(self._given, gamma)
        elif before is None or not self._serves(before, extent, gamma, tighten):
            self.domain = self._around(extent, gamma)
        else:
            self.centre = self._centre(extent)
        self.gamma = gamma
        return self.domain is not before

    def suited(self, rms: np.ndarray) -> Domain:
        """Return the domain, wider along axes on which far more cells lie in a bunch of rms sizes (3,) in m than on others.

        A particle far out along one axis makes cells long along it, and no levels would help the bunch. Local.
        """
        assert self.domain is not None
        per_cell = np.where(rms > 0, rms, np.nan) / self.domain.spacing
        wider = np.maximum(np.nan_to_num(per_cell / np.nanmin(per_cell, initial=np.inf) / LONGEST), 1)
        if self.free and (wider > 1).any():
            lower, upper = np.array(self.domain.lower), np.array(self.domain.upper)
            room = (wider - 1) * (upper - lower) / 2
            self._room = self._room * wider
            self.domain = Domain(tuple(lower - room), tuple(upper + room), self.domain.cells)
        return self.domain

    def _scale(self, gamma: float) -> np.ndarray:
        return np.array([1.0, 1.0, gamma])

    def _centre(self, extent: Extent) -> np.ndarray:
        """Return the mean, rounded so that rounding errors of it do not count."""
        step = 2.0 ** np.floor(np.log2(self._room / self._scale(self.gamma) / STEPS))
        return np.rint(extent.mean / step) * step

    def _serves(self, domain: Domain, extent: Extent, gamma: float, tighten: bool) -> bool:
        centre, scale = self._centre(extent), self._scale(gamma)
        lower, upper = ((end - centre) * scale for end in extent.reach)
        inside = (lower >= domain.lower + domain.spacing).all() and (upper <= domain.upper - domain.spacing).all()
        shrunk = (_bunch(extent, gamma) < FAR_TOO_SMALL * self._bunch).any()
        return bool(inside and not shrunk and not (tighten and (upper - lower < LEAST_PART * self._extent).any()))

    def _around(self, extent: Extent, gamma: float) -> Domain:
        scale = self._scale(gamma)
        lower, upper = (end * scale for end in extent.reach)
        largest = float((upper - lower).max()) or POINT * (float(np.abs(lower).max()) or 1.0)
        self._extent, self._bunch, self.gamma = upper - lower, _bunch(extent, gamma), gamma
        thin = self._extent <= NO_SIZE * largest  # nothing says how fine: as along the others
        room = np.where(thin, largest, np.maximum(self._extent, FLATTEST * largest))
        cells = np.array(self._cells or np.where(room > LONG * room.min(), 2 * CELLS, CELLS))
        widths = room / cells
        self._room = cells * [widths[(widths >= width) & (widths <= ALIKE * width)].max() for width in widths]
        self.centre = self._centre(extent)
        middle = (lower + upper) / 2 - self.centre * scale
        # a step that the mesh moves along by, and two cells, which clouds need between particles and faces
        half = self._room * (0.5 + ROOM + 1 / STEPS) * (1 + 4 / cells.min())
        return Domain(tuple(middle - half), tuple(middle + half), tuple(cells.tolist()))


def _bunch(extent: Extent, gamma: float) -> np.ndarray:
    """Return the extent (3,) in m of particles where they are at rest, as a mesh sees it: none is much flatter than long."""
    of_particles = (extent.upper - extent.lower) * (1.0, 1.0, gamma)
    return np.maximum(of_particles, FLATTEST * of_particles.max())


def _at_rest(domain: Domain, gamma: float) -> Domain:
    """Return a domain in coordinates in which charge that moves along z is at rest. InputError where no such walls are."""
    across = set(domain.boundary[2]) - {"open", "periodic"}
    if across and 1 - gamma**-2 > SLOW:
        raise InputError(
            f"the domain has a {across.pop()} face across z, along which the particles move with γ = {gamma:g}: images in it "
            "move against them, which Simulation knows and SpaceCharge does not; make it open"
        )
    scale = (1.0, 1.0, gamma)
    lower, upper = (tuple(np.multiply(end, scale)) for end in (domain.lower, domain.upper))
    return Domain(lower, upper, domain.cells, domain.boundary)


def levels_for(domain: Domain, rms: np.ndarray, count: int) -> int:
    """Return how many refined levels give a bunch with these rms sizes (3,) in m cells that are fine enough for its field, and
    no more of them than its particles fill."""
    wide = [axis for axis in range(len(AXES)) if rms[axis] > 0]
    missing = max((PER_SIZE * domain.spacing[axis] / rms[axis] for axis in wide), default=1.0)
    levels = min(max(math.ceil(math.log2(missing)), 0), MOST_LEVELS)

    def cells(levels: int) -> float:
        return float(np.prod(REACH * rms / domain.spacing * 2**levels + 8))

    while levels > 0 and cells(levels) > max(PER_PARTICLE * count, ANYHOW):
        levels -= 1
    return levels

"""Encounters: what particles meet on their straight flights from one place to the next."""

from __future__ import annotations

import functools
import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, fields
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray

from .. import _native
from ..conductors.hits import first_hits
from ..mesh.domain import Domain
from ..mesh.window import Window, axes
from ..scene.electrodes import Electrode
from ..scene.obstacles import Aperture, RectangularAperture, RoundAperture, Screen, Turned

Array = NDArray[Any]
Find = Callable[[Array, Array, Array, Array], tuple[Array, Array, Array]]

MOST_PERIODS = 10_000  # that a flight is followed through: its parts are looked at one after the other


@dataclass(frozen=True, eq=False)
class Encounters:
    """What flights meet."""

    flight: Array  # (m,) int64, index of the particle
    what: Array  # (m,) int64, which of the things that can be met
    share: Array  # (m,) of the flight until then, 0 to 1
    place: Array  # (m, 3) m, in the laboratory
    direction: Array  # (m,) int64: 1 for flights up z in the laboratory, -1 down, 0 across

    def __len__(self) -> int:
        return len(self.flight)

    def select(self, chosen: Array) -> Self:
        """Return those that an index array or a mask names."""
        return type(self)(*(getattr(self, field.name)[chosen] for field in fields(self)))

    def joined(self, other: Self) -> Self:
        """Return these and others."""
        pairs = ((getattr(self, field.name), getattr(other, field.name)) for field in fields(self))
        return type(self)(*(np.concatenate(pair) for pair in pairs)).in_order()

    def in_order(self) -> Self:
        """Return them in the order of flights and along each of them."""
        return self.select(np.lexsort((self.share, self.flight)))

    def until(self, flight: Array, share: Array) -> Self:
        """Return those that come no later than the share (k,) at which some flights (k,), ascending, end."""
        place = np.searchsorted(flight, self.flight)
        goes_on = np.asarray(np.append(flight, -1)[place] != self.flight)
        return self.select(goes_on | np.asarray(self.share <= np.append(share, np.inf)[place]))


@dataclass(frozen=True, eq=False)
class Flights:
    """Straight ways of this rank's particles from start to end, (n, 3) m, in coordinates of the domain, not wrapped at the end.

    The domain is in the window `before` when flights start, and in `after` when they end; in between its origin moves evenly.
    """

    start: Array
    end: Array
    domain: Domain
    before: Window
    after: Window
    origin: Array | None = None  # (n, 3) m, where the window is when each flight starts, if that is not in `before`

    def losses(self, obstacles: Sequence[_native.Aperture | Electrode]) -> Encounters:
        """Return where flights first touch the solid of an aperture, or an electrode; at once where they start in it.

        `what` counts all of them. Solid of an aperture that reaches beyond a periodic face along z
        goes on at the other one, unless the domain moves.
        """
        solids = [
            (number, image)
            for number, aperture in enumerate(obstacles)
            if isinstance(aperture, _native.Aperture)
            for image in self._images(aperture)
        ]
        numbers, met = (
            np.array([number for number, _ in solids], dtype=np.int64),
            self._meet(lambda *ways: _native.first_encounters([aperture for _, aperture in solids], *ways)),
        )
        met.what[:] = numbers[met.what]
        electrodes = {number: metal for number, metal in enumerate(obstacles) if isinstance(metal, Electrode)}
        if electrodes:
            met = met.joined(self._meet(functools.partial(_hits, electrodes)))
        met = met.select(
            np.all(np.isfinite(met.place), axis=1)
        )  # others are bad input, about which `migrate` complains
        first = met.select(np.unique(met.flight, return_index=True)[1])
        leaving = self._leaving(first.flight)
        return first.until(leaving.flight, leaving.share)

    def crossings(self, screens: Sequence[_native.Screen], lost: Encounters) -> Encounters:
        """Return where flights cross screens before they are lost."""
        met = self._meet(lambda *ways: _native.crossings(screens, *ways))
        exact = np.array([math.nan if screen.is_turned else screen.z for screen in screens])[met.what]
        met.place[:, 2] = np.where(np.isnan(exact), met.place[:, 2], exact)
        return met.until(lost.flight, lost.share).in_order()

    def exits(self, flight: Array) -> Encounters:
        """Return where some flights, int64 (m,) ascending, leave the domain that end outside: `what` counts its `FACES`.

        What starts outside leaves there.
        """
        out = self._leaving(flight)
        outside = np.setdiff1d(flight, out.flight)  # which end outside by rounding alone: at the face that is next
        next_face = np.argmax(self._beyond(self.end[outside]), axis=1)
        return out.joined(self._at_faces(outside, next_face, np.ones(len(outside))))

    # ---- faces of the domain ----

    def _beyond(self, at: Array) -> Array:
        """Return how far places (m, 3) lie beyond each face (m, 6), in m; never beyond periodic ones."""
        out = np.stack([self.domain.lower - at, at - self.domain.upper], axis=2).reshape(-1, 6)
        out[:, np.repeat(self.domain.periodic, 2)] = -np.inf
        return out

    def _leaving(self, flight: Array) -> Encounters:
        """Return where some flights leave the domain, of those that end beyond a face."""
        start, end = self._beyond(self.start[flight]), self._beyond(self.end[flight])
        outside = end > 0
        with np.errstate(divide="ignore", invalid="ignore"):
            share = np.where(outside, np.where(start >= 0, 0.0, start / (start - end)), np.inf)
        face, leaves = np.argmin(share, axis=1), outside.any(axis=1)
        return self._at_faces(flight[leaves], face[leaves], share[leaves, face[leaves]])

    def _at_faces(self, flight: Array, face: Array, share: Array) -> Encounters:
        start, end, domain = self.start[flight], self.end[flight], self.domain
        first, last = self.before.places(start), self.after.places(end)
        if self._turns:  # the domain turns under the straight way, by so little that this is as good as a line in it
            return _encounters(flight, face, share, first + share[:, None] * (last - first), last - first)
        place, rows, axis = start + share[:, None] * (end - start), np.arange(len(flight)), face // 2
        at_face = np.stack([domain.lower, domain.upper], axis=1).ravel()[face]
        place[rows, axis] = np.where(self._beyond(start)[rows, face] < 0, at_face, place[rows, axis])
        length = np.subtract(domain.upper, domain.lower)
        place -= np.where(domain.periodic, np.floor((place - domain.lower) / length) * length, 0.0)
        return _encounters(flight, face, share, place + self._origin(flight, share), last - first)

    @property
    def _turns(self) -> bool:
        return self.before.is_turned or self.after.is_turned

    def _origin(self, flight: Array, share: Array) -> Array:
        """Return where the origin of the coordinates is in the laboratory at shares of some flights, (m, 3) m."""
        start = np.array(self.before.origin) if self.origin is None else self.origin[flight]
        return start + share[:, None] * (self.after.origin - start)

    def _ways(self) -> tuple[Array, Array, Array, Array]:
        """Return starts and ends (n, 3) of flights and what is to be added to them to have places in the laboratory, (3,) m."""
        if self.origin is None and not self._turns:
            return self.start, self.end, np.array(self.before.origin), np.array(self.after.origin)
        start = self.before.places(self.start) if self.origin is None else self.start + self.origin
        return np.asfortranarray(start), np.asfortranarray(self.after.places(self.end)), np.zeros(3), np.zeros(3)

    # ---- periodic faces ----

    def _images(self, aperture: _native.Aperture) -> Iterator[_native.Aperture]:
        """Yield an aperture, and it a period along z further up or down where it reaches beyond a face."""
        yield aperture
        period, origin = self.domain.period(2), self.before.origin
        if (
            math.isinf(period)
            or aperture.where.is_turned
            or self._turns
            or self.origin is not None
            or self.after.origin != origin
        ):
            return
        lower, upper = aperture.z
        for face, up in ((self.domain.lower[2], 1), (self.domain.upper[2], -1)):
            if lower < face + origin[2] < upper and math.isfinite(upper - lower):
                z = lower + up * period, upper + up * period
                yield _native.Aperture(aperture.hole, aperture.centre, aperture.half_width, z, aperture.where)

    @property
    def most_periods(self) -> float:
        """How many periods of the domain this rank's longest flight has along an axis that is periodic."""
        out = 0.0
        for axis in np.flatnonzero(self.domain.periodic).tolist():
            way = np.abs(self.end[:, axis] - self.start[:, axis])
            out = max(out, float(way.max(initial=0.0, where=np.isfinite(way))) / self.domain.period(axis))
        return out

    def _meet(self, find: Find) -> Encounters:
        """Return what `find` finds on the flights, each part of them between periodic faces where it lies in the domain."""
        parts, flights = [], self
        number, passed = (
            np.arange(len(self.start)),
            np.zeros(len(self.start)),
        )  # of the flights, and share until their parts
        while True:
            ways = flights._ways()
            flight, what, share = find(*ways)
            start = ways[0][flight] + ways[2]
            way = ways[1][flight] + ways[3] - start
            met = _encounters(flight, what, share, start + share[:, None] * way, way)
            cut, until, remaining = flights._rest()
            met = met.until(cut, until)
            begun = passed[met.flight]
            share = begun + met.share * (1 - begun)
            parts.append(Encounters(number[met.flight], met.what, share, met.place, met.direction))
            if len(cut) == 0:
                return functools.reduce(Encounters.joined, parts)
            number, passed, flights = number[cut], passed[cut] + until * (1 - passed[cut]), remaining

    def _rest(self) -> tuple[Array, Array, Flights]:
        """Return which flights go through a periodic face, after which share of their way, and the rest of them beyond it."""
        lower, upper = np.array(self.domain.lower), np.array(self.domain.upper)
        passes = np.zeros(len(self.start), dtype=bool)
        for axis in np.flatnonzero(self.domain.periodic):
            z = self.end[:, axis]
            passes |= (z < lower[axis]) | (z >= upper[axis])
        cut = np.flatnonzero(passes & np.isfinite(self.end).all(axis=1)) if passes.any() else np.flatnonzero(passes)
        start, end, rows = self.start[cut], self.end[cut], np.arange(len(cut))
        up = end >= upper
        crosses = (up | (end < lower)) & self.domain.periodic
        with np.errstate(divide="ignore", invalid="ignore"):
            shares = np.where(crosses, (np.where(up, upper, lower) - start) / (end - start), np.inf)
        axis = np.argmin(shares, axis=1)
        share = np.clip(shares[rows, axis], 0.0, 1.0)
        place = start + share[:, None] * (end - start)
        below = np.nextafter(
            lower, -np.inf
        )  # so that planes on the lower face are crossed upwards, as those on the upper one are
        place[rows, axis] = np.where(up, below, upper)[rows, axis]
        end[rows, axis] -= (np.where(up, 1.0, -1.0) * (upper - lower))[rows, axis]
        return cut, share, Flights(place, end, self.domain, self.before, self.after, self._origin(cut, share))


def _hits(
    electrodes: Mapping[int, Electrode], start: Array, end: Array, before: Array, after: Array
) -> tuple[Array, Array, Array]:
    """Return which ways meet electrodes, the numbers of these, and after which share of them."""
    starts, ends = start + before, end + after
    finite = np.flatnonzero(np.isfinite(starts).all(axis=1) & np.isfinite(ends).all(axis=1))
    hits = first_hits(list(electrodes.values()), starts[finite], ends[finite])
    return finite[hits.segment], np.array(list(electrodes), np.int64)[hits.electrode], hits.share


def _encounters(flight: Array, what: Array, share: Array, place: Array, way: Array) -> Encounters:
    return Encounters(flight, what, share, place, np.sign(way[:, 2]).astype(np.int64))


def native_aperture(aperture: Aperture) -> _native.Aperture:
    """Return an aperture as the kernel takes it."""
    half = math.inf if aperture.length is None else aperture.length / 2
    hole = _native.Hole.rectangle if isinstance(aperture, RectangularAperture) else _native.Hole.ellipse
    widths = (aperture.radius,) * 2 if isinstance(aperture, RoundAperture) else aperture.half_widths  # type: ignore[attr-defined]
    if aperture.is_along_z and aperture.reach is None:
        x, y, z = aperture.centre
        return _native.Aperture(hole, (x, y), widths, (z - half, z + half))
    return _native.Aperture(hole, (0.0, 0.0), widths, (-half, half), _where(aperture, aperture.centre))


def native_screen(screen: Screen) -> _native.Screen:
    """Return a screen as the kernel takes it."""
    if screen.centre is None:
        assert screen.z is not None
        return _native.Screen(screen.z)
    return _native.Screen(0.0, _where(screen, screen.centre))


def _where(of: Turned, centre: tuple[float, float, float]) -> _native.Whereabouts:
    return _native.Whereabouts(centre, axes(of.direction, of.roll), of.reach or math.inf)

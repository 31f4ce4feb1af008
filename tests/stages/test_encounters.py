"""What straight flights meet, against points on them: apertures, planes, faces of the domain, periodic axes."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from amrpic import Scene, Simulation, _native
from amrpic.errors import ParticleError
from amrpic.mesh.domain import FACES, Domain
from amrpic.mesh.window import Window, axes
from amrpic.scene.obstacles import EllipticAperture, RectangularAperture, RoundAperture, Screen
from amrpic.stages.encounters import Encounters, Flights, native_aperture, native_screen

HERE = Window()
WIDE = Domain((-20, -20, -20), (20, 20, 20), (8, 8, 8))
APERTURES = (
    RoundAperture(kind="round", radius=0.7, length=0.8, centre=(0.1, -0.2, 0.3)),
    EllipticAperture(kind="elliptic", half_widths=(0.9, 0.4), length=0.05, centre=(0, 0.1, -0.6)),
    RectangularAperture(kind="rectangular", half_widths=(0.5, 1.1), length=1.0, centre=(-0.2, 0.3, 1.0)),
    RoundAperture(kind="round", radius=1.5),
)
PLANES = (-0.5, 0.0, 0.7)
NO = Encounters(*(np.zeros(0, int) for _ in range(5)))
SCREENS = [_native.Screen(z) for z in PLANES]


def columns(values: Any) -> np.ndarray:
    return np.asfortranarray(values, dtype=float)


def flights(start: Any, end: Any, domain: Domain = WIDE, before: Window = HERE, after: Window = HERE) -> Flights:
    return Flights(columns(start), columns(end), domain, before, after)


def random_ways(count: int, seed: int = 3) -> tuple[np.ndarray, np.ndarray]:
    """Flights of all lengths, some along an axis, some at rest."""
    rng = np.random.default_rng(seed)
    start, way = (
        rng.uniform(-1.3, 1.3, (count, 3)),
        rng.normal(size=(count, 3)) * 10.0 ** rng.uniform(-2, 0.3, (count, 1)),
    )
    way[rng.random((count, 3)) < 0.1] = 0.0
    return start, start + way


def in_solid(aperture: Any, x: np.ndarray) -> np.ndarray:
    """Whether points (..., 3) lie in the solid of an aperture."""
    u = x - np.array(aperture.centre)
    half = np.inf if aperture.length is None else aperture.length / 2
    a, b = (aperture.radius,) * 2 if aperture.kind == "round" else aperture.half_widths
    if aperture.kind == "rectangular":
        hole = (np.abs(u[..., 0]) <= a) & (np.abs(u[..., 1]) <= b)
    else:
        hole = (u[..., 0] / a) ** 2 + (u[..., 1] / b) ** 2 <= 1
    return (np.abs(u[..., 2]) <= half) & ~hole


def share_by_points(aperture: Any, start: np.ndarray, end: np.ndarray) -> float:
    """The share after which one flight is in the solid: it can change at these shares alone, so points between them tell."""
    way, u = end - start, start - np.array(aperture.centre)
    a, b = (aperture.radius,) * 2 if aperture.kind == "round" else aperture.half_widths
    at = [0.0, 1.0]
    for axis, half in (
        (2, (aperture.length or np.inf) / 2),
        *(((0, a), (1, b)) if aperture.kind == "rectangular" else ()),
    ):
        if way[axis] != 0:
            at += [(side * half - u[axis]) / way[axis] for side in (-1, 1)]
    if aperture.kind != "rectangular":
        s, w = u[:2] / (a, b), way[:2] / (a, b)
        roots = np.roots([w @ w, 2 * s @ w, s @ s - 1]) if w @ w > 0 else np.zeros(0)
        at += [root.real for root in roots if abs(root.imag) < 1e-12]
    cuts = np.unique([share for share in at if 0 <= share <= 1])
    solid = in_solid(aperture, start + 0.5 * (cuts[:-1] + cuts[1:])[:, None] * way)
    return float(cuts[np.argmax(solid)]) if solid.any() else np.inf


@pytest.mark.parametrize("count", [0, 1, 7, 8, 9, 2500])
def test_losses_are_where_points_on_flights_first_lie_in_the_solid(count):
    start, end = random_ways(count)
    found = flights(start, end).losses([native_aperture(a) for a in APERTURES])
    shares = np.array([[share_by_points(a, s, e) for a in APERTURES] for s, e in zip(start, end, strict=True)])
    shares = shares.reshape(count, len(APERTURES))
    hit = np.flatnonzero(np.isfinite(shares).any(axis=1))
    assert found.flight.tolist() == hit.tolist()
    assert count < 2500 or len(hit) > 700
    np.testing.assert_allclose(found.share, shares[hit].min(axis=1), rtol=0, atol=2e-8 if count > 9 else 1e-12)
    assert (
        count == 0 or np.quantile(np.abs(found.share - shares[hit].min(axis=1)), 0.98) < 1e-13
    )  # but for grazing ones
    np.testing.assert_array_equal(found.what, np.argmin(shares[hit], axis=1))
    np.testing.assert_allclose(found.place, start[hit] + found.share[:, None] * (end - start)[hit], rtol=0, atol=1e-14)
    np.testing.assert_array_equal(found.direction, np.sign((end - start)[hit, 2]))
    assert count < 2500 or {0, 1, 2, 3} == set(found.what)


def test_places_of_losses_lie_on_walls_and_front_faces_to_rounding():
    start, end = random_ways(2000, seed=5)
    for aperture in APERTURES:
        met = flights(start, end).losses([native_aperture(aperture)])
        met = met.select(~in_solid(aperture, start[met.flight]))
        u = met.place - np.array(aperture.centre)
        a, b = (aperture.radius,) * 2 if aperture.kind == "round" else aperture.half_widths
        rectangle = np.maximum(np.abs(u[:, 0]) / a, np.abs(u[:, 1]) / b)
        off_wall = np.abs((rectangle if aperture.kind == "rectangular" else np.hypot(u[:, 0] / a, u[:, 1] / b)) - 1)
        off_face = np.abs(np.abs(u[:, 2]) - (aperture.length or np.inf) / 2)
        assert len(met) > 20 and np.minimum(off_wall, off_face).max() < 4e-15


def test_a_flight_in_two_parts_is_lost_where_the_whole_one_is():
    start, end = random_ways(3000, seed=8)
    native = [native_aperture(a) for a in APERTURES]
    middle = start + np.random.default_rng(1).random((len(start), 1)) * (end - start)
    whole, first, second = (flights(a, b).losses(native) for a, b in ((start, end), (start, middle), (middle, end)))
    assert np.array_equal(np.union1d(first.flight, second.flight), whole.flight)
    later = second.select(~np.isin(second.flight, first.flight))
    place = np.full((len(start), 3), np.nan)
    place[later.flight], place[first.flight] = later.place, first.place
    np.testing.assert_allclose(place[whole.flight], whole.place, rtol=0, atol=1e-13)


def test_thin_plates_and_grazing_flights():
    plate = native_aperture(RoundAperture(kind="round", radius=1.0, length=1e-9))
    start = [[0.5, 0, -1], [1.5, 0, -1], [1.5, 0, 1], [1.0, 0, -1], [1.5, 0, -1]]
    end = [[0.5, 0, 1], [1.5, 0, 1], [1.5, 0, -1], [1.0, 0, 1], [0.0, 0, -0.5]]
    met = flights(start, end).losses([plate])
    assert met.flight.tolist() == [1, 2]  # a flight along the wall of the hole, too, passes
    np.testing.assert_allclose(met.place[:, 2], [-5e-10, 5e-10], rtol=1e-6)
    assert met.direction.tolist() == [1, -1]


def test_crossings_of_planes_in_both_directions_until_a_flight_is_lost():
    start, end = random_ways(4000, seed=2)
    native = [native_aperture(APERTURES[0])]
    way = flights(start, end)
    lost = way.losses(native)
    all_of, met = way.crossings(SCREENS, way.losses([])), way.crossings(SCREENS, lost)
    z, dz = start[:, 2:], (end - start)[:, 2:]
    crosses = (z < PLANES) != (z + dz < PLANES)
    assert len(all_of) == crosses.sum() > 500
    assert np.array_equal(np.bincount(all_of.flight, minlength=4000), crosses.sum(axis=1))
    np.testing.assert_allclose(
        all_of.share, (np.array(PLANES)[all_of.what] - z[all_of.flight, 0]) / dz[all_of.flight, 0]
    )
    assert np.all(all_of.place[:, 2] == np.array(PLANES)[all_of.what])
    assert np.all(np.diff(all_of.share)[np.diff(all_of.flight) == 0] >= 0)
    limit = np.full(4000, np.inf)
    limit[lost.flight] = lost.share
    kept = all_of.select(all_of.share <= limit[all_of.flight])
    assert len(kept) < len(all_of) and np.array_equal(kept.share, met.share)


def test_of_flights_that_follow_each_other_one_crosses():
    z = np.array([-1.0, -0.5, -0.5, 0.0, 0.3, 0.0, -0.2])  # two stops on planes
    path = np.stack([0 * z, 0 * z, z], axis=1)
    met = flights(path[:-1], path[1:]).crossings(SCREENS, flights(path[:0], path[:0]).losses([]))
    assert [(PLANES[w], d) for w, d in zip(met.what, met.direction, strict=True)] == [(-0.5, 1), (0.0, 1), (0.0, -1)]


def test_exits_are_at_the_first_face_that_is_passed():
    domain = Domain((-1, -1, -1), (1, 1, 1), (8, 8, 8))
    rng = np.random.default_rng(6)
    start, end = rng.uniform(-1, 1, (500, 3)), rng.uniform(-3, 3, (500, 3))
    outside = np.flatnonzero((np.abs(end) >= 1).any(axis=1))
    met = flights(start, end, domain).exits(outside)
    assert np.array_equal(met.flight, outside)
    s, w = start[outside], (end - start)[outside]
    shares = np.where(np.abs(end[outside]) >= 1, (np.sign(w) - s) / w, np.inf)
    np.testing.assert_allclose(met.share, shares.min(axis=1), rtol=1e-13)
    axis = shares.argmin(axis=1)
    side = np.sign(w)[np.arange(len(w)), axis]
    assert [FACES[what] for what in met.what] == [
        f"{'xyz'[a]}_{'upper' if u > 0 else 'lower'}" for a, u in zip(axis, side, strict=True)
    ]
    assert np.array_equal(met.place[np.arange(len(w)), axis], side)
    assert np.abs(met.place).max() <= 1


def test_what_is_outside_from_the_start_is_met_there():
    domain = Domain((-1, -1, -1), (1, 1, 1), (8, 8, 8))
    at = [[0, 3, 0], [-1.5, 0, 0], [0, 0, 1.5], [0, 1.25, 0]]
    met = flights(at, at, domain).exits(np.arange(4))
    assert [FACES[what] for what in met.what] == ["y_upper", "x_lower", "z_upper", "y_upper"]
    assert met.place.tolist() == at and not met.share.any()


def test_apertures_beyond_the_face_that_a_flight_leaves_by_do_not_count():
    domain = Domain((-1, -1, -1), (1, 1, 1), (8, 8, 8))
    plate = [native_aperture(RoundAperture(kind="round", radius=0.1, length=0.2, centre=(0, 0, z))) for z in (1.5, 0.5)]
    way = flights([[0.5, 0, 0], [0.5, 0, 0]], [[0.5, 0, 2], [1.5, 0, 0.79]], domain)
    assert way.losses(plate[:1]).flight.tolist() == []
    assert way.losses(plate).flight.tolist() == [0]  # the other one leaves just before: at z = 0.395
    assert way.losses(plate).what.tolist() == [1]


def test_flights_through_periodic_faces_meet_what_lies_behind_them():
    """The same as in a domain with all its copies side by side."""
    periodic = Domain((-1, -1, -1), (1, 1, 1), (8, 8, 8), {"x": "open", "y": "periodic", "z": "periodic"})
    apertures = [
        RectangularAperture(kind="rectangular", half_widths=(0.3, 0.4), length=0.1, centre=(0, 0, z))
        for z in (-0.7, 0.8)
    ]
    copies = [
        RectangularAperture(kind="rectangular", half_widths=(0.3, 0.4), length=0.1, centre=(0, 2 * j, z + 2 * k))
        for z in (-0.7, 0.8)
        for j in range(-2, 3)
        for k in range(-2, 3)
    ]
    rng = np.random.default_rng(9)
    start = rng.uniform(-1, 1, (4000, 3)) * (0.3, 1, 1)
    end = start + rng.normal(size=(4000, 3)) * (0.02, 1.0, 1.0)
    inside = (np.abs(end[:, 1:]) < 4).all(axis=1)
    start, end = start[inside], end[inside]
    met = flights(start, end, periodic).losses([native_aperture(a) for a in apertures])
    # Copies side by side along y cover each other's holes: what is solid is what all of one z have as solid.
    shares = np.full(len(start), np.inf)
    for n, (s, e) in enumerate(zip(start, end, strict=True)):
        cuts = {0.0, 1.0}
        for axis, places in ((0, (-0.3, 0.3)), (1, np.arange(-9, 10) + 0.4), (1, np.arange(-9, 10) - 0.4)):
            cuts |= {(p - s[axis]) / (e - s)[axis] for p in places}
        cuts |= {(c.centre[2] + h - s[2]) / (e - s)[2] for c in copies for h in (-0.05, 0.05)}
        at = np.array(sorted(c for c in cuts if 0 <= c <= 1))
        middle = s + 0.5 * (at[:-1] + at[1:])[:, None] * (e - s)
        middle[:, 1:] = (middle[:, 1:] + 1) % 2 - 1
        solid = np.any([in_solid(a, middle) for a in apertures], axis=0)
        shares[n] = at[np.argmax(solid)] if solid.any() else np.inf
    assert met.flight.tolist() == np.flatnonzero(np.isfinite(shares)).tolist() and len(met) > 1000
    np.testing.assert_allclose(met.share, shares[met.flight], rtol=0, atol=1e-13)
    assert np.abs(met.place[:, 1:]).max() <= 1
    on = np.array([apertures[w].centre[2] for w in met.what])
    assert np.all(np.abs(met.place[:, 2] - on) <= 0.05 + 1e-12)


TURNED = Window().turned(np.array([0, 0, 1.0]), np.array([0.1, 0.2, 1.0]))


@pytest.mark.parametrize(
    "axes", [(Window(), Window()), (TURNED, TURNED.turned(np.array([0, 0, 1]), np.array([0.01, 0, 1])))]
)
def test_a_window_that_moves_and_turns_leaves_apertures_and_planes_in_the_laboratory(axes):
    start, end = random_ways(1000, seed=12)
    native = [native_aperture(a) for a in APERTURES]
    before, after = axes[0].at(np.array([0.1, 0.2, 5.0])), axes[1].at(np.array([0.15, 0.1, 7.0]))
    still = flights(start, end)
    seen = [window.from_laboratory(x - window.origin) for x, window in ((start, before), (end, after))]
    moving = flights(seen[0], seen[1], WIDE, before, after)
    for a, b in (
        (still.losses(native), moving.losses(native)),
        (still.crossings(SCREENS, still.losses([])), moving.crossings(SCREENS, moving.losses([]))),
    ):
        assert len(a) > 100 and np.array_equal(a.flight, b.flight) and np.array_equal(a.what, b.what)
        np.testing.assert_allclose(a.share, b.share, rtol=0, atol=1e-11)
        np.testing.assert_allclose(a.place, b.place, rtol=0, atol=1e-12)
        across = a.direction == 0  # which rounding makes either
        assert np.array_equal(a.direction[~across], b.direction[~across])


def test_faces_of_a_domain_go_with_the_window():
    start, end = random_ways(1000, seed=12)
    before, after = Window((0.1, 0.2, 5.0)), Window((0.15, 0.1, 7.0))
    box = Domain((-1.5,) * 3, (1.5,) * 3, (8, 8, 8))
    met = flights(start, end + np.array([0, 0, 9]), box, before, after).exits(np.arange(len(start)))
    local = met.place - before.origin - met.share[:, None] * np.subtract(after.origin, before.origin)
    assert np.abs(local).max() <= 1.5 + 1e-14
    assert np.all(np.isclose(np.abs(local), 1.5, rtol=0, atol=1e-14).any(axis=1))


def test_flights_through_any_number_of_periods_meet_what_a_line_of_copies_has():
    """Screens as often as their copies on the whole way, apertures at the first copy whose solid is on it."""
    periodic = Domain((-1, -1, -1), (1, 1, 1), (8, 8, 8), {"x": "open", "y": "open", "z": "periodic"})
    planes = (-1.0, -0.3, 0.0, 1.0)
    rng = np.random.default_rng(11)
    start = rng.uniform(-0.9, 0.9, (40, 3)) * (0.1, 0.1, 1)
    way = np.stack([np.zeros(40), np.zeros(40), rng.choice([-1, 1], 40) * 10.0 ** rng.uniform(0, 2.5, 40)], axis=1)
    end = start + way
    met = flights(start, end, periodic).crossings(
        [_native.Screen(z) for z in planes], flights(start[:0], end[:0], periodic).losses([])
    )
    wanted = []
    for n, (z, to) in enumerate(zip(start[:, 2], end[:, 2], strict=True)):
        for what, plane in enumerate(planes):
            copies = plane + 2 * np.arange(-400, 401)
            lower, upper = min(z, to), max(z, to)
            between = copies[(lower < copies) & (copies <= upper)]
            wanted += [(n, what, (copy - z) / (to - z)) for copy in between]
    wanted.sort(key=lambda one: (one[0], one[2], one[1]))
    found = sorted(
        zip(met.flight, met.what, met.share, strict=True), key=lambda one: (one[0], round(one[2], 9), one[1])
    )
    wanted.sort(key=lambda one: (one[0], round(one[2], 9), one[1]))
    assert [one[:2] for one in found] == [one[:2] for one in wanted] and len(found) > 3000
    assert [one[2] for one in found] == pytest.approx([one[2] for one in wanted], rel=0, abs=1e-12)
    np.testing.assert_array_equal(met.place[:, 2], np.array(planes)[met.what])
    # A slow drift across the way meets the plate after so many periods as it takes.
    out = start + way + (0.3, 0, 0)
    plate = RectangularAperture(kind="rectangular", half_widths=(0.25, 5), length=0.1, centre=(0, 0, 0.5))
    lost = flights(start, out, periodic).losses([native_aperture(plate)])
    for n, share in zip(lost.flight, lost.share, strict=True):
        x, z = start[n, 0] + 0.3 * share, (start[n, 2] + way[n, 2] * share + 1) % 2 - 1
        assert abs(x) >= 0.25 - 1e-9 and abs(z - 0.5) <= 0.05 + 1e-9
        points = start[n] + np.linspace(0, max(share - 1e-6, 0), 4001)[:, None] * (out[n] - start[n])
        points[:, 2] = (points[:, 2] + 1) % 2 - 1
        assert not in_solid(plate, points).any()
    assert len(lost) == 20


def test_a_particle_that_steps_over_a_periodic_face_is_recorded_once_on_either_side():
    periodic = Domain((-1, -1, -1), (1, 1, 1), (8, 8, 8), {"x": "open", "y": "open", "z": "periodic"})
    for step in (0.25, -0.25, 0.7, -1.3):
        z, counts = 0.5, np.zeros(3, int)
        for _ in range(40):
            way = flights([[0, 0, z]], [[0, 0, z + step]], periodic)
            met = way.crossings([_native.Screen(z) for z in (-1.0, 0.0, 1.0)], way.losses([]))
            counts += np.bincount(met.what, minlength=3)
            z = (z + step + 1) % 2 - 1
        assert np.all(np.abs(counts - 40 * abs(step) / 2) <= 1) and counts[0] == counts[2], (step, counts)


def test_a_solid_goes_on_behind_a_periodic_face():
    periodic = Domain((-1, -1, -1), (1, 1, 1), (8, 8, 8), {"x": "open", "y": "open", "z": "periodic"})
    across = RoundAperture(kind="round", radius=0.2, length=0.6, centre=(0, 0, 1))
    places = np.linspace(-0.99, 0.99, 67)
    start = np.stack([np.full(67, 0.5), np.zeros(67), places], axis=1)
    met = flights(start, start + np.array([0.1, 0, 0]), periodic).losses([native_aperture(across)])
    assert met.flight.tolist() == np.flatnonzero(np.abs(places) >= 0.7).tolist()
    assert met.what.tolist() == [0] * len(met)


@pytest.mark.mpi(ranks=(1, 3))
def test_a_flight_too_long_to_be_followed_is_refused_on_all_ranks(comm):
    scene = {
        "domain": {"lower": -1e-3, "upper": 1e-3, "cells": 8, "boundary": "periodic"},
        "background": "neutralizing",
        "bunches": [{"distribution": "gaussian", "species": "electron", "sigma": "0.1 mm", "charge": "-1 fC", "particles": 10,
                     "velocity": [0, 0, "0.5 c"]}],
        "refinement": {"levels": 0},
        "motion": {"kind": "leapfrog", "dt": "1 us"},
        "screens": [{"name": "here", "z": 0}],
        "schedule": {"steps": 1},
        "output": {"write": []},
    }  # fmt: skip
    simulation = Simulation(comm, Scene.from_dict(scene))
    with pytest.raises(ParticleError, match=r"7.57e\+04 periods of the domain in a step.*; shorten motion.dt"):
        simulation.advance()


@pytest.mark.parametrize("kind", ["round", "rectangular"])
def test_turned_apertures_and_screens_are_those_along_z_turned(kind):
    rng = np.random.default_rng(9)
    direction, centre = (0.5, -0.3, -0.8), (0.1, 0.2, -0.1)
    frame = np.array(axes(direction, 0.4))
    hole: dict[str, Any] = {"radius": 0.5} if kind == "round" else {"half_widths": (0.4, 0.7)}
    shape = RoundAperture if kind == "round" else RectangularAperture
    own = rng.uniform(-1, 1, (2, 300, 3))
    turned = [values @ frame + centre for values in own]
    straight, other = flights(own[0], own[1], WIDE), flights(turned[0], turned[1], WIDE)
    plain = shape(kind=kind, length=0.3, **hole)
    placed = shape(kind=kind, length=0.3, centre=centre, direction=direction, roll=0.4, **hole)
    screens = Screen(name="a", z=0.2), Screen(name="b", centre=tuple(0.2 * frame[2] + centre), direction=direction)
    pairs = [
        (straight.losses([native_aperture(plain)]), other.losses([native_aperture(placed)])),
        (straight.crossings([native_screen(screens[0])], NO), other.crossings([native_screen(screens[1])], NO)),
    ]
    for one, two in pairs:
        assert len(one) > 50 and np.array_equal(one.flight, two.flight)
        np.testing.assert_allclose(one.share, two.share, rtol=0, atol=1e-12)
        np.testing.assert_allclose(one.place @ frame + centre, two.place, rtol=0, atol=1e-12)
    reach = placed.model_copy(update={"reach": 0.8})
    found = other.losses([native_aperture(reach)])
    assert set(found.flight) == {n for n in pairs[0][0].flight if np.hypot(*own[0][n, :2]) <= 0.8}

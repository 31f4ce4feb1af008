"""Arrays in, field or kick out: right, in the caller's order, on any ranks."""

from __future__ import annotations

import copy
import pickle
from typing import Any

import numpy as np
import pytest
from mpi4py import MPI

import amrpic
from amrpic import _native
from amrpic.units import ELEMENTARY_CHARGE, PROTON_MASS, SPEED_OF_LIGHT, VACUUM_PERMITTIVITY
from exact.bunches import ellipsoid_field, gaussian_field, quiet_ellipsoid, quiet_gaussian

CHARGE = 1e-9  # C, of a bunch
SIZES = np.array([1e-3, 1e-3, 2e-3])


made: Any = amrpic.SpaceCharge


def engine(**settings) -> Any:
    return made(**{"cells": 16, "levels": 1, **settings})


def bunch(number: int = 2000, seed: int = 1) -> np.ndarray:
    """Places (n, 3) in m."""
    return np.random.default_rng(seed).normal(size=(number, 3)) * SIZES


def rms_error(found: np.ndarray, exact: np.ndarray) -> float:
    return np.sqrt(((found - exact) ** 2).sum(axis=1).mean() / (exact**2).sum(axis=1).max())


# ---- right ----
QUIET = {"compensation": "clouds-and-mesh"}
ROUND, FLAT, LONG = (1e-3 * np.array(sizes) for sizes in ((1, 1, 1), (50, 50, 1), (1, 1, 50)))
SHAPES: dict[
    str, Any
] = {  # sizes, settings, rms errors over the largest field: of 2^17 particles, and of 2^20 with finer cells
    "round": (ROUND, {}, {}, 4e-3),
    "flat": (FLAT, {}, {}, 5e-3),
    "long": (LONG, {}, {"cells": (32, 32, 64), "levels": 2}, 4e-3),
}


@pytest.mark.parametrize("shape", SHAPES)
def test_a_gaussian_bunch_has_its_exact_field(shape, long):
    sizes, short_settings, settings, bound = SHAPES[shape]
    number = 2**20 if long else 2**17
    places = quiet_gaussian(number, sizes)
    found = made(**QUIET, **(settings if long else short_settings)).field(*places.T, CHARGE / number)
    some = slice(None, None, number // 2000)
    assert rms_error(found[some], gaussian_field(places[some], sizes, CHARGE)) < (1e-3 if long else bound)


def test_an_even_ellipsoid_has_its_exact_field_inside(long):
    axes, number = 1e-3 * np.array([1.0, 1.5, 2.0]), 2**20 if long else 2**17
    places = quiet_ellipsoid(number, axes)
    inside = np.flatnonzero(((places / axes) ** 2).sum(axis=1) < 0.75**2)[:: number // 4000]
    finer = {"levels": 1} if long else {}  # fewer particles make more noise there than the mesh errs
    found = made(**finer, **QUIET).field(*places.T, CHARGE / number)
    assert rms_error(found[inside], ellipsoid_field(places[inside], axes, CHARGE)) < (1e-3 if long else 4e-3)


def test_the_field_of_a_fast_bunch_is_that_at_rest_transformed():
    places, gamma = bunch() / (1, 1, 30), 30.0
    at_rest = engine().field(*(places * (1, 1, gamma)).T, CHARGE)
    electric, magnetic = engine().field(*places.T, CHARGE, gamma, magnetic=True)
    assert electric == pytest.approx(at_rest * (gamma, gamma, 1), rel=1e-9, abs=1e-9 * np.abs(at_rest).max())
    beta = np.sqrt(1 - gamma**-2)
    assert magnetic == pytest.approx(np.cross([0, 0, beta / SPEED_OF_LIGHT], electric))


def test_a_kick_is_the_force_over_the_reference_momentum_times_the_time():
    places, gamma, ratio, length = bunch(), 1.5, ELEMENTARY_CHARGE / PROTON_MASS, 0.7
    beta = np.sqrt(1 - gamma**-2)
    electric, magnetic = engine().field(*places.T, CHARGE, gamma, magnetic=True)
    force = electric + np.cross([0, 0, beta * SPEED_OF_LIGHT], magnetic)  # per charge
    expected = ratio * force * length / (beta * SPEED_OF_LIGHT) / (gamma * beta * SPEED_OF_LIGHT)
    found = engine().kick(*places.T, CHARGE, length, beta, gamma, ratio)
    assert found == pytest.approx(expected, rel=1e-9, abs=1e-9 * np.abs(expected).max())
    each = engine().kick(*places.T, CHARGE, length, beta, gamma, np.full(len(places), -ratio))
    assert each == pytest.approx(-found, rel=1e-12)


def test_a_particle_pushes_others_and_not_itself():
    assert np.abs(engine().field([1.0], [2.0], [-3.0], CHARGE)).max() == 0
    alone = engine().field([1.0], [2.0], [-3.0], CHARGE, at=[(1.0, 1.001), (2.0, 2.0), (-3.0, -3.0)])
    assert alone[1, 0] == pytest.approx(CHARGE / (4 * np.pi * VACUUM_PERMITTIVITY * 1e-3**2), rel=0.03)


def test_charges_of_both_signs_attract():
    found = engine().field([0.0, 1e-3], [0, 0], [0, 0], [CHARGE, -CHARGE])
    expected = CHARGE / (4 * np.pi * VACUUM_PERMITTIVITY * 1e-3**2)
    assert found[:, 0] == pytest.approx([expected, expected], rel=0.03)


def test_no_charge_and_no_particles_have_no_field():
    assert (engine().field(*bunch(10).T, 0.0) == 0).all()
    assert engine().field([], [], [], 0.0).shape == (0, 3)
    assert (engine().field(*bunch(10).T, CHARGE, alive=np.zeros(10, dtype=bool)) == 0).all()


def test_a_wall_mirrors_the_charge():
    """A ball of charge before a grounded plane is pulled by its image, as a point would be."""
    domain = amrpic.Domain(-1, 1, 32, {"x": ("dirichlet", "open")})
    places = quiet_ellipsoid(2**12, np.array([0.1, 0.1, 0.1])) - (0.7, 0, 0)
    places[0] = 5.0
    found = made(domain, levels=2).field(*places.T, CHARGE / len(places))
    assert found[1:, 0].mean() == pytest.approx(-CHARGE / (4 * np.pi * VACUUM_PERMITTIVITY * 0.6**2), rel=0.02)
    assert (found[0] == 0).all()


def test_what_lies_outside_a_given_domain_is_counted():
    charges = made(amrpic.Domain(-1, 1, 8), levels=0)
    charges.field([0.0, 5.0, 0.1], [0.0] * 3, [0.0] * 3, CHARGE)
    assert charges.outside == 1


def test_levels_are_those_of_what_lies_in_a_domain_whichever_images_it_is_given_by():
    domain = amrpic.Domain(-0.02, 0.02, 16, {"x": "dirichlet", "y": "dirichlet", "z": "periodic"})
    places, turn = bunch(500), np.random.default_rng(2).integers(-9, 10, 500)
    levels, found = [], []
    for middle, images, strays in ((0.0, 0, 0), (0.02, 0, 0), (0.0, turn, 0), (0.0, 0, 3)):
        charges, moved = made(domain), places + np.array((0, 0, 1.0)) * (middle + 0.04 * np.reshape(images, (-1, 1)))
        moved[:strays, 0] = 1e3
        found.append(charges.field(*moved.T, CHARGE))
        levels.append(charges.hierarchy.levels)
    assert levels == [levels[0]] * 4 and levels[0] > 2
    for other in found[1:3]:
        assert other == pytest.approx(found[0], abs=1e-3 * np.abs(found[0]).max())


def test_a_long_beam_repeats():
    """An even round beam that fills its period along z: E = λ r/(2πε₀R²) inside."""
    radius, period, number = 1e-3, 0.1, 2**15
    u = quiet_ellipsoid(number, np.array([1.0, 1.0, 1.0]))
    angle, part = np.arctan2(u[:, 1], u[:, 0]), (u**2).sum(axis=1) ** 1.5  # of even places along a radius
    x, y = radius * np.sqrt(part) * np.cos(angle), radius * np.sqrt(part) * np.sin(angle)
    z = period * (np.arange(number) * 0.6180339887498949 % 1)
    domain = amrpic.Domain((-3e-3, -3e-3, 0), (3e-3, 3e-3, period), (32, 32, 8), {"z": "periodic"})
    found = made(domain, levels=1).field(x, y, z, CHARGE / number, gamma=2.0)
    inside = x**2 + y**2 < (0.8 * radius) ** 2
    expected = CHARGE / period / (2 * np.pi * VACUUM_PERMITTIVITY * radius**2)
    slope = (found[inside, 0] @ x[inside]) / (x[inside] @ x[inside])
    assert slope == pytest.approx(expected, rel=0.01)


# ---- in the caller's order ----
def test_places_are_those_of_the_particles_or_any_others():
    places = bunch()
    charges = engine(compensation="none")
    at_particles = charges.field(*places.T, CHARGE)
    assert charges.field(*places.T, CHARGE, at=places) == pytest.approx(at_particles, rel=1e-3, abs=1e3)
    assert charges.field(*places.T, CHARGE, at=list(places[:7].T)).shape == (7, 3)


def test_shuffled_particles_get_the_same_field_to_rounding():
    places = bunch()
    shuffle = np.random.default_rng(3).permutation(len(places))
    found, other = engine().field(*places.T, CHARGE), engine().field(*places[shuffle].T, CHARGE)
    assert np.abs(other - found[shuffle]).max() < 1e-12 * np.abs(found).max()


@pytest.mark.mpi(ranks=(1, 2), more=(3,))
def test_whoever_holds_them_reproducible_results_are_the_same(comm):
    places = bunch()
    charge = np.where(np.arange(len(places)) % 3 == 0, 2.0, 1.0) * CHARGE
    found = []
    for seed in (1, 2):
        parts = np.array_split(np.random.default_rng(seed).permutation(len(places)), comm.size + 1)[
            comm.rank :: comm.size
        ]
        mine = np.concatenate(parts)
        charges = engine(reproducible=True, comm=comm)
        for shift in (0.0, 1e-5):
            out = charges.field(*(places[mine] + shift).T, charge[mine])
        all_ = np.empty_like(places)
        all_[np.concatenate(comm.allgather(mine))] = np.concatenate(comm.allgather(np.array(out)))
        found.append(all_)
    assert (found[0] == found[1]).all()


@pytest.mark.mpi(ranks=(2, 3), more=(4,))
def test_results_come_back_to_the_rank_and_place_of_the_particle(comm):
    places = bunch()
    mine = np.flatnonzero(np.arange(len(places)) % 5 % comm.size == comm.rank)
    alive = np.ones(len(mine), dtype=bool)
    alive[::7] = comm.rank > 0
    living = np.ones(len(places), dtype=bool)
    living[np.concatenate(comm.allgather(mine[~alive]))] = False
    together, alone = engine(comm=comm, tolerance=1e-13), engine(comm=MPI.COMM_SELF, tolerance=1e-13)
    for shift in (0.0, 1e-5, 3e-5):
        found = together.field(*(places[mine] + shift).T, CHARGE, alive=alive)
        expected = alone.field(*(places + shift).T, CHARGE, alive=living)
        assert np.abs(found - expected[mine]).max() < 1e-12 * np.abs(expected).max()
        elsewhere = together.field(*(places[mine] + shift).T, CHARGE, at=places[mine[:5]], alive=alive)
        assert elsewhere == pytest.approx(alone.field(*(places + shift).T, CHARGE, at=places[mine[:5]], alive=living))


@pytest.mark.mpi(ranks=(2,))
def test_a_rank_may_bring_nothing(comm):
    places = bunch() if comm.rank == 1 else np.zeros((0, 3))
    found = engine(comm=comm).field(*places.T, CHARGE)
    assert found.shape == places.shape
    if comm.rank == 1:
        assert np.abs(found).min() > 0


def test_arrays_of_any_stride_and_kind_are_read():
    places = bunch()
    found = engine().field(*places.T, CHARGE)
    columns = np.ascontiguousarray(places.T)
    assert engine().field(*columns, np.full(len(places), CHARGE)) == pytest.approx(found, rel=1e-9, abs=1e-3)
    assert engine().field(*columns[:, ::-1], CHARGE)[::-1] == pytest.approx(found, rel=1e-9, abs=1e-3)
    single = engine().field(*places.T.astype(np.float32), np.float32(CHARGE))
    assert single.dtype == np.float64 and single == pytest.approx(found, rel=1e-2, abs=1e-3 * np.abs(found).max())
    columns.flags.writeable = False
    assert engine().field(*columns, CHARGE).shape == places.shape


def test_arrays_are_left_as_they_are():
    places = bunch()
    columns, before = places.T.copy(), places.T.copy()
    for _ in range(3):
        engine().field(*columns, CHARGE)
    assert (columns == before).all()


def test_what_does_not_live_may_hold_anything():
    places = bunch()
    alive = np.arange(len(places)) % 4 > 0
    expected = engine().field(*places[alive].T, CHARGE)
    places[~alive] = np.nan
    charges = engine()
    for _ in range(2):
        found = charges.field(*places.T, CHARGE, alive=alive)
        assert (found[~alive] == 0).all() and found[alive] == pytest.approx(
            expected, rel=1e-3, abs=1e-3 * np.abs(found).max()
        )
    ratios = np.where(alive, 1e8, np.nan)
    kicks = charges.kick(*places.T, CHARGE, 1.0, 0.6, 1.25, ratios, alive=alive)
    assert (kicks[~alive] == 0).all() and (kicks[alive] != 0).all()
    fewer = alive & (np.arange(len(places)) % 3 > 0)
    assert (charges.field(*places.T, CHARGE, alive=fewer)[~fewer] == 0).all()
    assert charges.field(*places[alive].T, CHARGE) == pytest.approx(expected, rel=1e-2, abs=1e-2 * np.abs(found).max())


# ---- call after call ----
def test_a_bunch_that_drifts_costs_no_new_mesh():
    charges, places = engine(regrid_every=0), bunch()
    first = charges.field(*places.T, CHARGE)
    mesh = charges.hierarchy
    for metre in range(1, 5):
        moved = charges.field(*(places + np.array((0, 0, metre))).T, CHARGE)
    assert charges.hierarchy is mesh and charges.centre[2] == pytest.approx(4, abs=1e-3)
    assert np.abs(moved - first).max() < 0.05 * np.abs(first).max()


def test_a_bunch_that_grows_or_shrinks_gets_a_mesh_that_fits():
    charges, places = engine(regrid_every=2), bunch()
    widths = []
    for scale in (1, 1, 10, 10, 0.01, 0.01, 0.01):
        charges.field(*(scale * places).T, CHARGE)
        widths.append(charges.hierarchy.spacing(0)[0])
    assert widths[2] > 5 * widths[0] and widths[-1] < 0.1 * widths[0]


def test_a_bunch_that_is_far_smaller_than_the_last_one_has_its_own_field_at_once():
    charges, places = engine(regrid_every=0), bunch()
    expected = engine().field(*places.T, CHARGE)
    charges.field(*(20 * places).T, CHARGE)
    assert charges.field(*places.T, CHARGE) == pytest.approx(expected, abs=1e-6 * np.abs(expected).max())
    charges.field(*places.T, CHARGE, gamma=20.0)
    assert charges.field(*places.T, CHARGE) == pytest.approx(expected, abs=1e-6 * np.abs(expected).max())


@pytest.mark.parametrize("others", [[[0.3, 0, 0]], [[0, 0, -10.0]], [[1e3, 1e3, 0]], "a bunch"])
def test_what_is_far_out_leaves_the_field_of_a_bunch_as_it_is(others):
    """A stray particle, or a second bunch 1 m away."""
    sizes, number = np.full(3, 1e-3), 2**13
    bunch = quiet_gaussian(number, sizes)
    places = np.concatenate([bunch, bunch + np.eye(3)[0] if others == "a bunch" else np.array(others)])
    x, y, z = places.T
    field = amrpic.SpaceCharge().field(x, y, z, 1e-9 / number)[:number]
    exact = gaussian_field(bunch, sizes, 1e-9)
    assert ((field - exact) ** 2).sum(axis=1).mean() < 0.07**2 * (exact**2).sum(axis=1).max()


def test_a_slow_ramp_of_gamma_costs_no_new_mesh():
    charges, places = engine(regrid_every=0), bunch()
    charges.field(*places.T, CHARGE, gamma=2.0)
    mesh = charges.hierarchy
    for gamma in np.linspace(2.0, 2.01, 5):
        found = charges.field(*places.T, CHARGE, gamma=gamma)
    assert charges.hierarchy is mesh
    assert found == pytest.approx(engine().field(*places.T, CHARGE, gamma=2.01), abs=0.02 * np.abs(found).max())


def test_many_calls_need_no_more_memory(long):
    charges, places = engine(), bunch(20_000)
    rng = np.random.default_rng(1)
    held = []
    for call in range(1000 if long else 120):
        charges.kick(*(places + 1e-5 * rng.normal(size=3)).T, CHARGE, 1.0, 0.6, 1.25, 1e8)
        if call >= 40:
            held.append(resident())
    assert held[-1] < held[0] + 8e6


def test_the_memory_of_a_call_is_kept_for_the_next():
    charges, places = engine(), bunch(100_000)
    for _ in range(2):
        charges.field(*places.T, CHARGE)
    assert _native.idle_bytes() > 10 * 8 * len(places)


def resident() -> int:
    with open("/proc/self/statm", encoding="ascii") as file:
        return int(file.read().split()[1]) * 4096


@pytest.mark.parametrize("copied", [copy.copy, copy.deepcopy, lambda one: pickle.loads(pickle.dumps(one))])
def test_copies_have_the_settings_and_a_mesh_of_their_own(copied):
    charges, places = engine(rule={"kind": "charge-density", "relative": 0.05}, tolerance=1e-9), bunch()
    found = charges.field(*places.T, CHARGE)
    other = copied(charges)
    assert other.hierarchy is None and (other.field(*places.T, CHARGE) == found).all()


# ---- what is refused ----


BAD = {
    "x (5) and y (4)": lambda p: p.field(np.zeros(5), np.zeros(4), np.zeros(5), 1.0),
    "two dimensions": lambda p: p.field(np.zeros((5, 1)), np.zeros((5, 1)), np.zeros((5, 1)), 1.0),
    "a number for x": lambda p: p.field(0.0, 0.0, 0.0, 1.0),
    "charge of another length": lambda p: p.field(np.zeros(5), np.zeros(5), np.zeros(5), np.zeros(4)),
    "complex": lambda p: p.field(np.zeros(5, complex), np.zeros(5), np.zeros(5), 1.0),
    "words": lambda p: p.field(["a"], ["b"], ["c"], 1.0),
    "objects": lambda p: p.field([None], [None], [None], 1.0),
    "ragged": lambda p: p.field([[1.0], [1.0, 2.0]], [0.0], [0.0], 1.0),
    "nan": lambda p: p.field([0.0, np.nan], [0.0, 1.0], [0.0, 1.0], 1.0),
    "inf": lambda p: p.field([0.0, np.inf], [0.0, 1.0], [0.0, 1.0], 1.0),
    "1e300": lambda p: p.field([0.0, 1e300], [0.0, 1.0], [0.0, 1.0], 1.0),
    "nan charge": lambda p: p.field([0.0, 1.0], [0.0, 1.0], [0.0, 1.0], np.nan),
    "charge of 1e300": lambda p: p.field([0.0, 1e-9], [0.0, 1.0], [0.0, 1.0], 1e300),
    "masked": lambda p: p.field(np.ma.masked_array([0.0], [True]), [0.0], [0.0], 1.0),
    "alive of another length": lambda p: p.field([0.0], [0.0], [0.0], 1.0, alive=np.ones(2, dtype=bool)),
    "alive of numbers": lambda p: p.field([0.0], [0.0], [0.0], 1.0, alive=[1]),
    "gamma below 1": lambda p: p.field([0.0], [0.0], [0.0], 1.0, gamma=0.5),
    "gamma of 1e300": lambda p: p.field([0.0], [0.0], [0.0], 1.0, gamma=1e300),
    "gamma of an array": lambda p: p.field([0.0], [0.0], [0.0], 1.0, gamma=[1.0]),
    "two arrays of places": lambda p: p.field([0.0], [0.0], [0.0], 1.0, at=([0.0], [0.0])),
    "places that are nan": lambda p: p.field([0.0], [0.0], [0.0], 1.0, at=([0.0], [np.nan], [0.0])),
    "beta that does not fit": lambda p: p.kick([0.0], [0.0], [0.0], 1.0, 1.0, 0.5, 3.0, 1.0),
    "length nan": lambda p: p.kick([0.0], [0.0], [0.0], 1.0, np.nan, 0.6, 1.25, 1.0),
    "charge to mass nan": lambda p: p.kick([0.0], [0.0], [0.0], 1.0, 1.0, 0.6, 1.25, np.nan),
    "one charge to mass inf": lambda p: p.kick([0.0, 1.0], [0.0] * 2, [0.0] * 2, 1.0, 1.0, 0.6, 1.25, [1.0, np.inf]),
    "charge to mass": lambda p: p.kick([0.0], [0.0], [0.0], 1.0, 1.0, 0.6, 1.25, [1.0, 2.0]),
}


@pytest.mark.mpi(ranks=(1, 2))
def test_bad_arrays_are_refused_in_one_sentence(comm):
    charges, places = engine(comm=comm), bunch(100)
    for what, call in BAD.items():
        with pytest.raises(amrpic.AmrpicError) as refused:
            call(charges)
        assert "\n" not in str(refused.value) and len(str(refused.value)) < 300, what
        # and on one rank alone, while others give a bunch
        if comm.size > 1:
            with pytest.raises(amrpic.AmrpicError):
                if comm.rank == 1:
                    call(charges)
                elif "beta" in what or "length nan" in what or "to mass" in what:
                    charges.kick(*places.T, CHARGE, 1.0, 0.6, 1.25, 1.0)
                else:
                    charges.field(*places.T, CHARGE, at=places if "places" in what else None)
        assert charges.field(*places.T, CHARGE).shape == places.shape


@pytest.mark.mpi(ranks=(2,))
def test_ranks_must_ask_for_the_same(comm):
    charges, places = engine(comm=comm), bunch(100)
    with pytest.raises(amrpic.InputError, match="ranks differ"):
        charges.field(*places.T, CHARGE, gamma=1.0 + comm.rank)
    with pytest.raises(amrpic.InputError, match="ranks differ"):
        charges.field(*places.T, CHARGE, at=places if comm.rank else None)


@pytest.mark.parametrize(
    ("settings", "what"),
    [
        ({"domain": "closed"}, "domain is 'closed'"),
        ({"form": "2.5d"}, "form is '2.5d'"),
        ({"cells": 1}, "cells"),
        ({"domain": amrpic.Domain(0, 1, 8), "cells": 4}, "leave cells out"),
        ({"levels": -1}, "levels"),
        ({"levels": "many"}, "levels"),
        ({"rule": {"kind": "momentum", "relative": 0.5}}, "momenta"),
        ({"rule": {"kind": "unknown"}}, "rule"),
        ({"tolerance": 2.0}, "tolerance"),
        ({"regrid_every": -1}, "regrid_every"),
        ({"compensation": "much"}, "compensation"),
        ({"shape": "square"}, "shape"),
    ],
)
def test_settings_that_make_no_sense_are_refused(settings, what):
    with pytest.raises(amrpic.InputError, match=what):
        made(**settings)


def test_a_density_beyond_double_precision_is_refused_by_the_size():
    with pytest.raises(amrpic.InputError, match="lie within 2e-150 m"):
        engine().field([0.0, 1e-150], [0.0, 2e-150], [0.0, 0.0], 1e-9)


def test_walls_across_a_fast_bunch_are_refused():
    charges = made(amrpic.Domain(-1, 1, 8, {"z": "dirichlet"}), levels=0)
    assert charges.field([0.1], [0.0], [0.0], CHARGE).shape == (1, 3)
    with pytest.raises(amrpic.InputError, match="across z"):
        charges.field([0.1], [0.0], [0.0], CHARGE, gamma=3.0)


def test_a_net_charge_that_no_potential_balances_is_refused():
    charges = made(amrpic.Domain(-1, 1, 8, "periodic"), levels=0)
    with pytest.raises(amrpic.SolverError, match="net charge"):
        charges.field([0.1], [0.0], [0.0], CHARGE)
    assert np.abs(charges.field([0.1, 0.5], [0.0, 0.0], [0.0, 0.0], [CHARGE, -CHARGE])).max() > 0


def test_a_function_may_say_what_is_refined():
    charges = engine(rule=lambda rho, hysteresis: np.abs(rho) > 0)
    charges.field(*bunch().T, CHARGE)
    assert charges.hierarchy.levels == 2

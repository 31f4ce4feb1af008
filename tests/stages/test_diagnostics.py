"""Diagnostics against closed forms, on one rank and on two."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest

from amrpic import Domain, Field, Hierarchy, VectorField
from amrpic.particles.particles import Particles
from amrpic.particles.species import SPECIES, SpeciesTable
from amrpic.stages import diagnostics
from amrpic.units import ELECTRON_MASS, SPEED_OF_LIGHT, VACUUM_PERMITTIVITY

DOMAIN = Domain(lower=(-1, -1, -2), upper=(1, 1, 2), cells=(16, 16, 32), boundary="dirichlet")
ELECTRONS = SpeciesTable((SPECIES["electron"],))
LEVELS = [[((8, 8, 8), (23, 23, 47))]]


def share(comm, values):
    """This rank's part of what all ranks hold together."""
    return np.array_split(values, comm.size)[comm.rank]


def uniform(hierarchy, value):
    return Field(hierarchy).fill(lambda x, y, z: value)


def electrons(comm, position, momentum, weight):
    position, momentum, weight = (share(comm, v) for v in (position, momentum, weight))
    return Particles(position, momentum, weight, np.arange(len(weight)), ELECTRONS)


@pytest.mark.mpi(ranks=(1, 2))
def test_energies_count_every_place_once(comm):
    hierarchy = Hierarchy(comm, DOMAIN, LEVELS, max_grid_size=16, blocking_factor=8)
    ones = [uniform(hierarchy, value) for value in (1.0, 2.0, 3.0)]
    for field in ones:
        for patch in field.patches:
            patch.data[patch.covered] = np.nan
    energy = 0.5 * VACUUM_PERMITTIVITY * (1 + 4 + 9) * 16
    assert diagnostics.field_energy(VectorField(*ones)) == pytest.approx(energy, rel=1e-13, abs=0)
    assert diagnostics.potential_energy(ones[0], ones[2]) == pytest.approx(0.5 * 3 * 16, rel=1e-13, abs=0)


@pytest.mark.mpi(ranks=(1, 2))
def test_moments_are_those_of_the_distribution_also_far_from_the_origin(comm):
    random = np.random.default_rng(5)
    x, p = random.normal(size=(2, 1000, 3))
    p[:, 1] += 3 * x[:, 1]  # a correlation, which the emittance does not see
    weight = random.random(1000)
    size = np.array([1e-3, 2e-3, 3e-3])
    beam = electrons(comm, 1e5 + size * x, 1e-22 * (7 + p), weight)
    found = diagnostics.moments(comm, beam)
    mean = np.average(size * x, axis=0, weights=weight)
    covariance = [np.cov(np.stack([size[i] * x[:, i], 1e-22 * p[:, i]]), aweights=weight, ddof=0) for i in range(3)]
    np.testing.assert_allclose(found.mean, 1e5 + mean, rtol=1e-13)
    np.testing.assert_allclose(found.rms, [c[0, 0] ** 0.5 for c in covariance], rtol=1e-6)
    area = [np.sqrt(np.linalg.det(c)) for c in covariance]
    np.testing.assert_allclose(found.emittance, np.array(area) / (ELECTRON_MASS * SPEED_OF_LIGHT), rtol=1e-6)


@pytest.mark.mpi(ranks=(1, 2, 3))
def test_a_far_halo_takes_no_digits_from_the_emittance_of_few_or_many(comm):
    random = np.random.default_rng(6)
    for count in (7, 8, 9, 1003):
        x, p = 1e-3 * random.normal(size=(count, 3)), 1e-24 * random.normal(size=(count, 3))
        x[0] = 3.0  # the first of them, at a thousand sizes of the core
        p += 1e-21 * x  # emittance is a small difference of large products
        for weight in (np.broadcast_to(2.0, count), 0.5 + random.random(count)):
            found = diagnostics.moments(comm, electrons(comm, x, p, weight))
            exact = [a.astype(np.longdouble) for a in (x, p / (ELECTRON_MASS * SPEED_OF_LIGHT))]
            dx, du = (a - np.average(a, axis=0, weights=weight.astype(np.longdouble)) for a in exact)
            xx, uu, xu = ((a * weight[:, None]).sum(axis=0) / weight.sum() for a in (dx * dx, du * du, dx * du))
            np.testing.assert_allclose(found.rms, np.sqrt(xx).astype(float), rtol=1e-13)
            digits_lost = (xx * uu / (xx * uu - xu**2)).astype(float)
            np.testing.assert_array_less(
                np.abs(found.emittance / np.sqrt(xx * uu - xu**2).astype(float) - 1), 1e-14 * digits_lost
            )
            np.testing.assert_allclose(
                found.momentum, weight @ p, rtol=0, atol=1e-13 * np.abs(weight @ np.abs(p)).max()
            )


@pytest.mark.mpi(ranks=(1, 2))
def test_kinetic_energy_is_exact_for_slow_and_fast_particles(comm):
    rest = ELECTRON_MASS * SPEED_OF_LIGHT**2
    for gamma_beta in (1e-9, 1e-3, 1.0, 1e3):
        momentum = np.zeros((6, 3))
        momentum[:, 1] = gamma_beta * ELECTRON_MASS * SPEED_OF_LIGHT
        beam = electrons(comm, np.zeros((6, 3)), momentum, np.full(6, 2.5))
        exact = gamma_beta**2 / 2 if gamma_beta < 1e-8 else np.hypot(1, gamma_beta) - 1
        relative = 1e-9 if gamma_beta == 1e-3 else 1e-14  # there the plain formula is the one that loses digits
        assert diagnostics.moments(comm, beam).kinetic_energy == pytest.approx(15 * rest * exact, rel=relative, abs=0)


@pytest.mark.mpi(ranks=(1, 2))
def test_a_state_without_particles_can_be_measured(comm):
    hierarchy = Hierarchy(comm, DOMAIN, LEVELS, max_grid_size=16, blocking_factor=8)
    nothing = Field(hierarchy)
    beam = Particles.empty(ELECTRONS)
    seconds = {"solve": 1.0 + comm.rank}
    moments = diagnostics.moments(comm, beam)
    row = diagnostics.measure(
        beam, moments, (0, 0.0), nothing, nothing, VectorField(nothing, nothing, nothing), seconds
    )
    assert (row["particles"], row["charge"], row["field_energy"], row["kinetic_energy"]) == (0, 0, 0, 0)
    assert np.isnan(row["rms_x"])
    assert row["seconds_solve"] == comm.size
    assert row["memory"] > 1e6
    known = [quantity.name for quantity in diagnostics.quantities(3)]
    assert set(row) <= set(known)
    assert set(known) - set(row) == {
        "step",
        "time",
        "s",
        "window_x",
        "window_y",
        "window_z",
        "regridded",
        "cycles",
        "residual",
        "seconds",
        "cells_2",
    }


def test_the_page_defines_every_column_of_the_series():
    page = (Path(__file__).parents[2] / "docs" / "diagnostics.md").read_text()
    rows = page[page.index("| columns of `series.csv`") :].split("\n\n")[0].splitlines()[2:]
    names = {name.replace("*", r"\w+") for row in rows for name in re.findall(r"`([^`]+)`", row.split("|")[1])}
    names |= {
        name.rpartition("_")[0] + "_[xyz0-9]" for name in names
    }  # momentum_x … stands for all axes, cells_0 for levels
    for column in diagnostics.quantities(4):
        assert any(re.fullmatch(name, column.name) for name in names), column.name
    for energy in ("kinetic", "potential", "field"):
        assert any(f"`{energy}_energy`" in row and "$" in row for row in rows)


@pytest.mark.mpi(ranks=(1, 2, 3, 4))
def test_moments_do_not_depend_on_where_a_period_is_cut(comm):
    """A beam moved by any length, and folded into the domain, is as large as before."""
    random = np.random.default_rng(8)
    length = np.array([0.04, 0.06, 0.08])
    domain = Domain((-0.01, 0, 3), (0.03, 0.06, 3.08), 16, {"x": "periodic", "y": "dirichlet", "z": "periodic"})
    lower, middle = np.array(domain.lower), (np.array(domain.lower) + domain.upper) / 2
    for count in (2, 3, 1003):
        x = np.array([3e-3, 2e-3, 6e-3]) * random.normal(size=(count, 3)).clip(-3, 3)
        p = 1e-23 * random.normal(size=(count, 3)) + 2e-21 * x
        weight = 0.5 + random.random(count)
        wanted = diagnostics.moments(comm, electrons(comm, middle + x, p, weight))
        for shift in ((0, 0, 0), (0.5, 0, 0.5), (0.49, 0, -0.2), (7.3, 0, -12.9)):
            moved = middle + x + length * shift
            moved[:, ::2] = lower[::2] + (moved - lower)[:, ::2] % length[::2]
            found = diagnostics.moments(comm, electrons(comm, moved, p, weight), domain=domain)
            np.testing.assert_allclose(found.rms, wanted.rms, rtol=1e-9)
            np.testing.assert_allclose(found.emittance, wanted.emittance, rtol=1e-7, atol=1e-10)  # of two: 0
            apart = (found.mean - wanted.mean) / length - shift
            np.testing.assert_allclose(apart - np.rint(apart) * (1, 0, 1), 0, atol=1e-11)
            assert np.all((found.mean >= domain.lower) & (found.mean < domain.upper))
            assert found.fill[1] == 0 and np.all(found.fill[[0, 2]] > 0)
    np.testing.assert_allclose(found.fill[[0, 2]], (wanted.rms / length)[[0, 2]], rtol=0.02)


@pytest.mark.mpi(ranks=(1, 2, 4))
def test_a_beam_that_fills_its_period_is_measured_as_it_lies_in_the_domain(comm):
    """Nothing else is the same on all ranks: where noise would cut it, rounding would move particles by a period."""
    domain = Domain(0, 1, 16, "periodic")
    for x in (np.random.default_rng(9).random((5000, 3)), np.indices((16, 16, 16)).reshape(3, -1).T / 16):
        beam = electrons(comm, x, np.zeros_like(x), np.ones(len(x)))
        inside, found = diagnostics.moments(comm, beam), diagnostics.moments(comm, beam, domain=domain)
        assert np.array_equal(found.mean, inside.mean) and np.array_equal(found.rms, inside.rms)
        assert np.all(found.fill > 1 / 6)

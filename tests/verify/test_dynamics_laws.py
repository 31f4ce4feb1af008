"""The laws that moving particles are verified against, by themselves and in small runs."""

from __future__ import annotations

import numpy as np
import pytest
from mpi4py import MPI

from amrpic.units import ELEMENTARY_CHARGE
from amrpic.verify.described import before_shift
from exact import orbits, passages
from verify import plasma, two_frames


@pytest.mark.parametrize("shape, order", [("cloud-in-cell", 2), ("triangular-shaped-cloud", 3)])
@pytest.mark.parametrize("kh", [0.1, 0.5, 1.5, 3.0])
def test_dispersion_of_the_mesh_is_the_sum_over_its_aliases(shape, order, kh):
    every = kh + 2 * np.pi * np.arange(-1000, 1001)
    clouds = (np.sin(every / 2) / (every / 2)) ** order
    square = np.sin(kh) / (2 * np.sin(kh / 2)) ** 2 * (every * clouds**2).sum()
    assert plasma.mesh_frequency(kh, shape, 1e-6) == pytest.approx(np.sqrt(square), rel=1e-6)


def test_leapfrog_raises_a_frequency_by_a_24th_of_the_angle_squared():
    ratio = plasma.mesh_frequency(0.5, "cloud-in-cell", 0.1) / plasma.mesh_frequency(0.5, "cloud-in-cell", 1e-6)
    assert ratio - 1 == pytest.approx(0.1**2 / 24 * np.cos(0.25) ** 2, rel=1e-2)


@pytest.mark.parametrize("k, root", [(0.5, 1.4157 - 0.1534j), (0.3, 1.1598 - 0.0126j)])
def test_landau_root_is_that_of_tables(k, root):
    assert plasma.landau_root(k) == pytest.approx(root, abs=1e-4)


def test_what_a_shift_has_moved_is_found_again():
    places = np.linspace(0, 6, 50)
    assert before_shift(places + 0.5 * np.sin(1.5 * places), 0.5, 1.5) == pytest.approx(places, abs=1e-14)


def test_a_wave_is_fitted_to_rounding_where_phase_and_rate_are_next_to_nothing():
    time, wave = 0.2 * np.arange(158), (-1.0, -1.8e-8, 0.98236, 7e-11)
    found = plasma.fitted_wave(time, plasma.damped(time, *wave), (-1.0, 0.0, 1.0, 0.0))
    assert found == pytest.approx(wave, rel=1e-12, abs=1e-13)  # 1e-9 with differences of the parameters


@pytest.mark.mpi(ranks=(1, 2))
def test_a_cold_plasma_has_the_frequency_of_the_mesh(comm):
    k = 2 * np.pi * 8 / plasma.LENGTH
    places = plasma.even((256, 8, 8))
    places[:, 0] += 0.01 / k * np.sin(k * places[:, 0])
    time, wave = plasma.wave_of(comm, places, np.zeros_like(places), 1e8, 0.2, 60, waves=8)
    *_, found, rate = plasma.fitted_wave(time, wave.real, (wave[0].real, 0.0, 1.0, 0.0))
    assert found == pytest.approx(plasma.mesh_frequency(np.pi / 4, "cloud-in-cell", 0.2), rel=1e-4)
    assert abs(rate) < 1e-5


@pytest.mark.mpi(ranks=(1, 2))
def test_a_boosted_run_is_the_run_at_rest(comm):
    at_rest, fast = (two_frames.sizes(comm, gamma, cells=16, particles=5000, steps=12) for gamma in (1.0, 20.0))
    assert at_rest[-1, 0] > 1.2 * at_rest[0, 0]
    assert fast * (1, 1, 20) == pytest.approx(at_rest, rel=1e-3)


def test_frames_change_momenta_as_lorentz_has_it():
    u, beta = np.random.default_rng(1).normal(0, 3, (5, 3)), np.full(5, 0.8)
    there = orbits.boosted(u, beta)
    assert orbits.boosted(there, -beta) == pytest.approx(u)
    energy = np.sqrt(1 + (u**2).sum(axis=1))
    assert np.sqrt(1 + (there**2).sum(axis=1)) == pytest.approx((energy - 0.8 * u[:, 0]) / 0.6)


@pytest.mark.parametrize("kind", ["solenoid", "dipole"])
def test_edges_keep_the_magnitude_of_momenta_and_canonical_ones(kind):
    rng = np.random.default_rng(2)
    x, u = rng.normal(0, 1e-2, (20, 3)), rng.normal((0, 0, 1), 0.3, (20, 3))
    out = passages.past_edge(passages.HARD[kind], x, u, 1)
    assert np.linalg.norm(out, axis=1) == pytest.approx(np.linalg.norm(u, axis=1))
    if kind == "solenoid":  # the canonical angular momentum, q B r²/2 more inside
        gained = x[:, 0] * (out - u)[:, 1] - x[:, 1] * (out - u)[:, 0]
        assert gained == pytest.approx(-ELEMENTARY_CHARGE * 0.5 / 2 * (x[:, :2] ** 2).sum(axis=1) / passages.MC)
    else:  # small angles: vertical focusing by y tan(angle), as of any hard edge
        assert (out - u)[:, 1] == pytest.approx(
            -ELEMENTARY_CHARGE * 0.1 / passages.MC * x[:, 1] * u[:, 0] / u[:, 2], rel=0.1, abs=1e-6
        )


def test_a_hard_solenoid_keeps_the_canonical_angular_momentum_of_steep_flights():
    """Through the push: what enters is as far off as what the pusher's order leaves, whatever the slope."""
    steep = dict(passages.HARD["solenoid"], field=1.0)
    errors = [passages.passage_error(MPI.COMM_SELF, steep, steps, passages.through_hard) for steps in (800, 1600)]
    assert errors[1] < 0.3 * errors[0]

"""The theory that matched beams are held against, by laws of its own; and short runs beside it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from mpi4py import MPI
from scipy.integrate import solve_ivp

from amrpic.particles.thermal_equilibrium import line_gradient, tune_depression
from amrpic.units import ELECTRON_MASS, ELEMENTARY_CHARGE, SPEED_OF_LIGHT
from exact.channel import LENGTH, OMEGA, PERIOD, RADIUS, constant, matched
from verify import envelopes, halo, mismatch


def test_matched_envelope_rests_with_the_stated_depression():
    beam = matched(0.3)
    sizes = beam.at(np.linspace(0, 5 * PERIOD, 50), constant)
    assert sizes[:2] == pytest.approx(np.full((2, 50), RADIUS / 2), rel=1e-6)
    gradient = line_gradient(beam.charge, *beam.start)
    found = tune_depression(
        beam.emittance / SPEED_OF_LIGHT, beam.start[0], gradient, -ELEMENTARY_CHARGE, ELECTRON_MASS, 1.0
    )
    assert found == pytest.approx(0.3, rel=1e-12)


def test_small_breathing_has_its_frequency():
    """ω² = 2 ω0² + 2 ω² η² for the mode in which x and y go together."""
    beam, omega = matched(0.5), OMEGA * np.sqrt(2 + 2 * 0.25)
    larger = replace(beam, start=(1.001 * beam.start[0], 1.001 * beam.start[1]))
    times = np.linspace(0, 2 * np.pi / omega, 9)
    deviation = larger.at(times, constant)[0] / beam.start[0] - 1
    assert deviation == pytest.approx(1e-3 * np.cos(omega * times), abs=3e-6)


def test_lattice_has_its_phase_advance_and_its_beam_is_periodic():
    channel = envelopes.lattice()
    square = envelopes.quadrupole_square()
    span = (0, channel.period)

    def hill(time, s):
        return [s[1], -envelopes.alternating(square, time)[0] * s[0]]

    step = channel.period / 800
    cosine, sine = (
        solve_ivp(hill, span, start, max_step=step, rtol=1e-8, atol=1e-20).y[:, -1]
        for start in ([1.0, 0.0], [0.0, OMEGA])
    )
    assert (cosine[0] + sine[1] / OMEGA) / 2 == pytest.approx(np.cos(envelopes.ADVANCE), abs=2e-3)
    times = np.linspace(*span, 401)
    sizes = channel.beam.at(times, channel.focusing, step=times[1])
    assert sizes[:2, -1] == pytest.approx(sizes[:2, 0], rel=1e-4)
    advance = np.trapezoid(channel.beam.emittance / sizes[:2] ** 2, times)
    assert advance == pytest.approx(envelopes.ADVANCE / 2, rel=1e-4)
    assert LENGTH < envelopes.CELL / 50


def test_core_at_rest_drives_no_particle_and_a_breathing_one_does():
    start = np.linspace(0.1, 1.5, 15) * RADIUS
    at_rest = halo.particle_core(start, np.full(2001, RADIUS), PERIOD / 400)
    assert at_rest == pytest.approx(start, rel=1e-4)
    beam = replace(matched(), start=(halo.MISMATCH * RADIUS / 2,) * 2)
    times = np.arange(4001) * PERIOD / 400
    driven = halo.particle_core(start, 2 * beam.at(times, constant)[0], PERIOD / 400)
    assert driven.max() > 2.5 * RADIUS  # beyond the core's own largest radius, twice and more
    assert 2 * beam.at(times, constant)[0].max() < 1.7 * RADIUS


@pytest.mark.mpi(ranks=2, more=(1,))
def test_short_runs_follow_the_envelope_equation(comm, monkeypatch):
    for name, value in (("PARTICLES", 20_000), ("PERIODS", 1), ("LEVELS", 2)):
        monkeypatch.setattr(envelopes, name, value)
    for channel in (envelopes.constant_focusing(), envelopes.lattice()):
        _, measured, exact, _ = envelopes._run(comm, replace(channel, steps=32))
        assert np.abs(measured / exact - 1).max() < 5e-3, channel.name
        assert np.ptp(exact) > 0.05 * RADIUS  # it does move


def test_test_particles_on_the_mesh_follow_the_particle_core_equation(monkeypatch):
    monkeypatch.setattr(halo, "CORE", 20_000)
    monkeypatch.setattr(halo, "LEVELS", 2)
    core = replace(matched(), start=(halo.MISMATCH * RADIUS / 2,) * 2)
    radius = 2 * core.at(np.arange(2 * halo.STEPS + 1) * PERIOD / halo.STEPS, constant)[0]
    start = np.linspace(0.4, 1.2, 30) * RADIUS
    exact = halo.particle_core(start, radius, PERIOD / halo.STEPS)
    assert np.abs(halo._reached(MPI.COMM_SELF, core, start, radius) / exact - 1).max() < 0.02


def test_wide_beam_drives_particles_as_far_as_the_narrow_one_of_the_same_breathing():
    """A beam of 1.5 matched radii has shrunk to 0.62 of one half a breathing later."""
    beam = replace(matched(), start=(halo.MISMATCH * RADIUS / 2,) * 2)
    times = np.arange(40 * 200 + 1) * PERIOD / 200
    driven = halo.particle_core(np.linspace(0.01, 1.5, 300) * RADIUS, 2 * beam.at(times, constant)[0], times[1])
    assert mismatch.largest_radius() == pytest.approx(driven.max(), rel=2e-3)


def test_mesh_that_follows_the_halo_finds_its_radius(monkeypatch, tmp_path):
    """A short, coarse run: cells of a matched rms size, a quarter of one where particles are."""
    monkeypatch.setattr(mismatch, "SHORT", mismatch.Form(32, 10_000, 10, 0.999))
    table = mismatch.table(MPI.COMM_SELF)
    _, least, most, difference, *_ = table.goals()  # the part of the cells is that of long runs
    assert least.met and most.met and difference.met, table.rows
    assert table.picture is not None
    table.picture(tmp_path / "halo.png")
    assert (tmp_path / "halo.png").stat().st_size > 1000


@pytest.mark.mpi(ranks=2)
def test_radii_of_a_halo_are_those_of_one_rank(comm):
    form = mismatch.Form(32, 5_000, 1, 0.999)
    alone, together = (mismatch.run(c, form, mismatch.scene(form, 32, 2)) for c in (MPI.COMM_SELF, comm))
    assert together.radii == pytest.approx(alone.radii, rel=1e-4)
    assert together.cells == alone.cells

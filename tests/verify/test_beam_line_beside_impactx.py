"""The lattice cell that is compared with ImpactX: its line, what is measured at screens, and a coarse run of it."""

from __future__ import annotations

import json

import numpy as np
import pytest
from mpi4py import MPI

from amrpic.units import ELECTRON_MASS, SPEED_OF_LIGHT
from verify import beam_line
from verify.beam_line import CHARGES, SIZES, at, reference, screens


def test_the_reference_is_of_this_line():
    assert reference()["of"] == json.loads(json.dumps(beam_line.description())), "run `make impactx`"


def test_reference_starts_with_the_bunch_of_the_scene():
    for name in CHARGES:
        start = at(reference()[name], 0.0)
        assert [start[what] for what in SIZES] == pytest.approx(beam_line.BUNCH["sigma"], rel=1e-3)


def test_space_charge_counts_in_the_reference():
    last = list(screens().values())[-1]
    with_, without = (at(reference()[name], last) for name in ("with", "without"))
    assert all(with_[what] > 1.3 * without[what] for what in SIZES)


def test_emittances_of_what_passes_a_plane_are_normalised():
    rng, mc = np.random.default_rng(3), ELECTRON_MASS * SPEED_OF_LIGHT
    position, u, time = rng.normal(0, 1e-3, (50_000, 3)), rng.normal(0, 2e-3, (50_000, 3)), rng.normal(0, 1e-12, 50_000)
    found = beam_line.measured(position, (u + np.array([0, 0, 5])) * mc, time)
    expected = 1e-3, 1e-3, beam_line.BETA * SPEED_OF_LIGHT * 1e-12, 2e-6, 2e-6, beam_line.BETA * 2e-3
    assert list(found.values()) == pytest.approx(expected, rel=0.02)


@pytest.mark.mpi(ranks=(2,), timeout=120)
@pytest.mark.parametrize("charge", ["with", pytest.param("without", marks=pytest.mark.long)])
def test_a_bunch_passes_screens_as_in_impactx(comm: MPI.Comm, charge: str) -> None:
    found = beam_line.along(comm, CHARGES[charge], particles=2**14, steps=106)
    for name, path in screens().items():
        expected = at(reference()[charge], path)
        for what in SIZES:
            assert found.screens[name][what] == pytest.approx(expected[what], rel=0.01), (name, what)

"""Energy and momentum of a bunch beside a plane, on meshes that are solved in seconds."""

from __future__ import annotations

import math

import pytest
from scipy.integrate import dblquad

from exact.errors import observed_order
from verify.image_force import FALLS, FREE, TURNS, beyond, measured

PARTICLES = 2**14


@pytest.mark.mpi(ranks=(1, 2))
def test_a_bunch_that_falls_to_a_grounded_plane_keeps_its_energy(comm):
    found = [measured(comm, FALLS, cells, PARTICLES) for cells in (4, 6)]
    assert found[1][0] < 1e-3 and observed_order((4, 6), [energy for energy, *_ in found]) > 1.8
    assert max(abs(momentum) for _, momentum, _ in found) < 1e-3
    assert found[1][2] > 0.4  # of the pressure: what lies beyond the box counts


def test_a_bunch_that_a_neumann_plane_turns_back_does_so_as_well_as_one_in_free_space(comm):
    found, free = ([measured(comm, flight, cells, PARTICLES) for cells in (4, 6)] for flight in (TURNS, FREE))
    assert observed_order((4, 6), [energy for energy, *_ in found]) > 1.8
    assert max(abs(momentum) for _, momentum, _ in found) < 2e-3
    for (energy, *_), (of_free, *_) in zip(found, free, strict=True):
        assert energy == pytest.approx(of_free, rel=0.02)  # what the mesh loses inside the bunch, images none


@pytest.mark.parametrize("power", [2, 3])
def test_the_pressure_beyond_the_box_is_the_integral(power):
    height, half = 0.7, 2.0
    inside, _ = dblquad(lambda y, x: (x * x + y * y + height**2) ** -power, -half, half, -half, half)
    whole = math.pi / ((power - 1) * height ** (2 * power - 2))
    assert beyond(power, height, half) == pytest.approx(whole - inside, rel=1e-7)

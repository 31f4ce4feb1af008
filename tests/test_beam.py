"""Bunches have the moments asked for, and are the same on any number of ranks."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from mpi4py import MPI

from amrpic import beam
from amrpic.errors import ParticleError
from amrpic.particles import Particles
from amrpic.species import Species
from particle_cases import everywhere

KIND: dict[str, Any] = {"bunch_charge": 1e-11, "species": Species(charge=1.6e-19, mass=9.1e-31)}
UNIT = Species(charge=1.0, mass=2.0)
CENTRE, SIGMA = np.array([0.1, -0.2, 0.05]), np.array([2.5e-3, 1e-3, 5e-3])
COUNT = 100_000


def gaussian(comm: MPI.Comm, count: int = COUNT, **changes: Any) -> Particles:
    return beam.gaussian(comm, count, **{"centre": CENTRE, "sigma": SIGMA, **KIND, **changes})


@pytest.mark.mpi(ranks=(1, 3))
def test_gaussian_bunch_has_the_moments_asked_for(comm):
    bunch = everywhere(comm, gaussian(comm, momentum=(0, 0, 1e-22), momentum_sigma=(1e-24, 0, 2e-24)))
    x = (bunch["position"] - CENTRE) / SIGMA
    assert np.abs(x.mean(axis=0)).max() < 5 / np.sqrt(COUNT)
    assert x.var(axis=0) == pytest.approx(np.ones(3), abs=5 * np.sqrt(2 / COUNT))
    assert (x**4).mean(axis=0) == pytest.approx(np.full(3, 3.0), abs=5 * np.sqrt(96 / COUNT))
    p = bunch["momentum"] - [0, 0, 1e-22]
    assert p.std(axis=0) == pytest.approx(np.array([1e-24, 0, 2e-24]), rel=5 / np.sqrt(2 * COUNT))
    assert np.abs(p.mean(axis=0)).max() < 5 * 2e-24 / np.sqrt(COUNT)
    all_axes = np.corrcoef(np.column_stack([x, p[:, 0], p[:, 2]]).T)
    assert np.abs(all_axes - np.eye(5)).max() < 5 / np.sqrt(COUNT)


@pytest.mark.mpi(ranks=(1, 2))
def test_sphere_is_uniform(comm):
    bunch = everywhere(comm, beam.uniform_sphere(comm, COUNT, centre=CENTRE, radius=5e-3, **KIND))
    offset = (bunch["position"] - CENTRE) / 5e-3
    radius = np.linalg.norm(offset, axis=1)
    assert radius.max() <= 1 + 1e-12
    # r^3 is uniform in (0, 1), each direction cosine uniform in (-1, 1)
    for uniform in (radius**3, *(offset / radius[:, None]).T / 2 + 0.5):
        assert uniform.mean() == pytest.approx(0.5, abs=5 / np.sqrt(12 * COUNT))
        assert uniform.var() == pytest.approx(1 / 12, abs=5 * np.sqrt(1 / 180 / COUNT))
    assert np.abs(np.corrcoef(offset.T) - np.eye(3)).max() < 5 / np.sqrt(COUNT)


@pytest.mark.mpi(ranks=(1, 2, 3))
def test_bunch_is_the_same_on_any_number_of_ranks_and_spread_over_them(comm):
    for make in (
        gaussian,
        lambda c, n: beam.uniform_sphere(c, n, centre=CENTRE, radius=1e-3, momentum_sigma=1.0, **KIND),
    ):
        share = make(comm, 1000)
        assert len(share) == pytest.approx(1000 / comm.size, abs=1)
        alone, together = everywhere(MPI.COMM_SELF, make(MPI.COMM_SELF, 1000)), everywhere(comm, share)
        assert all(np.array_equal(alone[name], together[name]) for name in alone)
        assert together["id"].tolist() == list(range(1000))


@pytest.mark.mpi(ranks=(1, 2, 3))
def test_bunch_carries_its_charge(comm):
    assert gaussian(comm).total_charge(comm) == pytest.approx(1e-11, rel=1e-13)
    electrons = gaussian(comm, bunch_charge=-1e-11, species=Species(charge=-1.6e-19, mass=9.1e-31))
    assert electrons.total_charge(comm) == pytest.approx(-1e-11, rel=1e-13)
    assert (electrons.weight > 0).all()


def test_bunches_of_a_train_differ(comm):
    first, second = gaussian(comm, 10), gaussian(comm, 10, first_id=10)
    assert not np.isclose(first.position, second.position).any()
    assert second.id.tolist() == list(range(10, 20))
    assert not np.isclose(gaussian(comm, 10, seed=1).position, first.position).any()


@pytest.mark.mpi(ranks=(1, 2))
def test_no_particles_and_no_size_are_legal(comm):
    assert len(gaussian(comm, 0)) == 0
    assert (gaussian(comm, 10, sigma=0.0).position == CENTRE).all()
    point = beam.uniform_sphere(comm, 10, centre=CENTRE, radius=0.0, **KIND)
    assert (point.position == CENTRE).all()
    nothing = beam.from_arrays(comm, np.empty((0, 3)), **KIND)
    assert nothing.global_count(comm) == 0


@pytest.mark.mpi(ranks=(1, 2, 3))
def test_arrays_are_shared_out(comm):
    rng = np.random.default_rng(0)
    position, momentum, weight = rng.normal(size=(100, 3)), rng.normal(size=(100, 3)), rng.random(100)
    share = beam.from_arrays(comm, position, momentum=momentum, weight=weight, species=UNIT, first_id=50)
    whole = everywhere(comm, share)
    assert np.array_equal(whole["position"], position)
    assert np.array_equal(whole["momentum"], momentum)
    assert np.array_equal(whole["weight"], weight)
    assert whole["id"].tolist() == list(range(50, 150))
    equal = beam.from_arrays(comm, position, bunch_charge=3.0, species=UNIT)
    assert everywhere(comm, equal)["weight"] == pytest.approx(np.full(100, 0.03), rel=1e-15)
    assert not equal.momentum.any()


def test_arrays_need_either_weights_or_a_charge(comm):
    with pytest.raises(ParticleError, match="either"):
        beam.from_arrays(comm, np.zeros((2, 3)), species=UNIT)
    with pytest.raises(ParticleError, match="3 values of weight"):
        beam.from_arrays(comm, np.zeros((2, 3)), weight=np.ones(3), species=UNIT)

"""Bunches: the moments and profiles that their distributions have, in sizes and correlations as asked, quiet if asked, and the
same on any number of ranks."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
import scipy
from mpi4py import MPI

from amrpic.errors import ParticleError
from amrpic.particles import distributions
from amrpic.particles.particles import Particles
from amrpic.particles.phase_space import PhasePlane, PhaseSpace
from amrpic.particles.species import Species
from amrpic.particles.uniform_numbers import draw
from amrpic.pic.initial_particles import make_particles
from amrpic.scene.bunch_shapes import GaussianBunch
from amrpic.scene.scene import Scene
from amrpic.stages import beam
from amrpic.units import ELECTRON_MASS, SPEED_OF_LIGHT
from particle_cases import everywhere

COUNT = 40_000
UNIT = Species(charge=1.0, mass=2.0)
KIND: dict[str, Any] = {"bunch_charge": 1e-11, "species": Species(charge=1.6e-19, mass=9.1e-31)}
CENTRE = (0.1, -0.2, 0.05)
SPACE = PhaseSpace(
    CENTRE, [PhasePlane(2.5e-3, -4e-25, 1e-24), PhasePlane(1e-3, 0.0, 0.0), PhasePlane(5e-3, 0.0, 2e-24)], (0, 0, 1e-22)
)

# The distributions; <x_i^4> of x, z, p_x, p_z; and exact moments across planes or of the radius: name -> (function, value).
INNER, SHARE, SIZE = 0.6, 0.1, 3.0
SHELL, TUBE = distributions.shell_radius(INNER), distributions.tube_radius(INNER)
CORE = distributions.halo_core(SHARE, SIZE) ** 2
TAIL4 = 3 * CORE**2 * (1 + SHARE * (SIZE**4 - 1))
SHELL4 = 3 * SHELL**4 / 35 * (1 - INNER**7) / (1 - INNER**3)


def squares(x: np.ndarray, *rows: int) -> np.ndarray:
    return np.square(x[list(rows)]).sum(axis=0)


Shape = tuple[Callable[[np.ndarray], np.ndarray], tuple[float, float, float, float]]
SHAPES: dict[str, Shape] = {
    "gaussian": (distributions.gaussian, (3, 3, 3, 3)),
    "ball": (distributions.ball, (15 / 7, 15 / 7, 3, 3)),
    "parabolic": (distributions.parabolic, (7 / 3, 7 / 3, 3, 3)),
    "shell": (lambda u: distributions.shell(u, INNER), (SHELL4, SHELL4, 3, 3)),
    "tube": (lambda u: distributions.tube(u, INNER), (TUBE**4 * (1 + INNER**2 + INNER**4) / 8, 9 / 5, 3, 3)),
    "kv": (lambda u: distributions.kapchinsky_vladimirsky(u, False), (2, 9 / 5, 2, 3)),
    "kv with normal z": (lambda u: distributions.kapchinsky_vladimirsky(u, True), (2, 3, 2, 3)),
    "thermal without charge": (lambda u: distributions.thermal(u, 1.0), (3, 9 / 5, 3, 3)),
    "cold thermal": (lambda u: distributions.thermal(u, 0.0), (2, 9 / 5, 3, 3)),
    "waterbag": (distributions.waterbag, (12 / 5,) * 4),
    "halo": (lambda u: distributions.halo(u, SHARE, SIZE), (TAIL4,) * 4),
}

# Functions of a point that are even in (0, 1) if the profile is the one asked for: those of its radius.
EVEN: dict[str, Callable[[np.ndarray], np.ndarray]] = {
    "ball": lambda x: (squares(x, 0, 1, 2) / 5) ** 1.5,
    "parabolic": lambda x: (lambda r: (5 * r**3 - 3 * r**5) / 2)(np.sqrt(squares(x, 0, 1, 2) / 7)),
    "shell": lambda x: (squares(x, 0, 1, 2) ** 1.5 / SHELL**3 - INNER**3) / (1 - INNER**3),
    "tube": lambda x: (squares(x, 0, 1) / TUBE**2 - INNER**2) / (1 - INNER**2),
    "kv": lambda x: squares(x, 0, 1) / 4,  # the projection onto x, y fills an ellipse evenly
    "thermal without charge": lambda x: np.exp(-squares(x, 0, 1) / 2),
    "cold thermal": lambda x: squares(x, 0, 1) / 4,
    "waterbag": lambda x: (squares(x, 0, 1, 2, 3, 4, 5) / 8) ** 3,
    "halo": lambda x: (
        1
        - (1 - SHARE) * np.exp(-squares(x, 0, 1) / (2 * CORE))
        - SHARE * np.exp(-squares(x, 0, 1) / (2 * CORE * SIZE**2))
    ),
}


def sampled(comm: MPI.Comm, shape: str = "gaussian", count: int = COUNT, **changes: Any) -> Particles:
    return beam.sampled(comm, count, SHAPES[shape][0], SPACE, **{**KIND, **changes})


def within(values: np.ndarray, exact: float | np.ndarray, errors: float = 5.0) -> bool:
    """Whether the mean over the last axis is right within so many of its standard errors."""
    error = values.std(axis=-1) / np.sqrt(values.shape[-1])
    return bool(np.all(np.abs(values.mean(axis=-1) - exact) <= errors * error + 1e-15))


@pytest.mark.parametrize("name", SHAPES)
def test_unit_distribution_has_its_exact_moments(name):
    """To 5 standard errors, as the sample itself gives them: one of some 200 comparisons fails by chance in 10^4 seeds."""
    shape, fourth = SHAPES[name]
    x = shape(draw("random", 11, 0, 0, COUNT))
    pairs = [x[i] * x[j] for i in range(6) for j in range(i + 1)]
    exact = [float(i == j) for i in range(6) for j in range(i + 1)]
    assert within(x, 0.0)
    assert within(np.array(pairs), np.array(exact))
    assert within(x[[0, 2, 3, 5]] ** 4, np.array(fourth))
    assert within(x[1] ** 4, fourth[0])


@pytest.mark.parametrize("name", EVEN)
def test_unit_distribution_has_its_exact_profile(name):
    """Kolmogorov and Smirnov's distance to the exact profile: sqrt(N) D > 2.2 has a probability of 1.3e-4."""
    even = np.sort(EVEN[name](SHAPES[name][0](draw("random", 12, 0, 0, COUNT))))
    assert even[0] > -1e-12 and even[-1] < 1 + 1e-12
    distance = np.abs(even - (np.arange(COUNT) + 0.5) / COUNT).max()
    assert np.sqrt(COUNT) * distance < 2.2


def test_kv_and_waterbag_are_correlated_across_planes_as_they_must():
    kv, bag = (SHAPES[name][0](draw("random", 13, 0, 0, COUNT)) for name in ("kv", "waterbag"))
    assert squares(kv, 0, 1, 3, 4) == pytest.approx(np.full(COUNT, 4.0), rel=1e-12)  # a shell, without thickness
    assert within(kv[0] ** 2 * kv[1] ** 2, 2 / 3)
    assert within(bag[0] ** 2 * bag[5] ** 2, 8 / 10)


@pytest.mark.parametrize("sampling", ["sobol", "halton"])
@pytest.mark.parametrize("name", ["gaussian", "parabolic", "kv", "waterbag"])
def test_noise_of_a_quiet_start_falls_faster_than_the_root(name, sampling):
    counts = 2 ** np.array([8, 10, 12, 14])

    def noise(kind: Any, count: int) -> float:
        errors = [np.cov(SHAPES[name][0](draw(kind, seed, 0, 0, count))) - np.eye(6) for seed in range(3)]
        return float(np.sqrt(np.mean(np.square(errors))))

    quiet = [noise(sampling, count) for count in counts]
    assert np.polyfit(np.log(counts), np.log(quiet), 1)[0] < -0.75  # random numbers have -0.5
    assert quiet[-1] < 0.2 * noise("random", counts[-1])


@pytest.mark.parametrize("sampling", ["random", "sobol", "halton"])
def test_numbers_of_a_particle_depend_on_it_alone(sampling):
    whole = draw(sampling, 3, 1000, 0, 500)
    assert whole.min() > 0 and whole.max() < 1
    for start, stop in ((0, 1), (0, 200), (123, 124), (123, 500), (77, 77)):
        assert np.array_equal(draw(sampling, 3, 1000, start, stop), whole[:, start:stop])
    for seed, first_id in ((4, 1000), (3, 1500)):
        assert not np.isclose(draw(sampling, seed, first_id, 0, 500), whole).all(axis=0).any()


@pytest.mark.mpi(ranks=(1, 3))
def test_bunch_has_the_place_sizes_and_correlations_asked_for(comm):
    bunch = everywhere(comm, sampled(comm))
    x, p = bunch["position"].T - np.array(CENTRE)[:, None], bunch["momentum"].T - np.array([[0], [0], [1e-22]])
    assert within(x, 0.0) and within(p[[0, 2]], 0.0)
    assert within(x**2, np.array([2.5e-3, 1e-3, 5e-3]) ** 2)
    assert within(x[0] * p[0], -2.5e-3 * 4e-25)
    assert within(p[[0, 2]] ** 2, np.array([1.16e-48, 4e-48]))
    assert within(x[2] * p[2], 0.0) and within(x[0] * x[1], 0.0) and within(p[0] * p[2], 0.0)
    assert (p[1] == 0).all()


def scene(**bunch: Any) -> Scene:
    common = {"species": "electron", "charge": -1e-11, "particles": 2**14, "sampling": "sobol"}
    return Scene.from_dict({"domain": {"lower": -1, "upper": 1, "cells": 16}, "bunches": [{**common, **bunch}]})


TWISS = {
    "x": {"emittance": "1 um rad", "alpha": 1.5, "beta": "2 m"},
    "y": {"emittance": "0.5 mm mrad", "alpha": -0.7, "sigma": "3 mm"},
    "z": {"emittance": 2e-6, "beta": "5 m"},
}
SHAPED: list[dict[str, Any]] = [
    {"distribution": "gaussian"},
    {"distribution": "waterbag"},
    {"distribution": "kv"},
    {"distribution": "parabolic"},
    {"distribution": "hollow", "inner": 0.5},
    {"distribution": "halo", "tail_share": 0.1, "tail_size": 2},
]


@pytest.mark.parametrize("shape", SHAPED, ids=lambda shape: shape["distribution"])
def test_twiss_parameters_give_the_stated_covariance(comm, shape):
    """Within the noise of a quiet start of 2^14 particles, some 1e-3; and exactly in the planes that the bunch is made of."""
    momentum = 3 * ELECTRON_MASS * SPEED_OF_LIGHT
    given = scene(**shape, twiss=TWISS, momentum=[0.6 * momentum, 0, 0.8 * momentum])
    made = make_particles(comm, given)
    size = np.sqrt([2 * 1e-6 / 3, 9e-6, 5 * 2e-6 / 3])
    emittance = np.array([1e-6, 0.5e-6, 2e-6])  # of u = p / (m c)
    alpha = np.array([1.5, -0.7, 0.0])
    x = made.position - made.position.mean(axis=0)
    u = made.momentum / (ELECTRON_MASS * SPEED_OF_LIGHT)
    assert u.mean(axis=0) == pytest.approx([1.8, 0, 2.4], abs=1e-6)
    u -= u.mean(axis=0)
    noise = 0.02 if shape["distribution"] == "halo" else 0.005
    made_of = given.bunches[0].planes  # type: ignore[union-attr]
    for axis, plane in enumerate(made_of):
        gamma = (1 + alpha[axis] ** 2) * emittance[axis] / size[axis] ** 2  # Twiss, of u
        stated = np.array([[size[axis] ** 2 / emittance[axis], -alpha[axis]], [-alpha[axis], gamma]]) * emittance[axis]
        scale = np.sqrt(np.outer(np.diag(stated), np.diag(stated)))
        assert np.abs((np.cov(x[:, axis], u[:, axis]) - stated) / scale).max() < noise
        lean, spread = (value / (ELECTRON_MASS * SPEED_OF_LIGHT) for value in (plane.lean, plane.spread))
        exact = [[plane.size**2, plane.size * lean], [plane.size * lean, lean**2 + spread**2]]
        np.testing.assert_allclose(exact, stated, rtol=1e-12)


@pytest.mark.mpi(ranks=(2, 3))
@pytest.mark.parametrize("sampling", ["random", "sobol", "halton"])
def test_bunch_is_the_same_on_any_number_of_ranks_and_spread_over_them(comm, sampling):
    for name in SHAPES:
        share = sampled(comm, name, 1000, sampling=sampling, first_id=17)
        assert len(share) == pytest.approx(1000 / comm.size, abs=1)
        alone = everywhere(MPI.COMM_SELF, sampled(MPI.COMM_SELF, name, 1000, sampling=sampling, first_id=17))
        together = everywhere(comm, share)
        assert all(np.array_equal(alone[key], together[key]) for key in alone), name
        assert together["id"].tolist() == list(range(17, 1017))


@pytest.mark.mpi(ranks=(1, 2, 3))
def test_bunch_carries_its_charge(comm):
    assert sampled(comm).total_charge(comm) == pytest.approx(1e-11, rel=1e-13, abs=0)
    electrons = sampled(comm, bunch_charge=-1e-11, species=Species(charge=-1.6e-19, mass=9.1e-31))
    assert electrons.total_charge(comm) == pytest.approx(-1e-11, rel=1e-13, abs=0)
    assert (electrons.weight > 0).all()


@pytest.mark.parametrize("sampling", ["random", "sobol", "halton"])
def test_bunches_of_a_train_differ(comm, sampling):
    first, second = (sampled(comm, count=10, sampling=sampling, first_id=first) for first in (0, 10))
    assert not np.isclose(first.position, second.position).any()
    assert second.id.tolist() == list(range(10, 20))


@pytest.mark.mpi(ranks=(1, 2))
def test_no_particles_and_no_size_are_legal(comm):
    assert len(sampled(comm, count=0)) == 0
    point = PhaseSpace(CENTRE, 3 * [PhasePlane(0.0)])
    assert (beam.sampled(comm, 10, distributions.waterbag, point, **KIND).position == CENTRE).all()
    nothing = beam.from_arrays(comm, np.empty((0, 3)), **KIND)
    assert nothing.global_count(comm) == 0
    assert len(beam.lattice(comm, (4, 0, 4), (0, 0, 0), (1, 1, 1), **KIND)) == 0


@pytest.mark.mpi(ranks=(1, 2, 3))
def test_lattice_fills_its_cuboid_in_order(comm):
    share = beam.lattice(
        comm, (2, 3, 5), (0, 0, -1), (2, 3, 1), displacement=(0.1, 0, 0), waves=(1, 1, 1), first_id=7, **KIND
    )
    whole = everywhere(comm, share)
    x, y, z = np.meshgrid([0.6, 1.4], [0.5, 1.5, 2.5], [-0.8, -0.4, 0, 0.4, 0.8], indexing="ij")
    assert whole["position"] == pytest.approx(np.stack([x, y, z]).reshape(3, -1).T, abs=1e-15)
    assert whole["id"].tolist() == list(range(7, 37))
    assert share.total_charge(comm) == pytest.approx(1e-11, rel=1e-13, abs=0)


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


def test_a_cut_gaussian_is_the_normal_distribution_up_to_there(comm):
    """Kolmogorov and Smirnov's distance to SciPy's truncated normal one: sqrt(N) D > 2.2 has a probability of 1.3e-4."""
    cutoff = (0.3, 1.5, 3.0)
    x = distributions.cut_gaussian(draw("random", 5, 0, 0, COUNT), cutoff)
    for values, c in zip(x, cutoff, strict=False):
        assert np.abs(values).max() <= c
        exact = scipy.stats.truncnorm(-c, c).cdf(np.sort(values))
        assert np.sqrt(COUNT) * np.abs(exact - (np.arange(COUNT) + 0.5) / COUNT).max() < 2.2
    assert within(x[3:] ** 2, 1.0)
    for c in (1e-6, 1e-3, 0.0199, 0.0201, 0.5, 2, 30):
        second, all_ = (scipy.integrate.quad(lambda x, n=n: x**n * np.exp(-(x**2) / 2), 0, c)[0] for n in (2, 0))
        assert distributions.cut_rms(c) == pytest.approx(np.sqrt(second / all_), rel=1e-8, abs=0)
    bunch = {
        "distribution": "gaussian",
        "sigma": ["1 mm", "2 mm", 0],
        "cutoff": 1.5,
        "charge": "1 pC",
        "particles": COUNT,
    }
    domain = {"lower": "-3 mm", "upper": "3 mm", "cells": 8}
    given = Scene.from_dict({"domain": domain, "bunches": [bunch]})
    made, shape = make_particles(comm, given), given.bunches[0]
    assert isinstance(shape, GaussianBunch) and within(made.position.T[:2] ** 2, np.array(shape.rms[:2]) ** 2)
    assert np.abs(made.position).max(axis=0) == pytest.approx([1.5e-3, 3e-3, 0], rel=1e-3)

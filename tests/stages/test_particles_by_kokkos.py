"""Kokkos kernels over particles: what the loops over vectors find, to rounding."""

from __future__ import annotations

from dataclasses import replace
from functools import partial
from itertools import product
from typing import Any

import numpy as np
import pytest
from mpi4py import MPI

import amrpic
import hierarchies
from amrpic.errors import ParticleError
from amrpic.particles.clouds import PLAIN, SHAPES, Clouds
from amrpic.particles.particles import Particles
from amrpic.particles.species import Species, SpeciesTable
from amrpic.pic.step import advance, begin
from amrpic.scene.scene import Scene
from amrpic.stages.deposit import deposit
from amrpic.stages.gather import compensate, gather
from amrpic.stages.migrate import migrate
from amrpic.stages.poisson import PoissonSolver
from amrpic.stages.push import PUSHERS, push
from particle_cases import dense, placed, random_field

CASES = list(hierarchies.all_cases().values())
ALL = [Clouds(shape, matched) for shape in SHAPES for matched in (False, True)]
ROUNDING = 1e-14
BY_KOKKOS = replace(PLAIN, kernels="kokkos")


def apart(found: np.ndarray, expected: np.ndarray) -> float:
    """The largest difference over the largest number."""
    largest = np.nanmax(np.abs(expected), initial=0)
    return float(np.nanmax(np.abs(found - expected), initial=0) / largest) if largest > 0 else 0.0


@pytest.mark.mpi(ranks=(1, 2, 3), more=(4,), timeout=240)
def test_every_cloud_is_deposited_and_gathered_alike(comm):
    """Bricks that other ranks own than serve them, matched clouds near faces, walls and periodic faces among them."""
    for case in CASES:
        hierarchy, particles = placed(case, comm, 3000)
        fields = amrpic.VectorField(*[random_field(hierarchy)] * 3)
        for clouds in ALL:
            by_kokkos = replace(clouds, kernels="kokkos")
            densities = [deposit(particles, hierarchy, each) for each in (by_kokkos, clouds)]
            for level in range(hierarchy.levels):
                found, expected = (dense(density, level) for density in densities)
                assert apart(found, expected) < ROUNDING, (case.name, clouds)
            found, expected = (gather(fields, particles, each) for each in (by_kokkos, clouds))
            assert apart(found, expected) < ROUNDING, (case.name, clouds)


@pytest.mark.mpi(ranks=(1, 3), timeout=120)
def test_charge_is_kept_and_so_are_moments_where_all_weigh_the_same(comm):
    for case in CASES[:6]:
        hierarchy, particles = placed(case, comm, 2000)
        equal = Particles(
            particles.position,
            particles.momentum,
            np.broadcast_to(2.0, len(particles)),
            particles.id,
            particles.species,
        )
        equal, _ = migrate(equal, hierarchy)
        density, expected = (deposit(equal, hierarchy, each) for each in (BY_KOKKOS, PLAIN))
        assert density.integral() == pytest.approx(equal.total_charge(comm), rel=1e-13, abs=0)
        for field in (density, expected):
            for patch in field.patches:
                patch.data[...] *= sum(patch.centres())
        assert density.integral() == pytest.approx(expected.integral(), rel=1e-12)


def two_kinds(hierarchy: amrpic.Hierarchy, count: int) -> Particles:
    """Slow and fast particles of two kinds, sorted."""
    rng = np.random.default_rng(5)
    kinds = SpeciesTable.of_runs(
        [(0, Species(charge=-1.6e-19, mass=9e-31)), (count // 2, Species(charge=3e-19, mass=2e-27))]
    )
    position = rng.uniform(hierarchy.domain.lower, hierarchy.domain.upper, (count, 3))
    momentum = 3e-22 * rng.normal(size=(count, 3)) * rng.random((count, 1)) ** 3
    made = Particles(position, momentum, rng.random(count), np.arange(count), kinds)
    return migrate(made.select(slice(hierarchy.comm.rank, None, hierarchy.comm.size)), hierarchy)[0]


@pytest.mark.mpi(ranks=(1, 2, 3, 4), timeout=120)
@pytest.mark.parametrize("shape", SHAPES)
@pytest.mark.parametrize("matched", [False, True])
def test_particles_move_alike_in_all_fields_with_compensation(comm, shape, matched):
    domain = amrpic.Domain(0, 1, 16, {"x": "periodic", "y": "dirichlet", "z": ("neumann", "dirichlet")})
    levels = [[((6, 8, 8), (23, 23, 23))], [((20, 20, 20), (39, 35, 35))]]
    hierarchy = amrpic.Hierarchy(comm, domain, levels, max_grid_size=8, blocking_factor=2)
    particles, clouds = two_kinds(hierarchy, 4000), Clouds(shape, matched, "clouds")
    rho = deposit(particles, hierarchy, clouds)
    solver = PoissonSolver(hierarchy, tolerance=1e-8)
    efield = solver.deferred_field(solver.solve(rho)[0], covered=clouds.covered)
    compensate(efield, rho, clouds)
    rng = np.random.default_rng(comm.rank)
    electric, magnetic, between = (rng.normal(size=(len(particles), 3)) for _ in range(3))
    given: list[dict[str, Any]] = [
        {},
        {"shift": (0.1, 0.2, -0.3), "between": between},
        {"beta": (0.1, 0.0, 0.9), "between": between},
        *({"pusher": p, "electric": 1e6 * electric, "magnetic": magnetic, "between": between} for p in PUSHERS),
    ]
    for options, after in [(options, after) for options in given for after in (1e-11, 2e-11)]:
        both = []
        for kernels in ("kokkos", "vectors"):
            moved = push(efield, particles, 1e-11, after, 3e-11, replace(clouds, kernels=kernels), **options)
            both.append([moved.momentum.copy(), moved.position.copy(), between.copy()])
        for found, expected in zip(*both, strict=True):
            assert apart(found, expected) < 1e-12, options


@pytest.mark.parametrize("kernels", ["kokkos", "vectors"])
def test_a_particle_moves_the_same_bit_by_bit_whoever_stands_beside_it(kernels):
    """Lanes, blocks and their remainders round alike."""
    domain = amrpic.Domain(0, 1, 16, "periodic")
    hierarchy = amrpic.Hierarchy(MPI.COMM_SELF, domain, [[((8, 8, 8), (23, 23, 23))]], max_grid_size=16)
    everyone, rng = two_kinds(hierarchy, 4000), np.random.default_rng(7)
    some = migrate(everyone.select(rng.random(len(everyone)) < 0.8), hierarchy)[0]
    among = np.searchsorted(everyone.id, some.id, sorter=(order := np.argsort(everyone.id)))
    efield = amrpic.VectorField(*[random_field(hierarchy)] * 3)
    for clouds, beta in product(ALL, ((0, 0, 0), (0.1, 0, 0.9))):
        moved = []
        for particles in (some, everyone):
            between = np.empty((3, len(particles))).T
            now = push(
                efield, particles, 1e-11, 2e-11, 3e-11, replace(clouds, kernels=kernels), beta=beta, between=between
            )
            moved.append(
                [now.momentum, now.position, between, gather(efield, particles, replace(clouds, kernels=kernels))]
            )
        for found, expected in zip(*moved, strict=True):
            assert np.array_equal(found, expected[order[among]]), (clouds, beta)


@pytest.mark.mpi(ranks=(1, 2))
def test_particles_moved_behind_the_back_of_migrate_are_refused_by_all_ranks(comm):
    for case in (CASES[1], hierarchies.all_cases()["U of small blocks, three levels"]):
        hierarchy, particles = placed(case, comm, 40)
        fields = amrpic.VectorField(*[random_field(hierarchy)] * 3)
        if comm.rank == comm.size - 1:
            particles.position[3] = 1e9
            particles.position[5, 1] = np.nan
        for clouds in (PLAIN, Clouds(matched=True)):
            for use in (
                partial(deposit, particles, hierarchy),
                partial(gather, fields, particles),
                partial(push, fields, particles, 1.0, 1.0, 1.0),
            ):
                messages = []
                for kernels in ("kokkos", "vectors"):
                    with pytest.raises(ParticleError, match=r"particle \d+ has left .*migrate") as refused:
                        use(replace(clouds, kernels=kernels))
                    messages.append(str(refused.value))
                assert messages[0] == messages[1]


@pytest.mark.mpi(ranks=(1, 2, 3), more=(4,), timeout=120)
def test_a_run_with_this_backend_is_that_of_vectors(comm):
    def outcome(backend: str) -> np.ndarray:
        scene = Scene.from_dict(
            {
                "domain": {"lower": -0.024, "upper": 0.024, "cells": 24, "boundary": "dirichlet"},
                "bunches": [amrpic.GaussianBunch(species="electron", charge=-1e-11, particles=3000, sigma=0.004)],
                "refinement": {"levels": 1, "max_grid_size": 8, "regrid_every": 2},
                "solver": {"tolerance": 1e-12, "backend": backend},
                "motion": {"kind": "leapfrog", "dt": 5e-11},
                "schedule": {"steps": 4},
            },
            source="a bunch",
        )
        state, setup = begin(comm, scene)
        assert setup.clouds.kernels == ("kokkos" if backend == "kokkos" else "vectors")
        while state.step < 4:
            state = advance(state, setup)
        moments = state.moments()
        return np.concatenate([moments.mean, moments.rms, state.efield.sample(np.full((1, 3), 0.006))[0]])

    assert apart(outcome("kokkos"), outcome("matrix-free")) < 1e-9


def test_kernels_take_many_boxes_at_once_and_none():
    domain = amrpic.Domain(0, 1, 64, "periodic")
    hierarchy = amrpic.Hierarchy(MPI.COMM_SELF, domain, max_grid_size=8)
    for count in (0, 5, 50_000):
        particles = two_kinds(hierarchy, count)
        found, expected = (dense(deposit(particles, hierarchy, each), 0) for each in (BY_KOKKOS, PLAIN))
        assert apart(found, expected) < ROUNDING

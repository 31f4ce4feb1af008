"""Deposit of particles that stay on their rank while others are under way to it: the same density, and the same bits again."""

from __future__ import annotations

import time
from collections.abc import Callable

import numpy as np
import pytest

import amrpic
import backends
import hierarchies
from amrpic import _native
from amrpic.errors import ParticleError
from amrpic.particles.clouds import Clouds
from amrpic.particles.particles import Particles
from amrpic.stages.deposit import Deposition, deposit
from amrpic.stages.migrate import NONE, migrate, migrate_without
from particle_cases import hierarchy_of, placed, scattered

SHAPES = "nearest-grid-point", "cloud-in-cell", "triangular-shaped-cloud"
CROWDED = hierarchies.make("all refined", (8, 8, 8), "pppppp", 4, [hierarchies.everything])
FACES = hierarchies.make("refined in the middle", (8, 8, 8), "dddddd", 4, [hierarchies.within(hierarchies.everything)])
CASES = [CROWDED, FACES, *list(hierarchies.all_cases().values())[::9]]
COUNT = 40_000  # particles: ten in each cell of the first case, so that those of a box need not wait for others
MOVES: dict[str, Callable[[int, int], bool]] = {
    "of all ranks": lambda rank, ranks: True,
    "of the last rank": lambda rank, ranks: rank == ranks - 1,
    "of none": lambda rank, ranks: False,
}


def moved(hierarchy: amrpic.Hierarchy, particles: Particles, of: str) -> Particles:
    """Return particles that some ranks have moved by about a third of a cell of the base, not sorted there yet."""
    comm = hierarchy.comm
    steps = np.random.default_rng(comm.rank).normal(0, 0.3, (len(particles), 3)) * hierarchy.spacing(0)
    return particles.replace(particles.position + steps * MOVES[of](comm.rank, comm.size))


def deposited(
    particles: Particles, hierarchy: amrpic.Hierarchy, servers: np.ndarray, clouds: Clouds
) -> tuple[amrpic.Field, Particles, int]:
    """Return the density and the particles that moved, and how many waited for those that came to this rank."""
    begun: list[Deposition] = []
    left: list[int] = []

    def begin(here: Particles, migration: _native.Migration) -> None:
        begun.append(Deposition(here, hierarchy, clouds))
        begun[0].begin(migration)
        left.append(begun[0].left)

    here, _, _ = migrate_without(particles, hierarchy, NONE, servers, meanwhile=begin)
    return begun[0].density(), here, left[0]


@pytest.mark.mpi(ranks=(1, 2, 3, 4), timeout=300)
@pytest.mark.parametrize("matched", [False, True])
@pytest.mark.parametrize("shape", SHAPES)
def test_density_is_that_of_a_deposit_at_once_and_the_same_again(comm, shape, matched):
    clouds = Clouds(shape, matched)
    for case in CASES:
        hierarchy, particles = placed(case, comm, COUNT)
        servers = particles.sorted_on(hierarchy).servers
        for of in MOVES:
            there = moved(hierarchy, particles, of)
            density, here, left = deposited(there, hierarchy, servers, clouds)
            again, *_ = deposited(there, hierarchy, servers, clouds)
            at_once = deposit(here, hierarchy, clouds)
            rounding = 1e-13 * at_once.max_abs()
            for level in range(hierarchy.levels):
                assert backends.same_sums(density.array(level), again.array(level)), (case.name, of)
                assert density.array(level) == pytest.approx(at_once.array(level), rel=0, abs=rounding), (case.name, of)
            starts = here.sorted_on(hierarchy).starts
            came = np.diff(np.concatenate([[0], np.cumsum(~np.isin(here.id, particles.id))])[starts])
            by_kokkos = backends.DEFAULT == "kokkos"  # whose kernels take all boxes at once
            waiting = len(here) if by_kokkos else np.diff(starts)[came > 0].sum()  # all of a box that some come to
            assert came.sum() <= left <= waiting, (case.name, of)
            if case is CROWDED and of == "of all ranks" and comm.size > 1 and not by_kokkos:
                assert came.sum() > 1000 and left < waiting


@pytest.mark.mpi(ranks=(2, 3))
def test_particles_that_come_and_those_that_stay_are_in_their_places_at_once(comm):
    """Before others are there, their positions lie in their bricks, so that the particles of a box can be gone through."""
    hierarchy, particles = placed(CROWDED, comm, COUNT)
    found: list[Particles] = []

    def look(here: Particles, migration: _native.Migration) -> None:
        found.append(here.replace(here.position.copy()))

    servers = particles.sorted_on(hierarchy).servers
    here, _, _ = migrate_without(moved(hierarchy, particles, "of all ranks"), hierarchy, NONE, servers, meanwhile=look)
    brick = 8 * hierarchy.spacing(1)
    lower = np.array(hierarchy.domain.lower)
    where, before = ((one.position - lower) // brick for one in (here, found[0]))
    assert np.array_equal(where, before)
    stays = np.isin(here.id, particles.id)
    assert np.array_equal(here.position[stays], found[0].position[stays]) and not stays.all()


@pytest.mark.mpi(ranks=(1, 2, 3))
@pytest.mark.parametrize("error", [MemoryError("no room for it"), ParticleError("no room for it")])
def test_an_error_meanwhile_is_raised_on_all_ranks_and_the_next_migration_is_right(comm, error):
    hierarchy, particles = placed(CROWDED, comm, COUNT)
    there, servers = moved(hierarchy, particles, "of all ranks"), particles.sorted_on(hierarchy).servers
    expected, _ = migrate(there, hierarchy, servers)

    def fail(here: Particles, migration: _native.Migration) -> None:
        if comm.rank == comm.size - 1:
            raise error

    with pytest.raises(ParticleError, match=r"^(MemoryError: )?no room for it$"):
        migrate_without(there, hierarchy, NONE, servers, meanwhile=fail)
    here, _ = migrate(there, hierarchy, servers)
    for one, other in zip(here.arrays, expected.arrays, strict=True):
        assert np.array_equal(one, other)


@pytest.mark.mpi(ranks=2)
def test_a_migration_that_is_given_up_keeps_its_messages_until_they_have_passed(comm):
    """One rank lets go of it and writes into the memory that is free then, before the other receives."""
    hierarchy = hierarchy_of(CROWDED, comm)
    particles, _ = migrate(scattered(hierarchy, 20 * COUNT), hierarchy)
    there, servers = moved(hierarchy, particles, "of all ranks"), particles.sorted_on(hierarchy).servers
    expected, _ = migrate(there, hierarchy, servers)
    plan = _native.Migration(hierarchy.particle_mesh, servers, *there.arrays, NONE, True)
    here = Particles.allocate(plan.arriving, particles.species)
    plan.start(*here.arrays)
    if comm.rank == 0:
        del plan
        spoiled = [np.full(2**n, np.nan) for n in range(10, 22) for _ in range(4)]
        assert np.isnan(spoiled[-1][-1])
    else:
        time.sleep(0.3)
        plan.receive(*here.arrays)
        for one, other in zip(here.arrays, expected.arrays, strict=True):
            assert np.array_equal(one, other)
    comm.Barrier()


@pytest.mark.mpi(ranks=2)
def test_a_migration_that_is_given_up_waits_for_no_other_rank(comm):
    """Of two ranks one starts and lets go; the other never starts, as if it had failed before."""
    hierarchy = hierarchy_of(CROWDED, comm.Dup())  # what is under way stays there
    particles, _ = migrate(scattered(hierarchy, 20 * COUNT), hierarchy)
    there, servers = moved(hierarchy, particles, "of all ranks"), particles.sorted_on(hierarchy).servers
    plan = _native.Migration(hierarchy.particle_mesh, servers, *there.arrays, NONE, True)
    here = Particles.allocate(plan.arriving, particles.species)
    if comm.rank == 0:
        plan.start(*here.arrays)
    del plan
    comm.Barrier()
    assert comm.allreduce(len(here)) > 0

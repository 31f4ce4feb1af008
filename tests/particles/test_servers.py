"""Who serves which particle: by a formula that all ranks know, in equal parts, wherever the cells live."""

from __future__ import annotations

import numpy as np
import pytest
from mpi4py import MPI

import amrpic
import hierarchies
from amrpic import _native
from amrpic.parallel import traffic
from amrpic.particles.clouds import Clouds
from amrpic.particles.particles import Particles, cut
from amrpic.stages.deposit import deposit
from amrpic.stages.migrate import arranged, migrate, share_out, weights
from amrpic.stages.push import random_walk
from particle_cases import ONE_KIND, everywhere, hierarchy_of, scattered

CASES = list(hierarchies.all_cases().values())
BRICK, AXIS_BITS, HASH_BITS = 8, 14, 21
PARTICLES = 40_000


def hashes(ids: np.ndarray) -> np.ndarray:
    """SplitMix64."""
    z = ids.astype(np.uint64) + np.uint64(0x9E3779B97F4A7C15)
    z = (z ^ (z >> np.uint64(30))) * np.uint64(0xBF58476D1CE4E5B9)
    z = (z ^ (z >> np.uint64(27))) * np.uint64(0x94D049BB133111EB)
    return ((z ^ (z >> np.uint64(31))) >> np.uint64(64 - HASH_BITS)).astype(np.int64)


def brick_places(hierarchy: amrpic.Hierarchy, position: np.ndarray) -> np.ndarray:
    """The place on the curve of the brick around each position in the domain."""
    most, finest = max(hierarchy.domain.cells), 0
    while most * 2 <= BRICK << AXIS_BITS:
        most, finest = 2 * most, finest + 1
    corner = np.zeros((len(position), 3), dtype=np.int64)
    for level in range(hierarchy.levels):
        cell = np.floor((position - np.array(hierarchy.domain.lower)) / hierarchy.spacing(level)).astype(np.int64)
        for lower, upper in hierarchy.boxes(level).reshape(-1, 2, 3):
            inside = ((cell >= lower) & (cell <= upper)).all(axis=1)
            corner[inside] = (lower + (cell[inside] - lower) // BRICK * BRICK) * 2 ** (finest - level) // BRICK
    key = np.zeros(len(position), dtype=np.int64)
    for bit in range(AXIS_BITS):
        for axis in range(3):
            key |= (corner[:, axis] >> bit & 1) << (3 * bit + axis)
    return key << HASH_BITS


def one_cell(comm: MPI.Comm) -> tuple[amrpic.Hierarchy, Particles]:
    """Three levels, and particles of which six in ten lie in one brick of the base and most others in two of level 2."""
    domain = amrpic.Domain((0, 0, 0), (1, 1, 1), (32, 32, 32), "dirichlet")
    levels = [[((32, 32, 32), (63, 63, 63))], [((80, 80, 80), (111, 111, 111))]]
    hierarchy = amrpic.Hierarchy(comm, domain, levels, max_grid_size=16)
    rng = np.random.default_rng(8)
    parts = [(0.02, 0.23, 6), (0.63, 0.68, 3), (0.0, 1.0, 1)]
    position = np.concatenate(
        [low + (up - low) * rng.random((PARTICLES * tenths // 10, 3)) for low, up, tenths in parts]
    )
    ids = rng.permutation(len(position))
    particles = Particles(position, rng.normal(size=position.shape), rng.random(len(ids)), ids, ONE_KIND)
    return hierarchy, particles.select(slice(comm.rank, None, comm.size))


@pytest.mark.mpi(ranks=(1, 2, 3, 4), timeout=120)
def test_particles_are_where_the_formula_says(comm):
    for hierarchy, particles in [
        one_cell(comm),
        *((h, scattered(h, 500)) for h in (hierarchy_of(c, comm) for c in CASES[::5])),
    ]:
        here, lost = migrate(particles, hierarchy)
        servers = here.sorted_on(hierarchy).servers
        place = brick_places(hierarchy, here.position) + hashes(here.id)
        assert len(set(map(bytes, comm.allgather(servers)))) == 1
        assert len(servers) == comm.size + 1 and servers[0] == 0 and servers[-1] == np.iinfo(np.int64).max
        assert (np.searchsorted(servers[1:-1], place, side="right") == comm.rank).all()
        assert comm.allreduce(len(here)) == comm.allreduce(len(particles)) and comm.allreduce(len(lost)) == 0


@pytest.mark.mpi(ranks=(1, 2, 3, 4), timeout=120)
def test_parts_are_equal_although_one_brick_holds_most_particles(comm):
    hierarchy, particles = one_cell(comm)
    here, _ = migrate(particles, hierarchy)
    assert comm.allreduce(len(here), MPI.MAX) <= 1.05 * PARTICLES / comm.size
    bricks = comm.allgather(set(brick_places(hierarchy, here.position).tolist()))
    assert comm.size == 1 or set.intersection(*bricks[:2]), "the first two ranks share no brick"


@pytest.mark.mpi(ranks=(2, 3, 4), timeout=120)
def test_particles_stay_with_given_servers_until_they_are_shared_out_anew(comm):
    hierarchy, particles = one_cell(comm)
    here, _ = migrate(particles, hierarchy)
    servers = here.sorted_on(hierarchy).servers
    for step in range(3):
        moved = random_walk(here, 0.05, seed=4, step=step)
        here, _ = migrate(moved, hierarchy, servers)
        assert here.sorted_on(hierarchy).servers is servers
        place = brick_places(hierarchy, here.position) + hashes(here.id)
        assert (np.searchsorted(servers[1:-1], place, side="right") == comm.rank).all()
    everyone = everywhere(comm, here)
    again, _ = migrate(here, hierarchy)
    assert comm.allreduce(len(again), MPI.MAX) <= 1.05 * len(everyone["id"]) / comm.size
    for name, values in everywhere(comm, again).items():
        assert np.array_equal(values, everyone[name])


@pytest.mark.mpi(ranks=(2, 3))
def test_starts_are_the_last_places_before_which_there_is_not_more_than_an_equal_part(comm):
    """Against weights that are gathered and looked through one after the other; also without any weight."""
    rng = np.random.default_rng(comm.rank)
    for count in (0, 1, 40):
        places = np.sort(rng.integers(0, 50, count)) << (HASH_BITS + 3)
        mine = rng.integers(1, 1000, count)
        starts = share_out(comm, places, mine)
        everyone, heavy = (np.concatenate(comm.allgather(values)) for values in (places, mine))

        def below(place: int, everyone: np.ndarray = everyone, heavy: np.ndarray = heavy) -> float:
            return float(heavy @ (np.clip(place - everyone, 0, 1 << HASH_BITS) / (1 << HASH_BITS)))

        for rank, start in enumerate(starts[1:-1].tolist(), start=1):
            wanted = heavy.sum() * rank / comm.size
            assert below(start) <= wanted + comm.size  # each rank rounds down
            assert start == np.iinfo(np.int64).max or below(start + (1 << 14)) > wanted - 200


@pytest.mark.mpi(ranks=(2, 3))
def test_counts_per_brick_are_those_of_numpy_and_need_no_migration(comm):
    for hierarchy, particles in [
        one_cell(comm),
        *((h, scattered(h, 999)) for h in (hierarchy_of(c, comm) for c in CASES[::9])),
    ]:
        places, counts = weights(particles, hierarchy)
        expected = np.unique(brick_places(hierarchy, particles.position), return_counts=True)
        assert np.array_equal(np.unique(places), expected[0])
        assert np.array_equal(np.bincount(np.searchsorted(expected[0], places), counts), expected[1])
    assert len(_native.count_per_brick(hierarchy.native, np.full((3, 3), np.nan, order="F"))[0]) == 0


@pytest.mark.mpi(ranks=(2, 3, 4), timeout=120)
@pytest.mark.parametrize("matched", [False, True])
def test_messages_of_a_deposit_are_those_that_follow_from_boxes_and_servers(comm, matched):
    """Beside those of a deposit of particles that all live where their cells do: of the ranks that serve a brick the first
    meets the owners of its cells, and the others meet that one."""
    hierarchy, particles = one_cell(comm)
    here, _ = migrate(particles, hierarchy)
    none, _ = migrate(Particles.empty(ONE_KIND), hierarchy)
    clouds = Clouds(matched=matched)
    sent = []
    for some in (none, here):
        deposit(some, hierarchy, clouds)  # owners get to know
        before = traffic()
        deposit(some, hierarchy, clouds)
        sent.append(traffic() - before)
    remote = comm.allgather(here.sorted_on(hierarchy).remote.bricks)
    bricks = np.unique(np.concatenate(remote), axis=0).astype(np.int32)
    places, parts = _native.brick_regions(hierarchy.native, bricks, matched)
    first = np.searchsorted(here.sorted_on(hierarchy).servers[1:-1], places, side="right")
    mine = [bool((brick == remote[comm.rank]).all(axis=1).any()) for brick in bricks]
    owner = np.array([hierarchy.owners(level)[box] for _, level, box, _ in parts], dtype=int)
    server = first[parts[:, 0]]
    to_owners = (server == comm.rank) & (owner != comm.rank)
    to_servers = np.array(mine)[parts[:, 0]] & (server != comm.rank)
    assert comm.allreduce(int(to_owners.sum())) > 0 and comm.allreduce(int(to_servers.sum())) > 0
    assert sent[1].bytes - sent[0].bytes == 8 * (parts[to_owners, 3].sum() + parts[to_servers, 3].sum())
    assert sent[1].messages - sent[0].messages == len(np.unique(owner[to_owners])) + len(np.unique(server[to_servers]))
    assert sent[1].collectives == sent[0].collectives


@pytest.mark.mpi(ranks=(1, 2, 3, 4), timeout=120)
@pytest.mark.parametrize("equal", [False, True], ids=["own weights", "equal weights"])
def test_particles_that_came_in_parts_are_arranged_as_if_they_had_come_at_once(comm, equal):
    for hierarchy, made in [
        one_cell(comm),
        *((h, scattered(h, 500)) for h in (hierarchy_of(c, comm) for c in CASES[::5])),
    ]:
        here, _ = migrate(made, hierarchy)
        if equal:
            here = Particles(here.position, here.momentum, np.broadcast_to(2.5, len(here)), here.id, here.species)
        servers = share_out(comm, *weights(here, hierarchy))
        whole, _ = migrate(here, hierarchy, servers)
        mixed = whole.select(np.random.default_rng(comm.rank).permutation(len(whole)))
        if equal:
            mixed = mixed.with_weight(np.broadcast_to(2.5, len(mixed)))
        expected, _ = migrate(mixed, hierarchy, servers)
        parts = cut([mixed], 3)
        assert [len(part) for part in parts] == np.diff(len(mixed) * np.arange(4) // 3).tolist()
        found = arranged(parts, hierarchy, servers)
        assert parts == [] and found.equal_weights == expected.equal_weights
        for one, other in zip(found.arrays, expected.arrays, strict=True):
            assert np.array_equal(one, other)
        sorting, wanted = found.sorted_on(hierarchy), expected.sorted_on(hierarchy)
        assert np.array_equal(sorting.starts, wanted.starts)
        assert np.array_equal(sorting.remote.bricks, wanted.remote.bricks)


@pytest.mark.mpi(ranks=(2,))
def test_particles_of_other_servers_cannot_be_arranged(comm):
    hierarchy, particles = one_cell(comm)
    here, _ = migrate(particles, hierarchy)
    servers = here.sorted_on(hierarchy).servers
    none_here = np.array([0, 0, servers[-1]] if comm.rank == 0 else [0, servers[-1], servers[-1]])
    with pytest.raises(ValueError, match="must be with their servers"):
        arranged([here], hierarchy, none_here)


@pytest.mark.parametrize("weighted", [False, True])
@pytest.mark.mpi(ranks=(2, 3))
def test_particles_arrive_unchanged_to_the_last_bit(comm, weighted):
    domain = amrpic.Domain((-0.5, -0.5, -0.5), (0.5, 0.5, 0.5), (32, 32, 32), "dirichlet")
    hierarchy = amrpic.Hierarchy(comm, domain, [], max_grid_size=16)
    rng, n = np.random.default_rng(4), 5000
    momentum = rng.integers(0, 2**64, (n, 3), dtype=np.uint64).view(float)  # of any sign and size
    momentum[~np.isfinite(momentum)] = -0.0
    weight = 10.0 ** rng.uniform(-300, 300, n) if weighted else np.broadcast_to(2.5, n)
    ids = rng.permutation(np.concatenate([np.arange(n - 2), [2**62, 2**63 - 1]]))
    made = Particles(rng.uniform(-0.5, 0.5, (n, 3)), momentum, weight, ids, ONE_KIND)
    here, _ = migrate(made.select(slice(comm.rank, None, comm.size)), hierarchy)

    def columns(of: Particles) -> np.ndarray:
        rows = np.column_stack([of.position, of.momentum, of.weight]).view(np.int64)
        return np.column_stack([of.id, rows])[np.argsort(of.id)]

    found = np.concatenate(comm.allgather(columns(here)))
    assert np.array_equal(found[np.argsort(found[:, 0])], columns(made))


@pytest.mark.mpi(ranks=(4,))
def test_particles_travel_in_few_bytes(comm):
    hierarchy, particles = one_cell(comm)
    particles = Particles(
        particles.position, particles.momentum, np.broadcast_to(1.0, len(particles)), particles.id, ONE_KIND
    )
    servers = share_out(comm, *weights(particles, hierarchy))
    before = traffic()
    here, _ = migrate(particles, hierarchy, servers)
    sent = comm.allreduce((traffic() - before).bytes)
    arrived = len(set(here.id.tolist()) - set(particles.id.tolist()))
    assert 30 < sent / comm.allreduce(arrived) < 50  # position, momentum and id alone take 56

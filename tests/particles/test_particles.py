"""Particles find their homes, keep their identity, and move as they should."""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Iterator

import numpy as np
import pytest
from mpi4py import MPI

import amrpic
import backends
import hierarchies
import mpi_batch
from amrpic import _native
from amrpic.errors import ParticleError
from amrpic.particles.arrays import recycled
from amrpic.particles.clouds import Clouds
from amrpic.particles.particles import Particles, concatenate
from amrpic.particles.species import Species, SpeciesTable
from amrpic.stages.deposit import deposit
from amrpic.stages.gather import gather
from amrpic.stages.migrate import migrate
from amrpic.stages.push import IN_CACHE, RANDOM_WALK, push, random_walk
from amrpic.units import SPEED_OF_LIGHT
from particle_cases import (
    CHARGE,
    MASS,
    ONE_KIND,
    Mesh,
    everywhere,
    hierarchy_of,
    placed,
    places,
    random_field,
    scattered,
)

CASES = list(hierarchies.all_cases().values())

BRICK = 8  # cells along each axis, within which particles keep the order that they had


def at(positions: list | np.ndarray, ids: int = 0) -> Particles:
    """Particles at rest at the positions."""
    position = np.array(positions, dtype=float).reshape(-1, 3)
    count = len(position)
    return Particles(position, np.zeros((count, 3)), np.ones(count), np.arange(ids, ids + count), ONE_KIND)


def periodic_box(comm: MPI.Comm) -> amrpic.Hierarchy:
    domain = amrpic.Domain((0, 0, 0), (1, 1, 1), (16, 16, 16), {"x": "periodic", "y": "periodic", "z": "neumann"})
    return amrpic.Hierarchy(comm, domain, [[((8, 0, 8), (15, 31, 23))]], max_grid_size=8)


def slots_of(particles: Particles, hierarchy: amrpic.Hierarchy) -> Iterator[tuple[int, np.ndarray, bool]]:
    """Yield the level and the cells, (6,), of what the slots of particles stand for, and whether it is a remote brick."""
    for level in range(hierarchy.levels):
        for box in hierarchy.local_boxes(level):
            yield level, hierarchy.boxes(level)[box], False
    remote = particles.sorted_on(hierarchy).remote
    yield from zip(remote.bricks[:, 0].tolist(), remote.cells, [True] * len(remote), strict=True)


@pytest.mark.mpi(ranks=(1, 2, 3), timeout=120)
def test_each_particle_lies_in_the_finest_box(comm):
    for case in CASES:
        hierarchy = hierarchy_of(case, comm)
        particles, _ = migrate(scattered(hierarchy, 300), hierarchy)
        mesh, starts = Mesh(hierarchy), particles.sorted_on(hierarchy).starts
        slots = list(slots_of(particles, hierarchy))
        for slot, (level, corners, _) in enumerate(slots):
            for x in particles.position[starts[slot] : starts[slot + 1]]:
                cell = mesh.coordinate(x, level).astype(int)
                assert (corners[:3] <= cell).all() and (cell <= corners[3:]).all(), case.name
                assert mesh.finest(x) == level, case.name
        assert starts[0] == 0 and starts[-1] == len(particles) and len(starts) == len(slots) + 1
        assert particles.sorted_on(hierarchy).levels.tolist() == [level for level, _, _ in slots]


@pytest.mark.mpi(ranks=(1, 2, 3))
def test_migration_changes_no_particle(comm):
    for case in CASES[:8]:
        hierarchy = hierarchy_of(case, comm)
        before = scattered(hierarchy, 500)
        after, lost = migrate(before, hierarchy)
        assert len(lost) == 0
        a, b = everywhere(comm, before), everywhere(comm, after)
        assert all(np.array_equal(a[name], b[name]) for name in a), case.name


@pytest.mark.mpi(ranks=(1, 2))
def test_particles_are_sorted_by_box_and_brick_and_else_keep_their_order(comm):
    hierarchy = periodic_box(comm)
    rng = np.random.default_rng(1)
    ids = rng.permutation(4000)[comm.rank :: comm.size]
    position = np.random.default_rng(2).random((4000, 3))[ids]
    count = len(ids)
    particles = Particles(position, np.zeros((count, 3)), np.ones(count), ids, ONE_KIND)
    before = places(comm, particles)
    particles, _ = migrate(particles, hierarchy)
    keys, starts = [], particles.sorted_on(hierarchy).starts
    for slot, (level, corners, is_remote) in enumerate(slots_of(particles, hierarchy)):
        own = slice(*starts[slot : slot + 2])
        assert own.start < own.stop or not is_remote
        cells = np.floor(particles.position[own] / hierarchy.spacing(level)).astype(int)
        bricks = (cells - corners[:3]) // BRICK
        place = before[particles.id[own]]
        keys += [(slot, *brick[::-1], n) for brick, n in zip(bricks.tolist(), place, strict=True)]
    assert len(keys) == len(particles)
    assert keys == sorted(keys)


@pytest.mark.mpi(ranks=(1, 3), timeout=120)
@pytest.mark.parametrize("cells, box, count", [(64, 32, 260_000), (24, 12, 20_000), (4, 2, 3000), (4, 4, 3000)])
def test_sorting_is_that_of_numpy_for_few_and_many_particles_in_a_brick(comm, cells, box, count):
    """More than a cache holds, so many in a brick that they are copied in parts, bricks that are cut off, and one alone."""
    domain = amrpic.Domain((0, 0, 0), (1, 1, 1), (cells,) * 3, "periodic")
    hierarchy = amrpic.Hierarchy(comm, domain, max_grid_size=box, blocking_factor=2)
    moved = shuffled(comm, count)
    for step in range(3):
        before, walked = places(comm, moved), everywhere(comm, moved)["position"]
        particles, _ = migrate(moved, hierarchy)
        everyone = everywhere(comm, particles)
        cell = np.floor(everyone["position"] * cells).astype(int)
        boxes, own = hierarchy.boxes(0), list(hierarchy.local_boxes(0))
        slot, brick = np.full(count, -1), np.zeros_like(cell)
        for n, (lower, upper) in enumerate(zip(boxes[:, :3], boxes[:, 3:], strict=True)):
            inside = ((cell >= lower) & (cell <= upper)).all(axis=1)
            slot[inside], brick[inside] = n if n in own else len(boxes) + n, (cell[inside] - lower) // BRICK
        wrapped = ((walked < 0) | (walked >= 1)).any(axis=1)
        order = np.lexsort((before, wrapped, *brick.T, slot))
        order = order[np.isin(order, particles.id)]
        assert slot.min() >= 0 and comm.allreduce(len(order)) == count
        assert np.array_equal(particles.id, everyone["id"][order])
        for name in ("position", "momentum", "weight"):
            assert np.array_equal(getattr(particles, name), everyone[name][order]), name
        moved = random_walk(particles, 0.3 / cells, seed=3, step=step)


def shuffled(comm: MPI.Comm, count: int) -> Particles:
    """This rank's part of particles whose places do not depend on the ranks, ids in disorder."""
    rng = np.random.default_rng(11)
    all_of_them = Particles(
        rng.random((count, 3)), rng.normal(size=(count, 3)), rng.random(count), rng.permutation(count), ONE_KIND
    )
    return all_of_them.select(slice(comm.rank, None, comm.size))


@pytest.mark.mpi(ranks=(1, 2, 3))
def test_equal_weights_take_no_memory_and_others_keep_theirs(comm):
    hierarchy = periodic_box(comm)
    many = shuffled(comm, 3000)
    for case, weight in {
        "one for all": np.broadcast_to(2.5, len(many)),
        "one per rank": np.broadcast_to(2.5 + comm.rank, len(many)),
        "one each": 1.0 + many.id,
        "the first rank holds all": np.broadcast_to(2.5, 3000),
        "ranks but the first hold one each": 1.0 + many.id[: None if comm.rank == 0 else 1],
    }.items():
        given = many.select(slice(0, len(weight))) if len(weight) <= len(many) else shuffled(MPI.COMM_SELF, 3000)
        if case == "the first rank holds all" and comm.rank > 0:
            given, weight = given.select(slice(0, 0)), weight[:0]
        before = Particles(given.position, given.momentum, weight, given.id, ONE_KIND)
        after, _ = migrate(before, hierarchy)
        again, _ = migrate(random_walk(after, 0.02, seed=1, step=0), hierarchy)
        equal = case in ("one for all", "the first rank holds all") or (case == "one per rank" and comm.size == 1)
        assert (after.weight.strides == again.weight.strides == (0,)) == equal or len(after) < 2, case
        for found in (after, again):
            a, b = everywhere(comm, before), everywhere(comm, found)  # some were lost at walls
            assert np.array_equal(b["weight"], a["weight"][np.searchsorted(a["id"], b["id"])]), case
        single = Particles(before.position, before.momentum, np.array(before.weight), before.id, ONE_KIND)
        rho = [deposit(migrate(p, hierarchy)[0], hierarchy) for p in (before, single)]
        for level in range(hierarchy.levels):
            assert backends.same_sums(rho[0].array(level), rho[1].array(level)), case
        joined = concatenate([after, again])
        assert np.array_equal(joined.weight, np.concatenate([after.weight, again.weight])), case


@pytest.mark.mpi(ranks=(1, 2))
def test_a_momentum_that_is_not_finite_is_found_wherever_the_particle_goes(comm):
    """Among those that stay and those that leave, in whole vectors and in the rest of one."""
    hierarchy = periodic_box(comm)
    for count, place in ((1, 0), (8, 7), (9, 8), (1000, 500)):
        particles, _ = migrate(shuffled(comm, comm.size * count), hierarchy)
        for shift in (0.0, 0.5):
            moved = particles.replace(
                position=particles.position + np.array([shift, 0, 0]), momentum=particles.momentum.copy()
            )
            if comm.rank == 0 and len(moved) > place:
                moved.momentum[place, 2] = np.inf
            if comm.bcast(len(moved) > place):
                with pytest.raises(ParticleError, match=r"^1 particles .* not finite"):
                    migrate(moved, hierarchy)


def test_memory_of_particles_is_used_again_and_not_hoarded():
    kept = [recycled(1_000_000, np.float64) for _ in range(2)]
    assert all(array.ctypes.data % 64 == 0 for array in kept)
    before = _native.idle_bytes()
    place = kept.pop().ctypes.data
    assert _native.idle_bytes() >= before
    assert recycled(999_000, np.float64).ctypes.data == place  # of nearly the same size
    part = recycled(1_000_000, np.float64)[10:20]
    assert recycled(1_000_000, np.float64).ctypes.data != place  # the slice keeps it
    del part
    kept.clear()
    huge = recycled(50_000_000, np.float64)
    del huge
    assert _native.idle_bytes() < 8 * 50_000_000


def test_idle_memory_makes_room_for_other_sizes():
    code = """if True:
        import numpy as np
        from amrpic import _native
        from amrpic.particles.arrays import recycled
        kept = [recycled(n, np.float64) for n in 3 * [1_000_000]]
        kept.pop()
        idle = _native.idle_bytes()
        assert idle > 7e6, idle
        kept.append(recycled(900_000, np.float64))  # with what lies idle there were more than there ever was
        assert _native.idle_bytes() == 0, _native.idle_bytes()
    """
    subprocess.run([sys.executable, "-c", code], env=mpi_batch.ENVIRONMENT, check=True)


@pytest.mark.mpi(ranks=(1, 2))
def test_a_point_on_a_face_belongs_to_the_cell_above(comm):
    hierarchy = amrpic.Hierarchy(
        comm, amrpic.Domain((0, 0, 0), (1, 1, 1), (16, 16, 16)), [[((8, 8, 8), (23, 23, 23))]], blocking_factor=8
    )
    below = np.nextafter(0.25, 0)
    corners = at(
        [(0.25, 0.25, 0.25), (below, 0.25, 0.25), (0.75, 0.5, 0.5), (np.nextafter(0.75, 0), 0.5, 0.5), (0, 0, 0)]
    )
    mine = corners if comm.rank == 0 else corners.select(slice(0))
    inside, lost = migrate(mine, hierarchy)
    sorting = inside.sorted_on(hierarchy)
    on_level = np.bincount(sorting.levels, np.diff(sorting.starts), hierarchy.levels)
    assert comm.allreduce(on_level).tolist() == [3, 2]
    assert len(lost) == 0


@pytest.mark.mpi(ranks=(1, 2, 3))
def test_periodic_axes_wrap_and_walls_lose(comm):
    hierarchy = periodic_box(comm)
    points = [
        (1.25, -0.5, 0.5),
        (1.0, 0.0, 0.0),
        (-1e-30, 7.75, 0.5),
        (0.5, 0.5, 1.0),
        (0.5, 0.5, -1e-9),
        (1e300, -1e300, 0.5),
        (0.5, 0.5, 1 + 1e-9),
    ]
    mine = at(points) if comm.rank == 0 else at([])
    inside, lost = migrate(mine, hierarchy)
    found = everywhere(comm, inside)
    assert found["id"].tolist() == [0, 1, 2, 3, 5]  # what lies on a wall is inside
    assert found["position"][:3] == pytest.approx(np.array([(0.25, 0.5, 0.5), (0, 0, 0), (0, 0.75, 0.5)]), abs=1e-15)
    assert ((found["position"] >= 0) & (found["position"] < [1, 1, np.nextafter(1, 2)])).all()
    gone = everywhere(comm, lost)
    assert gone["id"].tolist() == [4, 6]
    assert gone["position"].tolist() == [[0.5, 0.5, -1e-9], [0.5, 0.5, 1 + 1e-9]]


@pytest.mark.mpi(ranks=(3, 4), timeout=60)
def test_ranks_that_worked_together_before_work_with_others(comm):
    """A new communicator may get the handle of a freed one on some of its ranks; what was known of that one is forgotten."""
    for ranks in (2, 3, 2, comm.size, 2, comm.size):
        part = comm.Split(color=0 if comm.rank < ranks else MPI.UNDEFINED)
        if part == MPI.COMM_NULL:
            continue
        hierarchy = periodic_box(part)
        here, lost = migrate(scattered(hierarchy, 300), hierarchy)
        assert part.allreduce(len(here)) == 300 and len(lost) == 0
        part.Free()


@pytest.mark.mpi(ranks=(1, 2, 3))
@pytest.mark.parametrize("value", [np.nan, np.inf, -np.inf])
@pytest.mark.parametrize("what", ["position", "momentum"])
def test_values_that_are_not_finite_are_an_error_on_all_ranks(comm, what, value):
    hierarchy = periodic_box(comm)
    particles = at([(0.5, 0.5, 0.5)] * 4, ids=10 * comm.rank)
    if comm.rank != 0 or comm.size == 1:
        getattr(particles, what)[2, 1] = value
    bad, first = (1, 2) if comm.size == 1 else (comm.size - 1, 12)
    with pytest.raises(ParticleError, match=f"^{bad} particles .* not finite, .* id {first} ") as caught:
        migrate(particles, hierarchy)
    assert len(set(comm.allgather(str(caught.value)))) == 1


@pytest.mark.mpi(ranks=(1, 2, 3))
def test_random_walk_does_not_depend_on_ranks(comm):
    def walked(comm: MPI.Comm) -> dict[str, np.ndarray]:
        hierarchy = periodic_box(comm)
        particles, _ = migrate(scattered(hierarchy, 3000), hierarchy)
        for step in range(3):
            particles, _ = migrate(random_walk(particles, 0.05, seed=7, step=step), hierarchy)
        return everywhere(comm, particles)

    alone, together = walked(MPI.COMM_SELF), walked(comm)
    assert 2000 < len(alone["id"]) < 3000
    assert all(np.array_equal(alone[name], together[name]) for name in alone)


def test_random_walk_is_uniform_and_new_at_each_step():
    particles = at(np.zeros((100_000, 3)))
    first, second = (random_walk(particles, 2e-3, seed=1, step=s).position for s in (0, 1))
    assert np.abs(first).max() < 2e-3
    assert np.abs(first.mean(axis=0)).max() < 5 * 2e-3 / np.sqrt(3e5)
    assert first.var(axis=0) == pytest.approx(np.full(3, 4e-6 / 3), rel=5 * np.sqrt(0.8 / 1e5))
    draws = np.concatenate([first.T, second.T])
    assert np.abs(np.corrcoef(draws) - np.eye(6)).max() < 5 / np.sqrt(1e5)


def test_random_walk_of_many_particles_is_that_of_each(count=IN_CACHE + 5):
    moved = random_walk(at(np.zeros((count, 3))), 1.0, seed=1, step=0).position
    for n in (0, IN_CACHE - 1, IN_CACHE, count - 1):
        alone = random_walk(at(np.zeros((1, 3)), ids=n), 1.0, seed=1, step=0).position
        assert np.array_equal(moved[n : n + 1], alone)


def test_random_numbers_are_those_of_philox():
    """NumPy's generator steps its counter once before the first draw."""
    particles = at(np.zeros((5, 3)), ids=41)
    for n, move in enumerate(random_walk(particles, 1.0, seed=99, step=6).position):
        key, counter = np.array([99, RANDOM_WALK], dtype=np.uint64), np.array([41 + n - 1, 6, 0, 0], dtype=np.uint64)
        words = np.random.Philox(key=key, counter=counter).random_raw(3)
        assert move == pytest.approx(2 * (words.astype(float) / 2.0**64) - 1, abs=1e-14)


@pytest.mark.mpi(ranks=(1, 2), timeout=120)
def test_kicks_and_drift_are_those_of_the_field_that_is_gathered(comm):
    """On many boxes with a few particles each, and with more particles than a cache holds."""
    for case, count in ((CASES[0], 300), (CASES[3], 2000), (CASES[3], 250_000 * comm.size)):
        hierarchy, particles = placed(case, comm, count)
        fields = [random_field(hierarchy) for _ in range(3)]
        for factor, field in enumerate(fields):
            for patch in field.patches:
                patch.data[...] *= factor + 1
        efield = amrpic.VectorField(*fields)
        for clouds in (Clouds(), Clouds("nearest-grid-point"), Clouds("triangular-shaped-cloud", matched=True)):
            felt = gather(efield, particles, clouds)
            assert len(felt) == 0 or np.abs(felt[:, 2]).max() > 0
            moved = push(efield, particles, 2e-9, 3e-9, 4e-31, clouds)
            assert_close(moved.momentum, particles.momentum + 5e-9 * CHARGE * felt)
            u = moved.momentum / (MASS * SPEED_OF_LIGHT)
            gamma = np.sqrt(1 + (u**2).sum(axis=1, keepdims=True))
            assert_close(moved.position, particles.position + 4e-31 / MASS * moved.momentum / gamma)
            assert moved.id is particles.id and moved.sorting is None
            between = push(efield, particles, 2e-9, 0.0, 0.0, clouds)
            assert np.array_equal(between.position, particles.position)
            onward = push(efield, particles.replace(momentum=between.momentum), 0.0, 3e-9, 4e-31, clouds)
            assert np.array_equal(onward.momentum, moved.momentum)
            assert np.array_equal(onward.position, moved.position)


def assert_close(found: np.ndarray, expected: np.ndarray) -> None:
    """To a few roundings of the largest value: terms of different sign may cancel."""
    assert np.abs(found - expected).max(initial=0) <= 1e-15 * np.abs(expected).max(initial=0)


@pytest.mark.mpi(ranks=(1, 2, 3))
def test_no_particles_migrate_and_move(comm):
    hierarchy = periodic_box(comm)
    particles, lost = migrate(Particles.empty(ONE_KIND), hierarchy)
    assert len(particles) == len(lost) == 0
    nothing = amrpic.Field(hierarchy)
    pushed = push(amrpic.VectorField(nothing, nothing, nothing), particles, 1.0, 1.0, 1.0)
    assert pushed.momentum.shape == (0, 3)
    moved = random_walk(pushed, 1.0, 0, 0)
    assert len(migrate(moved, hierarchy)[0]) == 0
    assert moved.global_count(comm) == 0 and moved.total_charge(comm) == 0


def test_particles_join_in_order():
    one, none, two = at(np.zeros((3, 3))), at([]), at(np.ones((2, 3)), ids=3)
    joined = concatenate([one, none, two])
    assert joined.id.tolist() == [0, 1, 2, 3, 4]
    assert joined.position[:, 0].tolist() == [0, 0, 0, 1, 1]
    with pytest.raises(ParticleError, match="cannot join"):
        concatenate([one, Particles.empty(SpeciesTable((Species(charge=CHARGE, mass=2 * MASS),)))])


def test_arrays_that_do_not_fit_together_are_refused():
    with pytest.raises(ParticleError, match=r"\(n, 3\)"):
        Particles(np.zeros((3, 2)), np.zeros((3, 3)), np.ones(3), np.arange(3), ONE_KIND)
    with pytest.raises(ParticleError, match="4 values of weight"):
        Particles(np.zeros((3, 3)), np.zeros((3, 3)), np.ones(4), np.arange(3), ONE_KIND)

"""What the plan of open walls comes to on ranks that do not exist: the mesh of the reference benchmark, charge in all cells."""

from __future__ import annotations

import numpy as np
import pytest
from mpi4py import MPI

from amrpic import Domain, Field, Hierarchy
from amrpic._native import FreeSpace, OpenWallPlans, traffic

RANKS = (720, 2880, 13824)


def first_boxes(hierarchy, ranks):
    """Per level, where the run of boxes of each rank begins: about equally many cells each."""
    out = []
    for level in range(hierarchy.levels):
        corners = hierarchy.boxes(level)
        cells = np.prod(corners[:, 3:] - corners[:, :3] + 1, axis=1)
        middle = np.cumsum(cells) - cells / 2
        borders = cells.sum() * np.arange(1, ranks) / ranks
        out.append([0, *np.searchsorted(middle, borders).tolist(), len(cells)])
    return out


@pytest.fixture(scope="module")
def counts():
    """Counts of 16 ranks spread over all, by number of ranks."""
    n, centres = 576, np.linspace(-0.9, 0.9, 10) * 288 + 288

    def around(half, level):
        scale = 1 << level
        lower = [np.maximum(np.array([x, x, 288]) - half, 0) * scale // 8 * 8 for x in centres]
        return [(tuple(a.astype(int)), tuple((a + 2 * half * scale - 1).astype(int))) for a in lower]

    domain = Domain((0, 0, 0), (1, 1, 1), (n,) * 3, "open")
    hierarchy = Hierarchy(MPI.COMM_SELF, domain, [around(24, 1), around(16, 2)], max_grid_size=24, blocking_factor=8)
    out = {}
    for ranks in RANKS:
        plans = OpenWallPlans(hierarchy.native, first_boxes(hierarchy, ranks))
        out[ranks] = [plans.counts(int(rank)) for rank in np.linspace(0, ranks - 1, 16)]
    return out


def mean(counts, ranks, key):
    return np.mean([found[key] for found in counts[ranks]])


def slope(counts, key):
    return np.polyfit(np.log(RANKS), np.log([mean(counts, ranks, key) for ranks in RANKS]), 1)[0]


@pytest.mark.parametrize(
    ("key", "most"),
    [
        ("patches", -0.95),
        ("far", -0.9),
        ("near", -0.9),
        ("leaves_received", -0.5),
        ("nodes_received", -0.35),
        ("bytes", -0.3),
    ],
)
def test_work_and_bytes_of_a_rank_fall_with_the_ranks(counts, key, most):
    assert slope(counts, key) < most


def test_no_rank_meets_most_others(counts):
    for ranks in RANKS[1:]:
        assert max(found["messages"] for found in counts[ranks]) < 0.3 * ranks
    assert max(found["messages"] for found in counts[13824]) < 1000
    assert max(found["received_messages"] for found in counts[13824]) < 300


def test_collectives_are_two_of_64_kb_at_most(counts):
    for found in counts.values():
        for of_rank in found:
            assert len(of_rank["collectives"]) == 2
            assert max(of_rank["collectives"]) <= 64 << 10


@pytest.mark.mpi(ranks=(2, 3, 4))
@pytest.mark.parametrize(
    "boundary",
    [
        "open",
        {"z": ["dirichlet", "open"]},
        {"z": "periodic"},
        {"x": ["open", "neumann"], "y": "dirichlet", "z": "periodic"},
    ],
    ids=["open", "cathode", "long beam", "three kinds beside it"],
)
def test_counts_are_those_of_a_solve(comm, boundary):
    domain = Domain((0, 0, 0), (1, 1, 1), (32,) * 3, boundary)
    hierarchy = Hierarchy(comm, domain, [[((0, 8, 8), (31, 39, 31))]], max_grid_size=12, blocking_factor=4)
    rho = Field(hierarchy).fill(lambda x, y, z: 1 + x + 0 * y + 0 * z)
    space = FreeSpace(hierarchy.native)
    before = traffic()
    space.walls(rho.native)
    messages, sent, collectives = (b - a for a, b in zip(before, traffic(), strict=True))
    expected = OpenWallPlans(hierarchy.native).counts(comm.rank)
    assert (messages, collectives) == (expected["messages"], len(expected["collectives"]))
    assert sent == expected["bytes"]


@pytest.mark.mpi(ranks=(2, 3, 4))
def test_nodes_below_the_top_are_shared_where_they_are_few(comm):
    domain = Domain((0, 0, 0), (1, 1, 1), (64,) * 3, "open")
    hierarchy = Hierarchy(comm, domain, [[((32, 64, 64), (63, 95, 95))]], max_grid_size=16, blocking_factor=8)
    regions = [((0, 0, 0), (16, 8, 8)), ((48, 48, 48), (64, 64, 64))]  # in cells

    def density(x, y, z):
        inside = [np.ones(np.broadcast(x, y, z).shape, dtype=bool) for _ in regions]
        for of_region, (lower, upper) in zip(inside, regions, strict=True):
            for values, low, high in zip((x, y, z), lower, upper, strict=True):
                of_region &= (64 * values > low) & (64 * values < high)
        return (inside[0] | inside[1]).astype(float)

    rho, found = Field(hierarchy).fill(density), {}
    for fewest in (2, 33):
        space = FreeSpace(hierarchy.native, fewest_sharing_ranks=fewest)
        before = traffic()
        values = space.walls(rho.native)
        sent = tuple(b - a for a, b in zip(before, traffic(), strict=True))
        expected = OpenWallPlans(hierarchy.native, fewest_sharing_ranks=fewest).counts(comm.rank, regions)
        assert sent == (expected["messages"], expected["bytes"], len(expected["collectives"]))
        found[fewest] = values, len(expected["collectives"])
    assert found[33][1] == 2 < found[2][1]
    for shared, sent_alone in zip(found[2][0], found[33][0], strict=True):  # faces, cells and values of a level
        assert all(np.array_equal(a, b) for a, b in zip(shared, sent_alone, strict=True))

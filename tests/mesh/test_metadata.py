"""What every rank holds of all boxes: little, once, and found fast."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from amrpic import Domain, Hierarchy
from amrpic.mesh.boxes import table_of, unique_rows

MOST = 200  # bytes per box and level


def resident() -> int:
    """Bytes that this process holds."""
    return int(Path("/proc/self/statm").read_text().split()[1]) * 4096


def cube(cells: int) -> Domain:
    return Domain((0, 0, 0), (1, 1, 1), (cells, cells, cells), "dirichlet")


def lattice(start: int, size: int, step: int, count: int) -> np.ndarray:
    """Boxes of `size` cells along each axis, `step` apart."""
    lower = start + step * np.stack(np.meshgrid(*3 * [np.arange(count)], indexing="ij"), axis=-1).reshape(-1, 3)
    return np.hstack([lower, lower + size - 1])


@pytest.mark.parametrize(
    "rows",
    [
        np.random.default_rng(1).integers(-3, 5, (400, 3)),
        np.random.default_rng(2).integers(0, 2**40, (50, 2)).repeat(2, axis=0),  # not numbered by an integer
        np.array([[7, -1]], dtype=np.int32),
        np.zeros((0, 4), dtype=np.int64),
    ],
    ids=["small", "large", "one", "none"],
)
def test_different_rows_are_those_of_numpy(rows):
    found, which = unique_rows(rows)
    assert np.array_equal(found, np.unique(rows, axis=0)) and np.array_equal(found[which], rows)


@pytest.mark.mpi(ranks=(1, 2))
def test_a_box_takes_few_bytes_on_each_rank(comm):
    """1e5 boxes that start on multiples of their size, and boxes each of which meets eight bins of the look-up."""
    before = resident()
    even = Hierarchy(comm, cube(47 * 8), max_grid_size=8)
    boxes = len(even.boxes(0))
    assert boxes > 1e5 and even.native.metadata_bytes(0) <= 64 * boxes
    assert resident() - before <= MOST * boxes, "what is held is not all counted"
    odd = Hierarchy(comm, cube(24 * 32), [lattice(8, 24, 48, 32)])
    assert 150 * 32**3 < odd.native.metadata_bytes(1) <= MOST * 32**3


def test_hierarchies_share_the_boxes_that_stay(comm):
    """A refined level moves: of the base, which stays, nothing is held twice."""
    held = Hierarchy(comm, cube(47 * 8), [lattice(8, 8, 16, 8)], max_grid_size=8)
    boxes, before, made = len(held.boxes(0)), resident(), [held]
    for shift in range(2, 22):
        made.append(Hierarchy(comm, held.domain, [lattice(8 * shift, 8, 16, 8)], 8, 8, earlier=made[-1]))
    assert all(one.native.same_boxes(held.native, 0) for one in made)
    assert not made[1].same_mesh(held)
    assert resident() - before < 0.2 * 20 * held.native.metadata_bytes(0), boxes


def test_looking_boxes_up_agrees_with_comparing_all():
    rng = np.random.default_rng(3)
    lower = 5 * np.unique(rng.integers(-8, 8, (600, 3)), axis=0)
    boxes = np.hstack([lower, lower + rng.integers(0, 5, lower.shape)])  # disjoint, of 1 to 5 cells along each axis
    table = table_of(boxes)
    regions = np.hstack([low := rng.integers(-45, 45, (200, 3)), low + rng.integers(0, 20, (200, 3))])
    for region in regions:
        meets = np.all((boxes[:, :3] <= region[3:]) & (region[:3] <= boxes[:, 3:]), axis=1)
        assert table.meeting(region[:3].tolist(), region[3:].tolist()).tolist() == np.flatnonzero(meets).tolist()
        assert bool(table.meets(region[None].astype(np.int32))[0]) == meets.any()
    cells = rng.integers(-45, 45, (20_000, 3)).astype(np.int32)
    holds = np.all((boxes[:, None, :3] <= cells) & (cells <= boxes[:, None, 3:]), axis=2)
    assert table.find(cells).tolist() == np.where(holds.any(axis=0), holds.argmax(axis=0), -1).tolist()
    assert (table.find(cells) >= 0).sum() > 100

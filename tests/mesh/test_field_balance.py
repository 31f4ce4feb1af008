"""Cells are shared out evenly over any number of ranks, from boxes alone: virtual ranks stand for real ones."""

from __future__ import annotations

import itertools

import numpy as np
import pytest

import amrpic
from amrpic import _native
from amrpic.mesh.boxes import cells_of
from exact.virtual_rank import VirtualRank
from regions import blocks_of

BLOCK = 8


def balls(centres: np.ndarray, radius: float) -> set[tuple[int, ...]]:
    """Blocks with their middles within a radius of centres, all in cells."""
    out = set()
    for centre in centres:
        ranges = [range(int((c - radius) // BLOCK), int((c + radius) // BLOCK) + 1) for c in centre]
        for block in itertools.product(*ranges):
            if np.sum((BLOCK * (np.array(block) + 0.5) - centre) ** 2) < radius**2:
                out.add(block)
    return out


def clustered(blocks: set[tuple[int, ...]]) -> np.ndarray:
    """Boxes of cells, (n, 6), as the code makes them of refined blocks."""
    boxes = _native.cluster(np.array(sorted(blocks), dtype=np.int32), 0.7)
    return np.hstack([boxes[:, :3] * BLOCK, (boxes[:, 3:] + 1) * BLOCK - 1])


def ten_bunches(ranks: int) -> amrpic.Hierarchy:
    """The reference benchmark: 576 cells along each axis, boxes of 24, two refined levels around ten bunches."""
    centres = np.array([(288.3, 287.6, 28.8 + 57.6 * n) for n in range(10)])
    second = clustered(balls(4 * centres, 75))
    around = balls(2 * centres, 38)
    for box in second:
        lower, upper = (box[:3] // 2 - 2) // BLOCK, (box[3:] // 2 + 2) // BLOCK
        around.update(itertools.product(*(range(a, b + 1) for a, b in zip(lower, upper, strict=True))))
    domain = amrpic.Domain((0, 0, 0), (1, 1, 1), (576,) * 3, boundary="open")
    return amrpic.Hierarchy(VirtualRank(0, ranks), domain, [clustered(around), second], max_grid_size=24)


def cells_by_rank(mesh: amrpic.Hierarchy, level: int) -> np.ndarray:
    return np.bincount(mesh.owners(level), weights=cells_of(mesh.boxes(level)), minlength=mesh.comm.size)


@pytest.mark.parametrize("ranks", [720, 2880, 5760, 13824])
def test_field_work_of_the_reference_benchmark_is_balanced(ranks):
    """A cycle visits one level after another: its cost is the sum over levels of the fullest rank's cells."""
    mesh = ten_bunches(ranks)
    cells = [cells_by_rank(mesh, level) for level in range(3)]
    assert sum(c.max() for c in cells) / sum(c.mean() for c in cells) <= 1.11  # 1.05, 1.05, 1.10, 1.02
    assert len(mesh.boxes(0)) <= 2 * 24**3, "most boxes stay whole"


@pytest.mark.parametrize("ranks", [1, 2, 3, 7, 60])
@pytest.mark.parametrize("blocking", [2, 8, 16])
def test_halved_boxes_refine_the_same_cells_and_stay_thick_enough(ranks, blocking):
    levels = [[((16, 16, 16), (79, 47, 63))], [((64, 64, 64), (127, 79, 111))]]
    domain = amrpic.Domain((0, 0, 0), (1, 1, 1), (51, 40, 40))
    whole, cut = (amrpic.Hierarchy(VirtualRank(0, n), domain, levels, 32, blocking) for n in (1, ranks))
    assert all(cells_by_rank(whole, level)[0] == cells_by_rank(cut, level).sum() for level in range(3))
    for level in range(3):
        assert blocks_of(whole, level) == blocks_of(cut, level)
        boxes, sizes = cut.boxes(level), cells_by_rank(cut, level)
        extent = boxes[:, 3:] - boxes[:, :3] + 1
        least = (whole.boxes(level)[:, 3:] - whole.boxes(level)[:, :3] + 1).min()
        assert extent.min() >= min(8, least) and np.all(boxes[:, :3] % blocking == 0)
        half = extent // blocking // 2 * blocking
        can_be_halved = np.any((half >= 8) & (extent - half >= 8), axis=1)
        ends = np.cumsum(cells_of(boxes))
        begins, share = np.concatenate([[0], ends[:-1]]), ends[-1] / ranks
        lies_across = (begins // share + 1) * share < ends - 1e-6
        is_overfull = (sizes > 1.1 * sizes.mean())[cut.owners(level)]
        assert not np.any(can_be_halved & lies_across & is_overfull)


@pytest.mark.parametrize(
    ("cells", "axis"), [((64, 64, 64), 2), ((72, 64, 16), 1), ((64, 16, 64), 2), ((96, 64, 16), 0)]
)
def test_two_ranks_meet_in_a_plane_that_cuts_few_rows(cells, axis):
    """Across the longest axis, but across x, along which rows of cells lie, only where that is the longest by a quarter."""
    mesh = amrpic.Hierarchy(VirtualRank(0, 2), amrpic.Domain((0, 0, 0), (1, 1, 1), cells), max_grid_size=8)
    boxes, owners = mesh.boxes(0), mesh.owners(0)
    lower, upper = boxes[owners == 0], boxes[owners == 1]
    assert lower[:, 3 + axis].max() < upper[:, axis].min()

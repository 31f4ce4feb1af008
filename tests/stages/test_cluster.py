"""Clustering of tagged cells: everything tagged is refined, boxes are lawful and tight, on any decomposition."""

from __future__ import annotations

import numpy as np
import pytest
from mpi4py import MPI

from amrpic import Domain, Hierarchy, _native
from amrpic.errors import HierarchyError
from amrpic.mesh.domain import BoundarySpec
from amrpic.stages.regrid import Regridding, regrid
from amrpic.stages.tag import magnitude, static_boxes
from rank_subsets import wait_quietly
from regions import coarser, finer, grown, mask, same_region

CELLS = (32, 24, 40)


# ---- shapes: bool arrays over all cells of a level ----
def grid(cells):
    """Cell centres in the unit cube, broadcastable."""
    axes = [(np.arange(n) + 0.5) / n for n in cells]
    return axes[0][:, None, None], axes[1][None, :, None], axes[2][None, None, :]


def blobs(cells):
    rng = np.random.default_rng(7)
    x, y, z = grid(cells)
    out = np.zeros(cells, dtype=bool)
    for centre in rng.random((4, 3)):
        out |= (x - centre[0]) ** 2 + (y - centre[1]) ** 2 + (z - centre[2]) ** 2 < 0.1**2
    return out


def shell(cells):
    x, y, z = grid(cells)
    r = np.sqrt((x - 0.5) ** 2 + (y - 0.5) ** 2 + (z - 0.5) ** 2)
    return (r > 0.27) & (r < 0.33)


def wall(cells):
    x, y, z = grid(cells)
    return (x < 0.1) & (y > 0.8) & (z > 0.3)


def corner(cells):
    return np.logical_and.reduce(np.broadcast_arrays(*[x > 0.97 for x in grid(cells)]))


def checkerboard(cells):
    x, y, z = np.ogrid[tuple(map(slice, cells))]
    return ((x // 8 + y // 8 + z // 8) % 2 == 0) & (x % 8 == 3) & (y % 8 == 3) & (z % 8 == 3)


def speckle(cells):
    return np.random.default_rng(3).random(cells) < 2e-3


def nothing(cells):
    return np.zeros(cells, dtype=bool)


def everything(cells):
    return np.ones(cells, dtype=bool)


SHAPES = [blobs, shell, wall, corner, checkerboard, speckle]
PERIODIC = {"x": "periodic", "y": "dirichlet", "z": "periodic"}


# ---- the code under test ----
def mesh(
    comm: MPI.Comm, boundary: BoundarySpec = "open", blocking_factor: int = 8, max_grid_size: int = 16
) -> Hierarchy:
    domain = Domain((0, 0, 0), (1, 1, 1), CELLS, boundary)
    return Hierarchy(comm, domain, max_grid_size=max_grid_size, blocking_factor=blocking_factor)


def tags_of(hierarchy: Hierarchy, shape):
    """Tags on all levels: the shape, drawn anew in the resolution of each."""
    whole = [shape(tuple(n * 2**level for n in CELLS)) for level in range(hierarchy.levels)]
    return [cut_out(hierarchy, level, whole[level]) for level in range(hierarchy.levels)]


def cut_out(hierarchy: Hierarchy, level: int, whole: np.ndarray) -> np.ndarray:
    boxes = [hierarchy.boxes(level)[b] for b in hierarchy.local_boxes(level)]
    parts = [whole[a : d + 1, b : e + 1, c : f + 1].ravel(order="F") for a, b, c, d, e, f in boxes]
    return np.concatenate([np.zeros(0, dtype=bool), *parts])


def grow_mesh(hierarchy: Hierarchy, shape, settings: Regridding) -> Hierarchy:
    """Regrid until the mesh stays."""
    for _ in range(2 * settings.max_levels):
        finer = regrid(hierarchy, tags_of(hierarchy, shape), settings)
        if finer is hierarchy:
            return hierarchy
        hierarchy = finer
    raise AssertionError("the mesh does not settle")


# ---- the laws, by brute force on arrays over the whole domain ----
def check_laws(hierarchy: Hierarchy, tags: list[np.ndarray], settings: Regridding) -> None:
    """`tags`: over the whole domain, per level; only those on cells of the level count."""
    periodic = hierarchy.domain.periodic
    for level in range(1, hierarchy.levels):
        boxes = hierarchy.boxes(level)
        assert np.all(boxes[:, :3] % hierarchy.blocking_factor == 0)
        assert np.all((boxes[:, 3:] + 1) % hierarchy.blocking_factor == 0)
        assert np.all(boxes[:, 3:] - boxes[:, :3] < hierarchy.max_grid_size)
        assert np.all(boxes[:, :3] >= 0) and np.all(boxes[:, 3:] < np.array(CELLS) * 2**level)
        covered = mask(hierarchy, level)
        assert covered.max() == 1, "boxes overlap"

        marked = tags[level - 1] & (mask(hierarchy, level - 1) == 1)
        assert not np.any(finer(grown(marked, settings.buffer, periodic)) & (covered == 0)), (
            "a tagged cell is not refined"
        )
        around = grown(coarser(covered == 1), settings.nesting, periodic)
        assert not np.any(around & (mask(hierarchy, level - 1) == 0)), "the level is not nested"


@pytest.mark.mpi(ranks=(1, 2, 3), timeout=120)
@pytest.mark.parametrize("blocking_factor", [2, 4, 8])
@pytest.mark.parametrize("boundary", ["open", PERIODIC], ids=["walls", "periodic"])
@pytest.mark.parametrize("shape", SHAPES)
def test_tagged_cells_are_refined_by_lawful_boxes(comm, shape, boundary, blocking_factor):
    settings = Regridding(max_levels=3, buffer=1 + blocking_factor % 3, nesting=2)
    hierarchy = grow_mesh(mesh(comm, boundary, blocking_factor), shape, settings)
    assert hierarchy.levels == 3
    if comm.rank == 0:  # all ranks hold the same boxes
        check_laws(hierarchy, [shape(tuple(n * 2**level for n in CELLS)) for level in range(2)], settings)
    wait_quietly(comm)


@pytest.mark.mpi(ranks=(1, 2, 3))
@pytest.mark.parametrize("shape", SHAPES)
def test_boxes_do_not_depend_on_ranks_and_box_sizes(comm, shape):
    settings = Regridding(max_levels=3)
    together = grow_mesh(mesh(comm, PERIODIC), shape, settings)
    if comm.rank == 0:
        assert same_region(together, grow_mesh(mesh(MPI.COMM_SELF, PERIODIC), shape, settings))
    wait_quietly(comm)
    for size in (8, 24, 32):
        other = grow_mesh(mesh(comm, PERIODIC, max_grid_size=size), shape, settings)
        for level in range(1, together.levels):
            assert np.array_equal(mask(other, level), mask(together, level))


@pytest.mark.mpi(ranks=(1, 2, 3))
def test_nothing_tagged_gives_the_base_and_everything_tagged_gives_all(comm):
    settings = Regridding(max_levels=3)
    assert grow_mesh(mesh(comm), nothing, settings).levels == 1
    refined = grow_mesh(mesh(comm), blobs, settings)
    assert regrid(refined, tags_of(refined, nothing), settings).levels == 1
    assert regrid(refined, [], settings).levels == 1
    whole = grow_mesh(mesh(comm), everything, settings)
    assert [whole.cells(level) for level in range(3)] == [8**level * int(np.prod(CELLS)) for level in range(3)]


@pytest.mark.mpi(ranks=(1, 2))
def test_a_cell_in_the_corner_of_a_periodic_domain_refines_all_eight_corners(comm):
    hierarchy = regrid(mesh(comm, "periodic"), tags_of(mesh(comm, "periodic"), corner), Regridding(buffer=2))
    covered = mask(hierarchy, 1)
    assert [covered[i, j, k] for i in (0, -1) for j in (0, -1) for k in (0, -1)] == [1] * 8
    assert hierarchy.cells(1) == 8 * 8**3


@pytest.mark.mpi(ranks=(1, 2))
def test_a_fine_tag_on_a_face_of_its_level_enlarges_the_level(comm):
    """What the finest level needs goes before what the coarser ones ask for."""
    hierarchy = Hierarchy(comm, mesh(comm).domain, [[((16, 16, 16), (31, 31, 31))]])
    fine = np.zeros(np.array(CELLS) * 2, dtype=bool)
    fine[16, 16, 16] = True
    tags = [cut_out(hierarchy, 0, nothing(CELLS)), cut_out(hierarchy, 1, fine)]
    settings = Regridding(max_levels=3, buffer=1, nesting=2)
    out = regrid(hierarchy, tags, settings)
    # buffered cells 15-17 make blocks 8-23 of level 1; two cells around those reach from 6 to 25
    assert np.array_equal(out.boxes(2)[:, :3].min(axis=0), [24, 24, 24])
    assert np.array_equal(out.boxes(1)[:, :3].min(axis=0), [8, 8, 8])
    check_laws(out, [nothing(CELLS), fine], settings)


def test_boxes_are_as_full_as_asked_and_cover_exactly_once():
    rng = np.random.default_rng(11)
    for trial in range(60):
        size = rng.integers(1, 24, 3)
        density = rng.choice([0.003, 0.05, 0.3, 0.8])
        marks = rng.random(size) < density
        if trial % 2:
            marks = grown(marks, 1, (False, False, False))
        blocks = np.argwhere(marks).astype(np.int32)
        for efficiency in (0.3, 0.7, 0.9, 1.0):
            boxes = _native.cluster(rng.permutation(blocks), efficiency)
            covered = np.zeros(size, dtype=int)
            for box in boxes:
                part = tuple(slice(a, b + 1) for a, b in zip(box[:3], box[3:], strict=True))
                covered[part] += 1
                assert marks[part].mean() >= efficiency or marks[part].size == 1
            assert covered.max(initial=0) <= 1 and np.all(covered[marks] == 1)
            assert np.array_equal(boxes, _native.cluster(blocks, efficiency))
            if efficiency == 1:
                assert covered.sum() == marks.sum()


def test_separate_bunches_get_boxes_of_their_own_and_a_cuboid_gets_one():
    marks = np.zeros((30, 30, 30), dtype=bool)
    corners = [(0, 0, 0), (5, 20, 1), (20, 4, 20)]
    for a, b, c in corners:
        marks[a : a + 4, b : b + 6, c : c + 3] = True
    boxes = _native.cluster(np.argwhere(marks).astype(np.int32), 0.7)
    assert sorted(map(tuple, boxes.tolist())) == [(a, b, c, a + 3, b + 5, c + 2) for a, b, c in corners]


def test_an_l_is_cut_at_its_knee():
    marks = np.zeros((10, 10, 3), dtype=bool)
    marks[:3], marks[:, :3] = True, True
    boxes = _native.cluster(np.argwhere(marks).astype(np.int32), 0.9)
    assert len(boxes) == 2 and sum(np.prod(b[3:] - b[:3] + 1) for b in boxes) == marks.sum()


def test_a_ball_is_filled_by_few_boxes_with_little_excess():
    x, y, z = grid((32, 32, 32))
    ball = np.argwhere((x - 0.5) ** 2 + (y - 0.5) ** 2 + (z - 0.5) ** 2 < 0.4**2).astype(np.int32)
    boxes = _native.cluster(ball, 0.7)
    assert len(boxes) < 64  # of 8744 blocks
    assert sum(np.prod(b[3:] - b[:3] + 1) for b in boxes) < 1.3 * len(ball)


@pytest.mark.mpi(ranks=(1, 2))
def test_static_regions_come_at_once_aligned_outward_and_nested(comm):
    base = mesh(comm, PERIODIC)
    regions = [(2, (0.4, 0.4, 0.4), (0.6, 0.6, 0.6)), (1, (-0.05, 0.0, 0.7), (0.02, 0.2, 0.8))]
    static = static_boxes(base.domain, regions)
    out = regrid(base, [], Regridding(max_levels=3), static)
    assert out.levels == 3
    for level, boxes in enumerate(static, start=1):
        for box in boxes:
            cells = np.ix_(*[np.arange(box[d], box[d + 3] + 1) % (CELLS[d] * 2**level) for d in range(3)])
            assert np.all(mask(out, level)[cells] == 1)
    check_laws(out, [nothing(CELLS), nothing(tuple(2 * n for n in CELLS))], Regridding(nesting=2))
    assert regrid(out, [], Regridding(max_levels=3), static) is out


def test_a_region_on_cell_faces_takes_exactly_its_cells():
    domain = Domain((-0.15,) * 3, (0.15,) * 3, (96, 96, 96))
    box = static_boxes(domain, [(1, (-0.075, 0.0, -0.15), (0.075, 0.15, 1.0))])[0]
    assert box.tolist() == [[48, 96, 0, 143, 191, 191]]


@pytest.mark.mpi(ranks=(1, 2))
def test_bad_input_is_refused_on_all_ranks(comm):
    hierarchy = mesh(comm)
    tags = tags_of(hierarchy, blobs)
    wrong = [tags[0][:-1]] if comm.rank == comm.size - 1 else tags
    with pytest.raises(HierarchyError, match="give one per cell"):
        regrid(hierarchy, wrong, Regridding())
    with pytest.raises(HierarchyError, match="2 levels"):
        regrid(hierarchy, [*tags, tags[0]], Regridding())
    with pytest.raises(HierarchyError, match="max_levels is 2"):
        regrid(hierarchy, tags, Regridding(), [np.zeros((0, 6)), np.zeros((0, 6))])
    with pytest.raises(HierarchyError, match="is empty"):
        regrid(hierarchy, tags, Regridding(), [np.array([[8, 8, 8, 7, 7, 7]])])
    with pytest.raises(HierarchyError, match="use fewer levels"):
        regrid(hierarchy, [], Regridding(max_levels=99), [np.zeros((0, 6))] * 40 + [np.zeros((1, 6))])
    for bad in ({"max_levels": 0}, {"buffer": -1}, {"nesting": 0}, {"efficiency": 0}, {"efficiency": 1.5}):
        with pytest.raises(HierarchyError, match=f"{next(iter(bad))} of the regridding is"):
            Regridding(**bad)
    for region, message in [
        ((0, (0, 0, 0), (1, 1, 1)), "start at 1"),
        ((90, (0, 0, 0), (1, 1, 1)), "use fewer levels"),
        ((1, (0, 0, 0), (1, 0, 1)), "no volume"),
        ((1, (0, 0, 0), (1, np.nan, 1)), "no volume"),
        ((1, (2, 0, 0), (3, 1, 1)), "outside the domain"),
    ]:
        with pytest.raises(HierarchyError, match=message):
            static_boxes(hierarchy.domain, [region])


@pytest.mark.mpi(ranks=(1, 2))
def test_density_that_is_not_finite_is_refused_on_all_ranks(comm):
    from amrpic import Field

    rho = Field(mesh(comm)).fill(lambda x, y, z: x + y + z)
    if comm.rank == comm.size - 1:
        rho.array(0)[0] = np.nan
    with pytest.raises(HierarchyError, match="not finite"):
        magnitude(rho, "charge density")

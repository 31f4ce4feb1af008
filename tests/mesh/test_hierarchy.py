"""Hierarchies: boxes and their order, fields on them, and what is refused."""

from __future__ import annotations

import numpy as np
import pytest
from mpi4py import MPI

import amrpic
from amrpic import _native
from amrpic.errors import AmrpicError, HierarchyError
from amrpic.parallel import traffic
from exact.virtual_rank import VirtualRank, seen_by

DOMAIN = amrpic.Domain((0, 0, 0), (1, 1, 1), (16, 16, 16))
MIDDLE = [((8, 8, 8), (23, 23, 23))]


def hierarchy(levels=(), domain=DOMAIN, **options):
    return amrpic.Hierarchy(MPI.COMM_SELF, domain, levels, **options)


@pytest.mark.parametrize(
    ("levels", "complaint"),
    [
        ([[((8, 8, 8), (23, 23, 22))]], r"box \(8, 8, 8\)-\(23, 23, 22\) of level 1 is not aligned .* 8 along z"),
        ([[((4, 8, 8), (19, 23, 23))]], "not aligned to the blocking factor 8 along x"),
        ([[((8, 8, 8), (31, 30, 31))]], r"8 along y; start it on a multiple .* or end it at the domain's upper face"),
        ([[((8, 8, 8), (39, 23, 23))]], "leaves the domain"),
        ([[((16, 8, 8), (15, 23, 23))]], "is empty"),
        ([[*MIDDLE, ((16, 16, 16), (31, 31, 31))]], "overlaps .* must be disjoint"),
        ([MIDDLE, [((16, 16, 16), (31, 31, 31))]], r"of level 2 does not nest: level 1 must surround it"),
        ([[((8.5, 8, 8), (23, 23, 23))]], "not pairs of three whole numbers"),
        ([[((8, 8, 8), (23, 23))]], "not pairs of three whole numbers"),
        ([[((8, 8, 2**40), (23, 23, 2**41))]], "beyond 32 bits"),
    ],
)
def test_boxes_that_cannot_be_are_refused_by_name(levels, complaint):
    with pytest.raises(HierarchyError, match=complaint):
        hierarchy(levels)


@pytest.mark.parametrize(
    ("options", "complaint"),
    [
        ({"blocking_factor": 3}, "blocking_factor is 3; it must be a power of two"),
        ({"max_grid_size": 4}, "max_grid_size is 4, less than the blocking factor 8"),
        ({"domain": amrpic.Domain((0, 0, 0), (1, 1, 1), (2**20,) * 3)}, "more than the .* that 1 ranks can number"),
        ({"base": np.array([[0, 0, 0, 15, 15, 7]])}, "given for level 0 have 2048 of the domain's 4096 cells"),
        ({"base": np.array([[0, 0, 0, 15, 15, 15], [0, 0, 0, 7, 7, 7]])}, "of level 0 overlaps"),
        (
            {"domain": amrpic.Domain((0, 0, 0), (1, 1, 1), (16,) * 3, {"x": ("periodic", "open")})},
            "one face of axis x is periodic and the other is not",
        ),
    ],
)
def test_settings_that_cannot_be_are_refused(options, complaint):
    with pytest.raises(HierarchyError, match=complaint):
        hierarchy(**options)


@pytest.mark.mpi(ranks=(2, 3, 4))
def test_boxes_and_their_order_are_those_of_one_rank(comm):
    levels = [MIDDLE, [((24, 24, 24), (39, 39, 39))]]
    alone = hierarchy(levels, max_grid_size=8)
    together = amrpic.Hierarchy(comm, DOMAIN, levels, max_grid_size=8)
    for level in range(3):
        assert np.array_equal(alone.boxes(level), together.boxes(level))
        owners = together.owners(level)
        assert np.all(np.diff(owners) >= 0) and set(owners) == set(range(comm.size))


@pytest.mark.mpi(ranks=(1, 2, 3, 4))
def test_virtual_ranks_have_the_boxes_of_real_ones(comm):
    levels = [MIDDLE, [((24, 24, 24), (39, 39, 39))]]
    real = amrpic.Hierarchy(comm, DOMAIN, levels, max_grid_size=8)
    first = amrpic.Hierarchy(VirtualRank(0, comm.size), DOMAIN, levels, max_grid_size=8)
    for unreal in seen_by(first, comm.rank), amrpic.Hierarchy(VirtualRank(comm.rank, comm.size), DOMAIN, levels, 8):
        assert (unreal.comm.rank, unreal.comm.size) == (comm.rank, comm.size)
        for level in range(3):
            assert np.array_equal(unreal.boxes(level), real.boxes(level))
            assert np.array_equal(unreal.owners(level), real.owners(level))
            assert unreal.local_boxes(level) == real.local_boxes(level)


def test_few_ranks_meet_in_planes():
    domain = amrpic.Domain((0, 0, 0), (1, 1, 1), (144, 144, 144))
    for ranks, cells in ((2, (144, 144, 72)), (4, (144, 72, 72)), (8, (72, 72, 72))):
        for rank in range(ranks):
            mesh = amrpic.Hierarchy(VirtualRank(rank, ranks), domain, max_grid_size=24)
            own = mesh.boxes(0)[mesh.owners(0) == rank]
            assert len(own) == 216 // ranks
            assert tuple(own[:, 3:].max(axis=0) - own[:, :3].min(axis=0) + 1) == cells


def test_virtual_ranks_count_what_they_would_send():
    mesh = amrpic.Hierarchy(VirtualRank(3, 720), DOMAIN)
    before = traffic()
    assert mesh.comm.allreduce(1) == 1 and mesh.comm.allgather("a") == ["a"]
    laplacian = _native.CompositeLaplacian(mesh.native, (1, 1, 1))
    laplacian.diagonal_norm(amrpic.Field(mesh).native, _native.Norm.max)
    assert (traffic() - before).collectives >= 3
    with pytest.raises(AmrpicError, match="rank 3 of 720 is virtual and has no Ibarrier"):
        mesh.comm.Ibarrier()
    with pytest.raises(ValueError, match="virtual rank 720 is not one of 720; give one from 0 to 719"):
        seen_by(mesh, 720)
    with pytest.raises(HierarchyError, match="ranks that run"):
        seen_by(hierarchy(), 0)


def test_given_base_boxes_are_taken_as_they_are():
    levels = [MIDDLE, [((24, 24, 24), (39, 39, 39))]]
    halved = amrpic.Hierarchy(VirtualRank(0, 7), DOMAIN, levels, max_grid_size=16)
    assert len(halved.boxes(0)) > 1
    again = hierarchy([halved.boxes(1), halved.boxes(2)], max_grid_size=16, base=halved.boxes(0))
    assert again.same_mesh(halved)


def test_boxes_are_cut_to_size_and_cover_what_was_asked():
    made = hierarchy([[((0, 0, 0), (31, 31, 15))]], max_grid_size=16)
    boxes = made.boxes(1)
    assert np.all(boxes[:, 3:] - boxes[:, :3] < 16)
    assert made.cells(1) == 32 * 32 * 16 == np.prod(boxes[:, 3:] - boxes[:, :3] + 1, axis=1).sum()


def test_patches_are_views_with_x_fastest():
    field = amrpic.Field(hierarchy([MIDDLE]), unit="V")
    patch = field.patches[-1]
    assert patch.level == 1 and (patch.lower, patch.upper) == ((8, 8, 8), (23, 23, 23))
    patch.data[3, 0, 0] = 5.0
    assert field.array(1)[3] == 5.0
    x, y, z = patch.centres()
    assert (x.ravel()[0], y.ravel()[1], z.ravel()[2]) == pytest.approx((8.5 / 32, 9.5 / 32, 10.5 / 32))


def test_a_product_of_fields_on_two_hierarchies_is_refused():
    one, other = (amrpic.Field(hierarchy([MIDDLE])) for _ in range(2))
    assert one.integral(one) == 0
    with pytest.raises(HierarchyError, match="live on two hierarchies"):
        one.integral(other)


@pytest.mark.mpi(ranks=(1, 2, 3))
def test_integral_and_mean_count_each_place_once(comm):
    made = amrpic.Hierarchy(comm, DOMAIN, [MIDDLE], max_grid_size=8)
    field = amrpic.Field(made).fill(lambda x, y, z: x + 2 * y + 3 * z)
    assert field.integral() == pytest.approx(3.0, rel=1e-14)
    for patch in field.patches:
        if patch.level == 0:
            patch.data[patch.covered] = -7.0
    assert field.integral() == pytest.approx(3.0, rel=1e-14)
    field.average_down()
    x, y, z = 0.34375, 0.53125, 0.40625  # the centre of a covered base cell
    for patch in field.patches:
        if patch.level == 0 and patch.covered.any():
            centres = np.broadcast_arrays(*patch.centres())
            expected = centres[0] + 2 * centres[1] + 3 * centres[2]
            assert patch.data[patch.covered] == pytest.approx(expected[patch.covered], rel=1e-13)
    assert field.sample([[x, y, z]])[0] == pytest.approx(x + 2 * y + 3 * z, rel=1e-13)


def test_points_outside_have_no_value_and_far_periodic_ones_do():
    field = amrpic.Field(hierarchy()).fill(lambda x, y, z: x + 0 * y * z)
    assert np.isnan(field.sample([[1.5, 0.5, 0.5], [np.nan, 0, 0]])).all()
    assert field.sample([[0.5, 1.0, 0.0]])[0] == pytest.approx(0.5)

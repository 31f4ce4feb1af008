"""Cells of refined meshes around points, by index, and stencils that cells with equal surroundings share."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from mpi4py import MPI

import amrpic
from amrpic import gmls
from amrpic.errors import InputError
from exact.virtual_rank import VirtualRank


def mesh() -> amrpic.Hierarchy:
    domain = amrpic.Domain(lower=(-1, 0, 2), upper=(1, 3, 4), cells=(16, 16, 16), boundary="dirichlet")
    levels = [[((8, 8, 0), (23, 23, 15))], [((24, 24, 8), (39, 39, 23))]]
    return amrpic.Hierarchy(MPI.COMM_SELF, domain, levels, max_grid_size=8, blocking_factor=4)


def uncovered(hierarchy: amrpic.Hierarchy) -> np.ndarray:
    """Numbers of the cells that no finer level covers, from the masks of the boxes."""
    masks = [
        ~hierarchy.native.covered(level, box).astype(bool).ravel(order="F")
        for level in range(hierarchy.levels)
        for box in range(len(hierarchy.boxes(level)))
    ]
    return np.flatnonzero(np.concatenate(masks))


def test_cells_around_points_are_those_that_a_search_in_space_finds():
    hierarchy = mesh()
    sites, widths = gmls.cells(hierarchy)
    leaves = uncovered(hierarchy)
    points = np.random.default_rng(1).uniform([-1, 0, 2], [1, 3, 4], (60, 3))
    radius = np.linspace(0.1, 0.4, 60)
    found = gmls.cells_around(hierarchy, points, radius)
    for p in range(60):
        distance = np.linalg.norm(sites[leaves] - points[p], axis=1)
        assert np.array_equal(found.index[found.start[p] : found.start[p + 1]], leaves[distance <= radius[p]])
    assert np.isclose((widths.prod(axis=1))[leaves].sum(), 12)


def test_more_cells_than_32_bits_number_are_refused():
    domain = amrpic.Domain((0, 0, 0), (1, 1, 1), (2048, 1024, 1024), boundary="dirichlet")
    many = amrpic.Hierarchy(VirtualRank(0, 64), domain, max_grid_size=256)
    sentence = (
        "the hierarchy has 2147483648 cells; stencils can number 2147483647 at most; take fewer levels or wider cells"
    )
    for search in (lambda: gmls.cells_around(many, [[0.5, 0.5, 0.5]], 1e-3), lambda: gmls.leaves_around(many, 1.0)):
        with pytest.raises(InputError, match=f"^{sentence}$"):
            search()


@pytest.mark.parametrize("reach", [1.0, 2.1, 3.3])
def test_leaves_around_leaves_are_cells_around_their_centres(reach):
    hierarchy = mesh()
    sites, widths = gmls.cells(hierarchy)
    leaves, near = gmls.leaves_around(hierarchy, reach)
    assert np.array_equal(leaves, uncovered(hierarchy))
    radius = reach * widths[leaves].max(axis=1)
    assert np.allclose(near.reach, radius, rtol=1e-15)
    found = gmls.cells_around(hierarchy, sites[leaves], radius)
    assert np.array_equal(found.start, near.start)
    of = np.repeat(np.arange(len(leaves)), np.diff(near.start))
    assert np.array_equal(found.index, near.index[np.lexsort((near.index, of))])
    assert near.kind is not None and near.representative is not None
    # of one kind are those that have cells at equal offsets, in equal order, and no others
    offsets = np.rint((sites[near.index] - sites[leaves][of]) / (hierarchy.spacing(2) / 2)).astype(int)
    kinds: dict[tuple, int] = {}
    for t, kind in enumerate(near.kind):
        key = (widths[leaves[t]].tobytes(), offsets[near.start[t] : near.start[t + 1]].tobytes())
        assert kinds.setdefault(key, kind) == kind
    assert sorted(kinds.values()) == list(range(len(near.representative)))
    assert np.array_equal(near.kind[near.representative], np.arange(len(near.representative)))


def test_leaves_share_stencils_that_are_their_own():
    hierarchy = mesh()
    sites, widths = gmls.cells(hierarchy)
    leaves, near = gmls.leaves_around(hierarchy, 2.7)
    wanted = [gmls.VALUE, gmls.GRADIENT]
    arguments: dict[str, Any] = dict(space=gmls.Scalar(2), samples=gmls.Points(sites), wanted=wanted)
    shared = gmls.stencils(sites[leaves], near, lattice=hierarchy.spacing(2) / 2, **arguments)
    own = gmls.stencils(sites[leaves], gmls.Neighbours(near.start, near.index, near.reach), **arguments)
    assert len(shared.solved) < 0.6 * len(own.solved) and shared.weights.shape == own.weights.shape
    assert np.abs(shared.weights - own.weights).max() < 1e-11 * np.abs(own.weights).max()
    values = np.sin(sites.sum(axis=1))
    for name in ("value", "gradient"):
        assert abs(shared.matrix(name) - own.matrix(name)).max() < 1e-11 * abs(own.matrix(name)).max()
        assert np.allclose(shared.apply(values)[name], own.apply(values)[name], rtol=0, atol=1e-11)


@pytest.mark.parametrize("reach", [0.9, 0.0, np.nan, np.inf, 1e6])
def test_a_reach_that_tells_nothing_is_refused(reach):
    with pytest.raises(InputError, match=r"reach"):
        gmls.leaves_around(mesh(), reach)


def test_a_field_on_one_rank_is_numbered_in_the_same_way():
    hierarchy = mesh()
    field = amrpic.Field(hierarchy)
    field.fill(lambda x, y, z: x + 10 * y + 100 * z)
    sites, _ = gmls.cells(hierarchy)
    values = np.concatenate([field.array(level) for level in range(hierarchy.levels)])
    assert np.allclose(values[uncovered(hierarchy)], (sites @ [1, 10, 100])[uncovered(hierarchy)])


@pytest.mark.parametrize("order", [1, 2])
def test_stencils_that_cells_share_are_their_own(order):
    hierarchy = mesh()
    sites, widths = gmls.cells(hierarchy)
    leaves = uncovered(hierarchy)[::3]
    targets = sites[leaves]
    near = gmls.cells_around(hierarchy, targets, (1.3 + 0.7 * order) * widths[leaves].max(axis=1))
    samples = gmls.WithLaplacian(sites, widths, 1 / 30)
    arguments: dict[str, Any] = dict(space=gmls.Scalar(order), samples=samples, wanted=[gmls.VALUE, gmls.GRADIENT])
    unit = hierarchy.spacing(hierarchy.levels - 1) / 2
    own = gmls.stencils(targets, near, **arguments)
    assert own.quality.growth.max() == 0
    shared = gmls.stencils(targets, near, lattice=unit, **arguments)
    for name in ("value", "gradient"):
        a, b = own.matrix(name), shared.matrix(name)
        assert abs(a - b).max() < 1e-11 * abs(a).max()
    _, representative, kind = near.equal_surroundings(targets, sites, unit)
    assert len(representative) < 0.8 * len(targets)
    assert len(kind) == len(targets)


def test_a_lattice_that_does_not_hold_the_sites_is_refused():
    x = np.random.default_rng(0).uniform(size=(100, 3))
    near = gmls.nearby(x, x, order=1)
    with pytest.raises(InputError, match=r"target 0 has a site that is not on the lattice; leave it out"):
        gmls.stencils(
            x, near, space=gmls.Scalar(1), samples=gmls.Points(x), wanted=[gmls.VALUE], lattice=[0.1, 0.1, 0.1]
        )

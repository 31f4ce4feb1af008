"""Cells of refined meshes around points, by index, and stencils that cells with equal surroundings share."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from mpi4py import MPI

import amrpic
from amrpic import gmls
from amrpic.errors import InputError


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


def test_a_field_on_one_rank_is_numbered_alike():
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

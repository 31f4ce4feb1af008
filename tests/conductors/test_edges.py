"""Cells at edges and strong curvature: near the edges of bodies, all along them, and nowhere else."""

import numpy as np
import pytest

from amrpic import Electrode, shapes
from amrpic.conductors.edges import edge_cells

N, H = 32, 2 / 32


def cells_at_edges(shape, boxes=None):
    """Return centres (n, 3) of the cells, in cell widths."""
    rows = boxes or [[0, 0, 0, N - 1, N - 1, N - 1]]
    places = []
    for row, cells in zip(rows, edge_cells([Electrode("e", shape, voltage=1)], rows, -1.0, H), strict=True):
        size = np.subtract(row[3:], row[:3]) + 1
        places.append(np.column_stack(np.unravel_index(cells, size[::-1]))[:, ::-1] + row[:3])
    index = np.concatenate(places)
    return (-1 + H * (index + 0.5))[np.lexsort(index.T)] / H


def rim(radius, centre, normal, n=400):
    """Return points of a circle, in cell widths."""
    normal = np.array(normal) / np.linalg.norm(normal)
    one = np.cross(normal, (0.3, -0.5, 0.8))
    one /= np.linalg.norm(one)
    phase = np.linspace(0, 2 * np.pi, n)[:, None]
    return (centre + radius * (np.cos(phase) * one + np.sin(phase) * np.cross(normal, one))) / H


def nearest(places, others):
    return np.sqrt(((places[:, None] - others) ** 2).sum(axis=2)).min(axis=1)


EDGES = {
    "disk": (shapes.Disk((0, 0, 0.01), (0, 0, 1), 0.5), rim(0.5, (0, 0, 0.01), (0, 0, 1))),
    "tilted disk": (shapes.Disk((0, 0, 0.01), (1, 2, 3), 0.5), rim(0.5, (0, 0, 0.01), (1, 2, 3))),
    "cylinder": (
        shapes.Cylinder((0, 0, -0.51), (0, 0, 0.52), 0.5),
        np.concatenate([rim(0.5, (0, 0, z), (0, 0, 1)) for z in (-0.51, 0.52)]),
    ),
    "hole in a foil": (
        shapes.Disk((0, 0, 0.01), (0, 0, 1), 3) - shapes.Cylinder((0, 0, -1), (0, 0, 1), 0.4),
        rim(0.4, (0, 0, 0.01), (0, 0, 1)),
    ),
}


@pytest.mark.parametrize("name", EDGES)
def test_cells_lie_all_along_the_edge_and_beside_it(name):
    shape, edge = EDGES[name]
    places = cells_at_edges(shape)
    assert nearest(places, edge).max() < 2
    assert nearest(edge, places).max() < 1.5


def test_edges_of_a_box_are_found_and_its_faces_left_alone():
    lower, upper = np.array((-0.51, -0.43, -0.37)), np.array((0.52, 0.41, 0.33))
    places = cells_at_edges(shapes.Box(tuple(lower), tuple(upper))) * H
    gaps = np.sort(np.minimum(abs(places - lower), abs(places - upper)) / H, axis=1)
    assert gaps[:, 1].max() < 1.5
    length = 4 * (upper - lower).sum() / H
    assert 1.5 * length < len(places) < 4 * length


def test_smooth_surfaces_have_none_until_they_are_strongly_curved():
    assert len(cells_at_edges(shapes.Sphere((0.01, 0.02, 0.03), 0.5))) == 0
    assert len(cells_at_edges(shapes.Sphere((0.01, 0.02, 0.03), 2.5 * H))) > 50


def test_hollows_and_gaps_have_none():
    hollow = shapes.Box((-0.9,) * 3, (0.9,) * 3) - shapes.Box((-0.41,) * 3, (0.43,) * 3)
    places = cells_at_edges(hollow) * H
    assert (abs(places) > 0.6).any(axis=1).all()


@pytest.mark.parametrize("size", [8, 16])
def test_cells_do_not_depend_on_boxes(size):
    starts = range(0, N, size)
    boxes = [[i, j, k, i + size - 1, j + size - 1, k + size - 1] for k in starts for j in starts for i in starts]
    for shape, _ in EDGES.values():
        assert np.array_equal(cells_at_edges(shape, boxes), cells_at_edges(shape))


def test_edges_of_bodies_without_edges_on_these_cells_are_none():
    assert len(cells_at_edges(shapes.Plane((0, 0, 0.01), (0, 0, 1)))) == 0
    assert len(cells_at_edges(shapes.Sphere((9, 0, 0), 1))) == 0

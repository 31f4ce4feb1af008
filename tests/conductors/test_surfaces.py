"""Surfaces of electrodes for eyes: quadrilaterals that enclose the body, and pixels of a plane."""

from __future__ import annotations

import numpy as np
import pytest

from amrpic import Domain, Electrode, shapes
from amrpic.conductors.surface import in_plane, outline, quadrilaterals
from amrpic.io import surface_files

FAR = (-9, -9, -9), (9, 9, 9)


def volume_and_area(points: np.ndarray, quads: np.ndarray) -> tuple[float, float]:
    """Return what faces enclose, by the divergence theorem over the two triangles of each, and their area."""
    a, b, c, d = np.moveaxis(points[quads], 1, 0)
    first, second = np.cross(b - a, c - a), np.cross(c - a, d - a)
    area = np.linalg.norm(first, axis=1).sum() / 2 + np.linalg.norm(second, axis=1).sum() / 2
    return float(((a * first).sum() + (a * second).sum()) / 6), float(area)


@pytest.mark.parametrize(
    "shape, volume, area",
    [
        (shapes.Sphere((0.1, 0.2, 0.3), 1.5), 4.5 * np.pi, 9 * np.pi),
        (shapes.Torus((0, 0, 0), (1, 2, 3), 2, 0.5), np.pi**2, 4 * np.pi**2),
        (shapes.Box((0, 0, 0), (1, 2, 3)), 6, 22),
    ],
)
def test_quadrilaterals_enclose_the_body_and_face_outwards(shape, volume, area):
    measured = volume_and_area(*quadrilaterals(shape, *FAR))
    assert measured == pytest.approx((volume, area), rel=0.03)


def test_each_edge_of_a_closed_surface_has_two_faces():
    _, quads = quadrilaterals(shapes.Box((-1, -1, -1), (1, 1, 1)) - shapes.Sphere((1, 1, 1), 0.9), *FAR, cells=20)
    edges = np.sort(np.concatenate([quads[:, [n, (n + 1) % 4]] for n in range(4)]), axis=1)
    _, times = np.unique(edges, axis=0, return_counts=True)
    assert (times % 2 == 0).all()


def test_foils_have_one_layer_of_faces():
    points, quads = quadrilaterals(shapes.Disk((0, 0, 0.013), (1, 2, 3), 1.0), *FAR)
    assert abs(points @ np.array([1, 2, 3]) / np.sqrt(14) - 0.013 * 3 / np.sqrt(14)).max() < 1e-12
    assert volume_and_area(points, quads)[1] == pytest.approx(np.pi, rel=0.05)


def test_a_body_without_end_is_cut_at_the_domain():
    points, _ = quadrilaterals(shapes.Plane((0, 0, 0), (0, 0, 1)), (-1, -1, -1), (1, 1, 1), cells=8)
    assert (abs(points) < 1 + 2 * 0.25).all() and abs(points[:, 2]).max() < 1e-12


def test_pixels_of_a_plane_are_those_inside_and_at_the_surface():
    shape = shapes.Sphere((0, 0, 0), 1.0) - shapes.Cylinder((0, 0, -2), (0, 0, 2), 0.4)
    pixels = (120, 90)
    metal, surface = in_plane(shape, (2, 0), 0.1, (-1.5, -1.2), (1.5, 1.2), pixels)
    z, x = (np.linspace(-e, e, n, endpoint=False) + e / n for e, n in zip((1.5, 1.2), pixels, strict=True))
    places = np.stack(np.broadcast_arrays(x[None, :], 0.1, z[:, None]), axis=-1).reshape(-1, 3)
    assert np.array_equal(metal, shape.inside(places).reshape(pixels))
    grown = np.pad(metal, 1)
    beside = [np.roll(grown, s, axis)[1:-1, 1:-1] for s in (1, -1) for axis in (0, 1)]
    border = metal & ~np.logical_and.reduce(beside)
    near = np.logical_or.reduce([surface, *(np.roll(surface, s, axis) for s in (1, -1) for axis in (0, 1))])
    assert (near[border]).all() and surface.sum() < 2.5 * border.sum()
    foil, seen = in_plane(shapes.Disk((0, 0, 0), (0, 0, 1), 1.0), (2, 0), 0.0, (-1.5, -1.2), (1.5, 1.2), pixels)
    assert not foil.any() or foil.sum() <= pixels[1]
    assert seen.any(axis=0).sum() == pytest.approx(pixels[1] * 2 / 2.4, abs=2)


def test_an_outline_is_the_rim_of_the_shadow_of_what_lies_in_the_depth():
    pair = shapes.Sphere((0, 0, 0), 1.0) | shapes.Sphere((0, 3, 0), 1.2)
    for depth, radius in (((-2.0, 1.5), 1.0), ((-2.0, 5.0), 1.2)):
        rim = outline(pair, (2, 0), depth, (-1.5, -1.5), (1.5, 1.5), (120, 120))
        distance = np.linalg.norm((np.argwhere(rim) + 0.5) * 3 / 120 - 1.5, axis=1)
        assert distance.max() < radius and distance.min() > radius - 0.04
        assert rim.sum() > 2 * np.pi * radius * 120 / 3 * 0.8
    # What goes on beyond the picture has no rim there.
    assert not outline(shapes.Box((-9,) * 3, (9,) * 3), (0, 1), (-1.0, 1.0), (-1, -1), (1, 1), (20, 20)).any()


def test_the_vtk_file_has_the_faces_of_all_electrodes(tmp_path):
    vtk = pytest.importorskip("vtk")
    path = tmp_path / "electrodes.vtk"
    electrodes = [
        Electrode("ball", shapes.Sphere((0, 0, 0), 0.5), voltage=1),
        Electrode("foil", shapes.Disk((0, 0, 0.8), (0, 0, 1), 0.5), charge=0),
    ]
    surface_files.write(path, electrodes, Domain(-1, 1, 8))
    reader = vtk.vtkPolyDataReader()
    reader.SetFileName(str(path))
    reader.Update()
    surface = reader.GetOutput()
    owner = surface.GetCellData().GetArray("electrode")
    counts = [len(quadrilaterals(e.shape, (-1,) * 3, (1,) * 3)[1]) for e in electrodes]
    assert [owner.GetValue(n) for n in range(surface.GetNumberOfCells())] == [0] * counts[0] + [1] * counts[1]
    assert surface.GetBounds()[5] == pytest.approx(0.8)

"""Field maps: files by the openPMD standard, interpolation between their nodes, and one sentence for each mistake."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pytest

from amrpic.errors import InputError
from amrpic.external import ExternalFields
from amrpic.io import field_maps
from amrpic.scene.elements import MapElement

DIMENSION = {"E": (1, 1, -3, -1, 0, 0, 0), "B": (0, 1, -2, -1, 0, 0, 0)}
Values = dict[str, np.ndarray]
Records = dict[str, Values]


def write(
    path: Path,
    records: Records,
    spacing: tuple[float, ...],
    lower: tuple[float, ...],
    geometry: str = "cartesian",
    order: str = "C",
    grid_unit: float = 1.0,
    unit: float = 1.0,
    **attributes: Any,
) -> Path:
    """Write components, given in SI units with indices in the order of their axes, by the openPMD standard 1.1."""
    labels = ["r", "z"] if geometry == "thetaMode" else ["x", "y", "z"]
    with h5py.File(path, "w") as h5:
        h5.attrs.update({"openPMD": "1.1.0", "basePath": "/data/%T/", "meshesPath": "fields/"})
        for name, components in records.items():
            mesh = h5.create_group(f"data/5/fields/{name}")
            mesh.attrs.update({"geometry": geometry, "dataOrder": order, "gridUnitSI": grid_unit})
            mesh.attrs["axisLabels"] = np.array(labels, dtype="S")
            mesh.attrs["gridSpacing"] = np.array(spacing) / grid_unit
            mesh.attrs["gridGlobalOffset"] = np.array(lower) / grid_unit
            mesh.attrs["unitDimension"] = np.array(DIMENSION[name], dtype=float)
            mesh.attrs.update(attributes)
            for key, values in components.items():
                stored = values[None] if geometry == "thetaMode" and values.ndim == 2 else values
                mesh[key] = (stored.T if order == "F" else stored) / unit
                mesh[key].attrs["unitSI"] = unit
    return path


def fields_of(path: Path, **more: Any) -> ExternalFields:
    return ExternalFields([MapElement(kind="map", file=str(path), **more)])


def parabola(seed: int) -> Callable[..., Any]:
    """A polynomial of x, y, z of degree 2 in each."""
    c = np.random.default_rng(seed).normal(size=(3, 3, 3))
    return lambda x, y, z: np.polynomial.polynomial.polyval3d(x, y, z, c)


LOWER, SPACING, SHAPE = (-0.3, -0.2, 1.0), (0.1, 0.07, 0.05), (7, 6, 9)
NODES = np.meshgrid(*(a + h * np.arange(n) for a, h, n in zip(LOWER, SPACING, SHAPE, strict=True)), indexing="ij")
UPPER = tuple(a + h * (n - 1) for a, h, n in zip(LOWER, SPACING, SHAPE, strict=True))


def cartesian(seed: int = 0) -> Records:
    return {
        name: {axis: parabola(3 * seed + d)(*NODES) * scale for d, axis in enumerate("xyz")}
        for name, scale in (("E", 1e5), ("B", 0.1))
    }


@pytest.mark.parametrize("order, grid_unit, unit", [("C", 1.0, 1.0), ("F", 1e-3, 1e-2)])
def test_map_reproduces_parabolas_up_to_its_edges(tmp_path, order, grid_unit, unit):
    file = write(tmp_path / "map.h5", cartesian(), SPACING, LOWER, order=order, grid_unit=grid_unit, unit=unit)
    places = np.random.default_rng(1).uniform(LOWER, UPPER, (500, 3))
    E, B = fields_of(file, iteration=5).fields(places)
    for d in range(3):
        expected = parabola(d)(*places.T)
        assert np.allclose(E[:, d], 1e5 * expected, rtol=1e-11, atol=1e-7)
        assert np.allclose(B[:, d], 0.1 * expected, rtol=1e-11, atol=1e-13)


def test_map_is_zero_outside_and_eight_give_the_same_bits(tmp_path):
    fields = fields_of(write(tmp_path / "map.h5", cartesian(), SPACING, LOWER))
    places = np.random.default_rng(2).uniform(-0.5, 1.6, (1001, 3))
    inside = np.logical_and(places >= LOWER, places <= UPPER).all(axis=1)
    zero = np.zeros_like(places)
    eights = fields.native.means(places, zero, 0.0, 0.0, 0.0)
    singles = fields.native.means(places, zero, 0.0, 0.0, 0.0, by_eights=False)
    for a, b in zip(eights, singles, strict=True):
        assert np.array_equal(a, b)
        assert not a[~inside].any() and a[inside].all()


def test_interpolation_is_of_third_order(tmp_path):
    def error(n: int) -> float:
        x, y, z = np.meshgrid(*3 * [np.linspace(-1, 1, n + 1)], indexing="ij")
        wave = np.sin(3 * x + 0.5) * np.cos(2 * y) * np.exp(z)
        file = write(tmp_path / f"{n}.h5", {"E": {"x": wave}}, 3 * (2 / n,), (-1.0, -1.0, -1.0))
        places = np.random.default_rng(3).uniform(-1, 1, (400, 3))
        px, py, pz = places.T
        exact = np.sin(3 * px + 0.5) * np.cos(2 * py) * np.exp(pz)
        return float(np.abs(fields_of(file).fields(places)[0][:, 0] - exact).max())

    assert np.log2(error(16) / error(32)) > 2.8


@pytest.mark.parametrize("first", [0.0, 0.5], ids=["node on the axis", "axis between nodes"])
def test_axisymmetric_map_is_smooth_through_its_axis(tmp_path, first):
    h, k = 0.02, 0.05
    r, z = np.meshgrid(h * (first + np.arange(12)), k * np.arange(10), indexing="ij")
    # of degree 2 in r, with the symmetry of fields: r and φ components odd
    records = {
        "E": {"r": 1e5 * r * (1 + z), "t": 2e4 * r * z, "z": 1e5 * (1 - 3 * r * r) * (z * z + 1)},
        "B": {"r": 0.1 * r * z * z, "z": 0.2 * (1 + r * r)},
    }
    file = write(tmp_path / "rz.h5", records, (h, k), (h * first, 0.0), geometry="thetaMode")
    places = np.random.default_rng(4).uniform((-0.15, -0.15, 0), (0.15, 0.15, 0.45), (300, 3))
    places[0, :2] = 0
    E, B = fields_of(file).fields(places)
    x, y, z = places.T
    rr = x * x + y * y
    assert np.allclose(E[:, 0], 1e5 * x * (1 + z) - 2e4 * y * z, rtol=1e-10, atol=1e-7)
    assert np.allclose(E[:, 1], 1e5 * y * (1 + z) + 2e4 * x * z, rtol=1e-10, atol=1e-7)
    assert np.allclose(E[:, 2], 1e5 * (1 - 3 * rr) * (z * z + 1), rtol=1e-10, atol=1e-7)
    assert np.allclose(B, np.stack([0.1 * x * z * z, 0.1 * y * z * z, 0.2 * (1 + rr)], axis=1), rtol=1e-10, atol=1e-13)


def test_map_with_a_frequency_oscillates(tmp_path):
    file = write(tmp_path / "map.h5", cartesian(), SPACING, LOWER)
    still = fields_of(file, scale=2.0).fields([[0, 0, 1.2]])
    moving = fields_of(file, scale=2.0, frequency=1e9, phase=0.5).fields([[0, 0, 1.2]], 0.2e-9)
    angle = 2 * np.pi * 0.2 + 0.5
    assert np.allclose(moving[0], np.cos(angle) * still[0], rtol=1e-13)
    assert np.allclose(moving[1], -np.sin(angle) * still[1], rtol=1e-13)


def test_map_in_another_place(tmp_path):
    file = write(tmp_path / "map.h5", cartesian(), SPACING, LOWER)
    here = np.array([[0.1, 0.05, 1.2]])
    there = fields_of(file, centre=(1, 2, 3), direction=(0, 0, -1)).fields(here * (-1, 1, -1) + (1, 2, 3))
    assert np.allclose(there[0], fields_of(file).fields(here)[0] * (-1, 1, -1), rtol=1e-12)


def test_axes_may_come_in_any_order(tmp_path):
    """Labels z, y, x: indices, spacings and offsets are in that order."""
    turned = {name: {key: values.T for key, values in of.items()} for name, of in cartesian().items()}
    labels = np.array(["z", "y", "x"], dtype="S")
    plain = field_maps.read(write(tmp_path / "xyz.h5", cartesian(), SPACING, LOWER))
    other = field_maps.read(write(tmp_path / "zyx.h5", turned, SPACING[::-1], LOWER[::-1], axisLabels=labels))
    assert (other.lower, other.spacing) == (plain.lower, plain.spacing)
    for one, same in ((other.electric, plain.electric), (other.magnetic, plain.magnetic)):
        assert one is not None and same is not None and np.array_equal(one, same)


def refusal(path: Path, **more: Any) -> str:
    with pytest.raises(InputError) as refused:
        field_maps.read(path, **more)
    message = str(refused.value)
    assert "\n" not in message and "; " in message and str(path) in message
    return message


def holed() -> Records:
    records = cartesian()
    records["B"]["y"][2, 3, 4] = np.nan
    return records


def uneven() -> Records:
    records = cartesian()
    records["E"]["z"] = records["E"]["z"][:, :, :-1]
    return records


def complex_() -> Records:
    return {"E": {"x": np.full((7, 7, 7), 1j)}}


R, T = np.zeros((5, 6)), {"geometry": "thetaMode", "axisLabels": np.array(["r", "z"], dtype="S")}
ON_AXIS = {**T, "gridSpacing": np.array([0.1, 0.1]), "gridGlobalOffset": np.array([0.0, 0.0])}


@pytest.mark.parametrize(
    "records, attributes, words",
    [
        (holed(), {}, "holds 1 values that are not finite, the first (nan) at node (2, 3, 4); fill the holes"),
        (uneven(), {}, "components of shapes (7, 6, 9) and (7, 6, 8)"),
        ({"E": {"x": np.zeros((7, 2, 7))}}, {}, "has 7 × 2 × 7 nodes; interpolation needs 3 along each axis"),
        ({"E": {"phi": np.zeros((7, 7, 7))}}, {}, "holds phi; write the components x, y, z"),
        (cartesian(), {"geometry": "spherical"}, 'has the geometry "spherical"; write it as cartesian or thetaMode'),
        (cartesian(), {"axisLabels": np.array(["u", "y", "z"], dtype="S")}, "has the axes u, y, z; write x, y, z"),
        (cartesian(), {"unitDimension": np.zeros(7)}, "has the dimension 1; it should be "),
        (cartesian(), {"gridSpacing": np.array([0.1, 0.1])}, "has gridSpacing [0.1, 0.1]; write 3 finite numbers"),
        (cartesian(), {"gridSpacing": 0.1}, "has gridSpacing 0.1; write 3 finite numbers, one per axis"),
        (cartesian(), {"gridGlobalOffset": np.array([0, np.nan, 0])}, "has gridGlobalOffset [0.0, nan, 0.0]; write 3"),
        (cartesian(), {"gridUnitSI": 0.0}, "has the spacing [0.0, 0.0, 0.0] m; write a positive one"),
        ({"E": {"x": np.zeros((7, 7))}}, {}, "has nodes along 2 axes; write an array with an index per axis x, y, z"),
        (complex_(), {}, "holds complex numbers; write the real amplitude"),
        (
            {"E": {"z": R}},
            {**ON_AXIS, "gridGlobalOffset": np.array([0.025, 0.0])},
            "begins at r = 0.025 m with nodes 0.1 m",
        ),
        ({"E": {"z": R}}, {**ON_AXIS, "gridGlobalOffset": np.array([-0.1, 0.0])}, "begins at r = -0.1 m"),
        (
            {"E": {"z": np.ones((3, 5, 6))}},
            ON_AXIS,
            "h5 holds 3 modes; write a field that is the same all around its axis",
        ),
        ({"E": {"x": np.ones((7, 7, 7))}, "B": {"x": np.ones((7, 7, 8))}}, {}, "holds E and B on different grids"),
        (
            cartesian(),
            {"gridSpacing": np.array([0.1, -0.1, 0.1])},
            "has the spacing [0.1, -0.1, 0.1] m; write a positive",
        ),
        ({}, {}, "cannot be read as openPMD"),
    ],
)
def test_mistakes_get_a_sentence(tmp_path, records, attributes, words):
    assert words in refusal(write(tmp_path / "map.h5", records, SPACING, LOWER, **attributes))


def test_components_at_different_places_of_a_cell(tmp_path):
    file = write(tmp_path / "yee.h5", cartesian(), SPACING, LOWER)
    with h5py.File(file, "a") as h5:
        h5["data/5/fields/E/x"].attrs["position"] = np.array([0.5, 0, 0])
        h5["data/5/fields/E/y"].attrs["position"] = np.array([0, 0.5, 0])
    assert "has components at the places [0.5, 0.0, 0.0] and [0.0, 0.5, 0.0] of a cell; interpolate" in refusal(file)


def test_what_is_missing_is_named(tmp_path):
    for name in ("gridSpacing", "axisLabels", "geometry"):
        file = write(tmp_path / f"{name}.h5", cartesian(), SPACING, LOWER)
        with h5py.File(file, "a") as h5:
            del h5["data/5/fields/B"].attrs[name]
        assert name in refusal(file)


def test_files_that_are_none(tmp_path):
    assert "does not exist" in refusal(tmp_path / "absent.h5")
    (tmp_path / "text.h5").write_text("no map")
    assert "cannot be read as openPMD" in refusal(tmp_path / "text.h5")
    file = write(tmp_path / "map.h5", cartesian(), SPACING, LOWER)
    assert "holds no iteration 4; set iteration to one of 5" in refusal(file, iteration=4)

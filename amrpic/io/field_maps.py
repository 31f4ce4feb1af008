"""Reading fields on a regular grid from openPMD files (HDF5): records E and B of x, y, z, or of r, z around an axis."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import h5py
import numpy as np
from numpy.typing import NDArray

from ..errors import InputError
from .openpmd_files import base, dimension_text, opened, text

Array = NDArray[np.float64]
DIMENSION = {"E": (1, 1, -3, -1, 0, 0, 0), "B": (0, 1, -2, -1, 0, 0, 0)}  # m, kg, s, A, K, mol, cd
COMPONENTS = {"cartesian": ("x", "y", "z"), "thetaMode": ("r", "t", "z")}
AXES = {"cartesian": ("x", "y", "z"), "thetaMode": ("r", "z")}
NEAR_AXIS = 1e-6  # spacings


@dataclass(frozen=True)
class FieldMap:
    """Fields at the nodes of a regular grid in SI units, with indices (x, y, z, component) or (r, z, component)."""

    axisymmetric: bool
    lower: tuple[float, ...]  # the first node, m
    spacing: tuple[float, ...]  # m
    electric: Array | None  # V/m
    magnetic: Array | None  # T


def read(file: str | Path, iteration: int | None = None) -> FieldMap:
    """Return the fields of a file. Raises InputError, naming what is wrong with it."""
    path = Path(file)
    with opened(path, "field map", "write it anew by the standard 1.1") as h5:
        meshes = h5[base(h5, f"field map {path}", iteration) + text(h5.attrs["meshesPath"])]
        fields = {name: _read_mesh(path, meshes[name], name) for name in DIMENSION if name in meshes}
        names = ", ".join(meshes) or "nothing"
    if not fields:
        raise InputError(f"field map {path} holds {names} where E or B were expected; name the records E and B")
    return _joined(path, list(fields.values()))


def _joined(path: Path, fields: Sequence[FieldMap]) -> FieldMap:
    """Return one map of E and B on the same nodes."""
    grids = [(field.axisymmetric, field.lower, field.spacing, _shape(field)) for field in fields]
    if any(grid != grids[0] for grid in grids):
        raise InputError(
            f"field map {path} holds E and B on different grids, {grids[0][1:]} and {grids[1][1:]} (lower, spacing, nodes); "
            "write one file for each"
        )
    electric, magnetic = (
        next((values for field in fields if (values := getattr(field, key)) is not None), None)
        for key in ("electric", "magnetic")
    )
    return FieldMap(*grids[0][:3], electric, magnetic)


def _shape(field: FieldMap) -> tuple[int, ...]:
    values = field.electric if field.magnetic is None else field.magnetic
    assert values is not None
    return values.shape[:-1]


def _read_mesh(path: Path, mesh: h5py.Group, name: str) -> FieldMap:
    geometry = text(mesh.attrs["geometry"])
    where = f"record {name} of field map {path}"
    if geometry not in COMPONENTS:
        raise InputError(f'{where} has the geometry "{geometry}"; write it as cartesian or thetaMode')
    _require_dimension(where, mesh, DIMENSION[name])
    _require_axes(where, mesh, AXES[geometry])
    read = {
        key: _component(f"component {key} of {where}", mesh[key], geometry)
        for key in COMPONENTS[geometry]
        if key in mesh
    }
    if not read:
        names = ", ".join(mesh) or "no components"
        raise InputError(f"{where} holds {names}; write the components {', '.join(COMPONENTS[geometry])}")
    shape, place = _same(where, read)
    values = np.zeros((*shape, 3))
    for number, key in enumerate(COMPONENTS[geometry]):
        if key in read:
            values[..., number] = read[key][0]
    _require_nodes(where, shape, AXES[geometry])
    _require_finite(where, values)
    order = [_texts(mesh.attrs["axisLabels"]).index(axis) for axis in AXES[geometry]]
    values = values.transpose(*order, len(order))
    spacing, lower = (_per_axis(where, mesh, key, len(order)) for key in ("gridSpacing", "gridGlobalOffset"))
    unit = np.broadcast_to(np.asarray(mesh.attrs.get("gridUnitSI", 1.0), dtype=float), spacing.shape)
    if not (spacing * unit > 0).all() or not np.isfinite(spacing * unit).all():
        raise InputError(f"{where} has the spacing {(spacing * unit).tolist()} m; write a positive one along each axis")
    lower, spacing = ((lower + place * spacing) * unit)[order], (spacing * unit)[order]
    if geometry == "thetaMode":
        _require_axis(where, lower[0], spacing[0])
    return FieldMap(
        geometry == "thetaMode",
        tuple(map(float, lower)),
        tuple(map(float, spacing)),
        values if name == "E" else None,
        values if name == "B" else None,
    )


def _component(where: str, component: h5py.Dataset | h5py.Group, geometry: str) -> tuple[Array, Array]:
    """Return the values of a component in SI units in the order of the axis labels, and where in a cell its nodes lie."""
    attributes = component.attrs
    values = (
        np.full(tuple(attributes["shape"]), float(attributes["value"])) if "value" in attributes else component[...]
    )
    if np.iscomplexobj(values):
        raise InputError(f"{where} holds complex numbers; write the real amplitude of each field, with the phase apart")
    if geometry == "thetaMode" and values.ndim == 3:
        if values[1:].any():
            raise InputError(f"{where} holds {len(values)} modes; write a field that is the same all around its axis")
        values = values[0]
    if text(component.parent.attrs.get("dataOrder", "C")) == "F":
        values = values.T
    place = np.asarray(attributes.get("position", np.zeros(values.ndim)), dtype=float)
    return np.asarray(values, dtype=float) * float(attributes.get("unitSI", 1.0)), place


def _same(where: str, read: dict[str, tuple[Array, Array]]) -> tuple[tuple[int, ...], Array]:
    """Return the shape and the place in a cell that all components have."""
    (values, place), *of_meshes = read.values()
    for of_mesh, other_place in of_meshes:
        if of_mesh.shape != values.shape:
            raise InputError(f"{where} has components of shapes {values.shape} and {of_mesh.shape}; give all one shape")
        if not np.array_equal(other_place, place):
            raise InputError(
                f"{where} has components at the places {place.tolist()} and {other_place.tolist()} of a cell; "
                "interpolate all to the same nodes"
            )
    return values.shape, place


def _require_dimension(where: str, mesh: h5py.Group, expected: tuple[int, ...]) -> None:
    dimension = tuple(mesh.attrs.get("unitDimension", expected))
    if dimension != expected:
        raise InputError(
            f"{where} has the dimension {dimension_text(dimension)}; it should be {dimension_text(expected)}"
        )


def _require_axes(where: str, mesh: h5py.Group, expected: tuple[str, ...]) -> None:
    labels = _texts(mesh.attrs["axisLabels"])
    if sorted(labels) != sorted(expected):
        raise InputError(f"{where} has the axes {', '.join(labels)}; write {', '.join(expected)}")


def _per_axis(where: str, mesh: h5py.Group, key: str, axes: int) -> Array:
    """Return an attribute that holds a number per axis."""
    values = np.asarray(mesh.attrs[key], dtype=float)
    if values.shape != (axes,) or not np.isfinite(values).all():
        raise InputError(f"{where} has {key} {values.tolist()}; write {axes} finite numbers, one per axis")
    return values


def _require_axis(where: str, lower: float, spacing: float) -> None:
    offset = lower / spacing
    if min(abs(offset), abs(offset - 0.5)) > NEAR_AXIS:
        raise InputError(
            f"{where} begins at r = {lower:g} m with nodes {spacing:g} m apart; begin at the axis, or half a spacing away"
        )


def _require_nodes(where: str, shape: tuple[int, ...], axes: tuple[str, ...]) -> None:
    if len(shape) != len(axes):
        raise InputError(
            f"{where} has nodes along {len(shape)} axes; write an array with an index per axis {', '.join(axes)}"
        )
    if min(shape) < 3:
        raise InputError(f"{where} has {' × '.join(map(str, shape))} nodes; interpolation needs 3 along each axis")


def _require_finite(where: str, values: Array) -> None:
    bad = np.argwhere(~np.isfinite(values))
    if len(bad):
        raise InputError(
            f"{where} holds {len(bad)} values that are not finite, the first ({values[tuple(bad[0])]}) at node "
            f"{tuple(map(int, bad[0][:-1]))}; fill the holes"
        )


def _texts(values: Any) -> list[str]:
    return [text(value) for value in np.atleast_1d(values)]

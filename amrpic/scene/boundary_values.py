"""What a scene gives for the faces of the domain: kinds, potentials on Dirichlet faces, slopes on Neumann faces."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Annotated, Any

import numpy as np
from pydantic import BeforeValidator, WithJsonSchema

from ..errors import InputError
from ..mesh.domain import AXES
from ..units import UNITS
from .complaints import complaint
from .expression import Value, formula
from .units import to_si

JsonSchema = dict[str, Any]


def pairs_of(values: Mapping[Any, Any]) -> dict[str, tuple[Any, Any]]:
    """Return pairs of the axes that have values. Complains of other axes, and of pairs that are none."""
    out = {}
    for axis, values_of_axis in values.items():
        if axis not in AXES:
            raise complaint("is not an axis", "use x, y and z", path=str(axis), found=values_of_axis)
        pair = tuple(values_of_axis) if isinstance(values_of_axis, list | tuple) else (values_of_axis, values_of_axis)
        if len(pair) != 2:
            raise complaint(
                "does not fit the two faces of an axis",
                "write one value or a pair (lower, upper)",
                path=axis,
                found=values_of_axis,
            )
        out[axis] = pair
    return out


def schema_of(value: JsonSchema) -> JsonSchema:
    """Return the JSON schema of what `pairs_of` takes, if `value` is that of a value."""
    pair = {"anyOf": [value, {"type": "array", "items": value, "minItems": 2, "maxItems": 2}]}
    return {"type": "object", "properties": dict.fromkeys(AXES, pair), "additionalProperties": False}


Given = float | str  # an SI number, or a formula in x, y, z (m) whose value is one
PerFace = dict[str, tuple[Given, Given]]
Function = Callable[[np.ndarray, np.ndarray, np.ndarray], Value]


def _given(value: Any, kind: str) -> Given:
    """A number in SI units, or the formula as it is written."""
    if isinstance(value, str) and not any(value.rstrip().endswith(f" {unit}") for unit in UNITS[kind]):
        try:
            return float(value)
        except ValueError:
            formula(value)
            return value
    return to_si(value, kind)


def _spread(value: Any, kind: str) -> PerFace:
    if not isinstance(value, Mapping):
        raise complaint(f"names no axis for its {kind}", "write it per axis, such as { z = [0, 100] }")
    return {axis: (_given(lower, kind), _given(upper, kind)) for axis, (lower, upper) in pairs_of(value).items()}


_SCHEMA = WithJsonSchema(schema_of({"type": ["number", "string"]}))
Potentials = Annotated[PerFace, BeforeValidator(lambda value: _spread(value, "potential")), _SCHEMA]
Slopes = Annotated[PerFace, BeforeValidator(lambda value: _spread(value, "field")), _SCHEMA]


def wall_function(
    per_face: PerFace, lower: tuple[float, ...], upper: tuple[float, ...], key: str = ""
) -> Function | None:
    """Return the function of face centres x, y, z (m) that has the given value on each face; None if all are zero.

    It raises InputError, naming the `key` of the scene, where a formula has no finite value.
    """
    if all(value == 0 for pair in per_face.values() for value in pair):
        return None
    faces = []  # axis, coordinate of the face, value
    for axis, pair in per_face.items():
        d = AXES.index(axis)
        for at, value in zip((lower[d], upper[d]), pair, strict=True):
            faces.append((d, at, formula(value) if isinstance(value, str) else float(value)))

    def at_faces(x: np.ndarray, y: np.ndarray, z: np.ndarray) -> np.ndarray:
        place = (x, y, z)
        out = np.zeros(len(x))
        for d, at, value in faces:
            axis_name = f"{key}.{AXES[d]}"
            on_face = (
                place[d] == at
            )  # centres of faces lie on them exactly, those of other faces half a cell off at least
            out[on_face] = _at(value, axis_name, tuple(s[on_face] for s in place)) if callable(value) else value
        return out

    return at_faces


def _at(value: Function, key: str, place: tuple[np.ndarray, ...]) -> np.ndarray:
    """The value of a formula on faces."""
    try:
        with np.errstate(all="ignore"):
            values = np.broadcast_to(value(*place), place[0].shape)
    except ArithmeticError as reason:
        raise InputError(f"{key}: its formula has no value ({reason}); correct it") from None
    bad = np.flatnonzero(~np.isfinite(values))
    if bad.size:
        at = ", ".join(f"{s[bad[0]]:.3g}" for s in place)
        raise InputError(
            f"{key}: its formula is {values[bad[0]]} at ({at}) m, and not finite on {bad.size} cell faces in all; correct it"
        )
    return values


def require_kind(per_face: PerFace, boundary: Mapping[str, tuple[str, str]], kind: str, path: str) -> None:
    """Complain about a value that is given on a face of another kind."""
    for axis, pair in per_face.items():
        for side, value in enumerate(pair):
            # one value for an axis goes to those of its faces that are of the kind
            if value != 0 and boundary[axis][side] != kind and (pair[0] != pair[1] or kind not in boundary[axis]):
                raise complaint(
                    f"is given on a face that is {boundary[axis][side]}, not {kind}",
                    f'make boundary.{axis} "{kind}", or leave the value out',
                    path=f"{path}.{axis}",
                    found=value,
                )

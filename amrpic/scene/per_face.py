"""What a scene gives for the faces of the domain: per axis one value for both, or a pair (lower, upper)."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from ..mesh.domain import AXES
from .complaints import complaint

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

"""What a scene may say of the faces of the mesh."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Literal

from pydantic import Field, model_serializer, model_validator

from ..mesh.domain import AXES
from ..scene.boundary_values import pairs_of, schema_of
from ..scene.complaints import close_match, complaint
from ..scene.section import Section

KINDS = ("slip", "clamped", "free")
MOVES = {  # sign, limit, what a wrong part is none of, and what a right one is
    "press": (-1, 1, "that goes", "number between 0 and 1"),
    "pull": (1, 100, "that comes", "positive number"),
}
_PART = {"type": "number", "exclusiveMinimum": 0}
FACES_SCHEMA = schema_of(
    {
        "anyOf": [
            {"enum": list(KINDS)},
            {"type": "object", "properties": {"press": {**_PART, "exclusiveMaximum": 1}}, "required": ["press"]},
            {"type": "object", "properties": {"pull": _PART}, "required": ["pull"]},
        ]
    }
)


class Face(Section):
    """A face: its kind, and which part of the length along its axis it adds by the end, negative if it presses."""

    kind: Literal["slip", "clamped", "free"] = "slip"
    change: float = Field(default=0.0, gt=-1)

    @model_validator(mode="before")
    @classmethod
    def _written(cls, data: Any) -> Any:
        if isinstance(data, str):
            if data not in KINDS:
                raise complaint("is no face", close_match(data, (*KINDS, *MOVES)), found=data)
            return {"kind": data}
        if isinstance(data, Mapping) and len(data) == 1 and set(data) <= set(MOVES):
            ((name, part),) = data.items()
            sign, limit, requirement, remedy = MOVES[name]
            if isinstance(part, bool) or not isinstance(part, int | float) or not 0 < part < limit:
                raise complaint(f"is no part of the length {requirement}", f"give a {remedy}", path=name, found=part)
            return {"change": sign * part}
        if isinstance(data, Mapping) and not set(data) <= set(cls.model_fields):
            raise complaint(
                "is no face", f"use {', '.join(KINDS)}, {{ press = 0.3 }} or {{ pull = 0.1 }}", found=dict(data)
            )
        return data

    @model_serializer
    def _as_written(self) -> Any:
        if self.change == 0:
            return self.kind
        return {"press": -self.change} if self.change < 0 else {"pull": self.change}


def faces_of(data: Any) -> Any:
    """Return faces per axis as pairs; axes that are not there are free."""
    if not isinstance(data, Mapping):
        raise complaint("are no faces", 'write one or a pair per axis, such as { x = "slip", z = ["clamped", "free"] }')
    pairs = pairs_of(data)
    return {axis: pairs.get(axis, ("free", "free")) for axis in AXES}

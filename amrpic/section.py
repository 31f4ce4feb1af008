"""The sections of a scene share their manners: frozen, strict about keys, plain about mistakes."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from pydantic import BaseModel, ConfigDict, model_validator

from .complaints import close_match
from .units import complaint


class Section(BaseModel):
    """A part of the scene: frozen, and strict about its keys."""

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False, arbitrary_types_allowed=True)

    @model_validator(mode="before")
    @classmethod
    def _known_keys(cls, data: Any) -> Any:
        if isinstance(data, Mapping):
            for key in data:
                if key not in cls.model_fields:
                    raise complaint(
                        "is an unknown key", close_match(str(key), cls.model_fields), path=str(key), found=data[key]
                    )
        return data


def refuse_negative(path: str, value: float, unit: str) -> None:
    if value < 0:
        raise complaint("is negative", f"give 0 or more {unit}", path=path, found=value)

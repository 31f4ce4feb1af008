"""Where two scenes differ."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import Any

from ..errors import InputError


def differences(one: Any, other: Any, path: str = "") -> Iterator[tuple[str, Any, Any]]:
    """Yield the settings of scenes as dictionaries that differ: where, the value of one, that of the other; None for none."""
    if isinstance(one, dict) and isinstance(other, dict):
        for key in {**other, **one}:
            yield from differences(one.get(key), other.get(key), f"{path}.{key}".strip("."))
    elif isinstance(one, list) and isinstance(other, list) and len(one) == len(other) and _of_sections(one + other):
        for number, (mine, theirs) in enumerate(zip(one, other, strict=True)):
            yield from differences(mine, theirs, f"{path}.{number}")
    elif one != other:
        yield path, one, other


def _of_sections(members: list[Any]) -> bool:
    return all(isinstance(member, dict) for member in members)


def require_same(name: str, path: Path, changed: Iterable[tuple[str, Any, Any]]) -> None:
    """Raise InputError for the first of the `differences` between the scene `name` and that of a checkpoint, if any."""
    for key, value, before in changed:
        raise InputError(
            f"{name} cannot go on from checkpoint {path}: {key} is {setting_text(value)} instead of {setting_text(before)}; "
            "restore that, or start afresh in another folder"
        )


def setting_text(value: Any) -> str:
    """Return a setting as sentences have it."""
    return "not given" if value is None else str(value)

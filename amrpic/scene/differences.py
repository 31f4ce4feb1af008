"""Where two scenes differ."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import Any

from ..errors import InputError


def differences(first: Any, second: Any, path: str = "") -> Iterator[tuple[str, Any, Any]]:
    """Yield the settings of scenes as dictionaries that differ: where, the value of one, that of the other; None for none."""
    if isinstance(first, dict) and isinstance(second, dict):
        for key in {**second, **first}:
            yield from differences(first.get(key), second.get(key), f"{path}.{key}".strip("."))
    elif (
        isinstance(first, list)
        and isinstance(second, list)
        and len(first) == len(second)
        and all(isinstance(member, dict) for member in first + second)
    ):
        for number, (of_first, of_second) in enumerate(zip(first, second, strict=True)):
            yield from differences(of_first, of_second, f"{path}.{number}")
    elif first != second:
        yield path, first, second


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

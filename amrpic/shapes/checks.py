"""Checks of the numbers that shapes are made of. Each raises InputError in one sentence."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

from ..errors import InputError

Point = tuple[float, float, float]
AXES = {"x": (1.0, 0.0, 0.0), "y": (0.0, 1.0, 0.0), "z": (0.0, 0.0, 1.0)}


def point(where: str, value: Any) -> Point:
    """Return three finite numbers."""
    try:
        x, y, z = (float(part) for part in value)
    except (TypeError, ValueError):
        raise InputError(
            f"{where} is {value!r}, which is no point; give three numbers such as (0, 0, 0.1), m"
        ) from None
    if not all(map(math.isfinite, (x, y, z))):
        raise InputError(f"{where} is {value!r}, which is not finite; give three finite numbers, m")
    return x + 0.0, y + 0.0, z + 0.0  # no negative zeros


def number(where: str, value: Any) -> float:
    """Return a finite number."""
    try:
        result = float(value)
    except (TypeError, ValueError):
        raise InputError(f"{where} is {value!r}, which is no number; give one such as 0.01") from None
    if not math.isfinite(result):
        raise InputError(f"{where} is {result}; give a finite number")
    return result


def positive(where: str, value: Any) -> float:
    """Return a finite number above zero."""
    result = number(where, value)
    if result <= 0:
        raise InputError(f"{where} is {result:g}; give a number above zero")
    return result


def direction(where: str, value: Any) -> Point:
    """Return a unit vector along a vector, or along "x", "y" or "z"."""
    if isinstance(value, str):
        if value not in AXES:
            raise InputError(f'{where} is "{value}"; give "x", "y", "z" or a vector such as (0, 0, 1)')
        return AXES[value]
    vector = point(where, value)
    length = math.hypot(*vector)
    if not length or not math.isfinite(length):
        raise InputError(f"{where} is {value!r}, which has no direction; give a vector such as (0, 0, 1)")
    return tuple(part / length for part in vector)  # type: ignore[return-value]


def differ(where: str, first: Point, last: Point) -> float:
    """Return the distance of two points, which may not be the same."""
    length = math.dist(first, last)
    if not length:
        raise InputError(f"{where} are the same point, {first}; give two that differ")
    return length


def ascending(where: str, lower: Sequence[float], upper: Sequence[float]) -> None:
    """Refuse a box that has no volume."""
    for axis, low, high in zip("xyz", lower, upper, strict=True):
        if not low < high:
            raise InputError(
                f"{where} reaches from {low:g} to {high:g} m along {axis}; give a lower corner below the upper one"
            )

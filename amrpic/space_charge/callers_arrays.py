"""The arrays that a caller gives: numbers that kernels can take, or one sentence on what is wrong with them. Local."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from .. import _native
from ..errors import InputError

FARTHEST = 1e30  # m: beyond it products of lengths leave the range of numbers
MOST_CHARGE = 1e30  # C, in one macroparticle
MOST_GAMMA = 1e12  # far beyond any beam
NAMES = ("x", "y", "z")


@dataclass(frozen=True)
class Arrays:
    """A caller's particles or places on this rank: float64 arrays (n,) of any stride, which are the caller's own memory
    where they came as float64. Values are checked where they are read: `CallersOrder.take`."""

    places: tuple[np.ndarray, np.ndarray, np.ndarray]  # m
    charge: np.ndarray | float  # C, one for all or (n,)
    alive: np.ndarray | None = None  # bool (n,), None if all are
    names: tuple[str, str, str] = NAMES  # of the places

    def __len__(self) -> int:
        return len(self.places[0])


class ColumnSums(NamedTuple):
    """What values add up to and between which they lie; the sums are not finite if a value is not."""

    sum: float = 0.0
    magnitude: float = 0.0  # Σ |v|
    least: float = np.inf
    greatest: float = -np.inf

    @property
    def largest(self) -> float:
        """The largest |v|, nan if a value is."""
        return max(self.greatest, -self.least, 0.0) if np.isfinite(self.sum) else np.nan


def column_sums(
    column: np.ndarray, places: np.ndarray | None, shift: float = 0.0, scale: float = 1.0, out: np.ndarray | None = None
) -> ColumnSums:
    """Write (v - shift) · scale of the values v at places, None for all, into `out`, and return what v add up to."""
    return ColumnSums(*_native.take_column(column, places, shift, scale, out))


def particles(x: Any, y: Any, z: Any, charge: Any, alive: Any = None) -> Arrays:
    """Return the arrays of particles. InputError for those that make none."""
    places = _columns((x, y, z), NAMES)
    mask = None if alive is None else _mask(alive, len(places[0]))
    return Arrays(places, number_or_column(charge, "charge", len(places[0])), mask)


def other_places(at: Any) -> Arrays:
    """Return the arrays of places: three arrays (m,), or one (m, 3). InputError for those that make none."""
    if isinstance(at, np.ndarray) and at.ndim == 2:
        at = at.T
    if not isinstance(at, Sequence | np.ndarray) or len(at) != 3:
        raise InputError("at is neither three arrays nor one of shape (m, 3); give x, y and z of the places in m")
    names = ("x of at", "y of at", "z of at")
    return Arrays(_columns(at, names), 0.0, names=names)


def require_places(sums: ColumnSums, arrays: Arrays, axis: int) -> None:
    """Raise InputError if a coordinate of what lives is none."""
    if not sums.largest <= FARTHEST:
        column = arrays.places[axis] if arrays.alive is None else arrays.places[axis][arrays.alive]
        bad = int(np.count_nonzero(~(np.abs(column) <= FARTHEST)))
        raise InputError(
            f"{arrays.names[axis]} has {bad} values that are not finite or beyond {FARTHEST:g} m; correct them, or leave these "
            "particles out by alive"
        )


def require_charges(sums: ColumnSums) -> None:
    """Raise InputError if a charge of what lives is none."""
    if not sums.largest <= MOST_CHARGE:
        raise InputError(
            f"charge holds values that are not finite or beyond {MOST_CHARGE:g} C; correct them, or leave these particles out "
            "by alive"
        )


def lorentz_factor(value: Any, name: str) -> float:
    """Return a Lorentz factor. InputError for what is none."""
    result = number(value, name, least=1)
    if result > MOST_GAMMA:
        raise InputError(f"{name} is {result}; give at most {MOST_GAMMA:g}")
    return result


def number(value: Any, name: str, least: float = -np.inf, above: float = -np.inf) -> float:
    """Return one finite number; InputError for anything else, and below `least` or not above `above`."""
    reals = _reals(value, name)
    if reals.ndim != 0 or not np.isfinite(reals):
        raise InputError(f"{name} is {_brief(value)}; give one finite number")
    if reals < least or not reals > above:
        raise InputError(
            f"{name} is {float(reals)}; give {f'at least {least:g}' if reals < least else f'more than {above:g}'}"
        )
    return float(reals)


def number_or_column(value: Any, name: str, count: int) -> np.ndarray | float:
    """Return one number, or one for each of so many particles. InputError for other shapes."""
    reals = _reals(value, name)
    if reals.ndim == 0:
        return float(reals)
    if reals.shape != (count,):
        raise InputError(f"{name} has the shape {reals.shape}, but x ({count},); give one number, or one per particle")
    return reals


def finite_or_column(value: Any, name: str, count: int, alive: Any = None) -> np.ndarray | float:
    """Return one finite number, or one for each of so many particles, finite for those that live. InputError for others."""
    result = number_or_column(value, name, count)
    living = result if alive is None or np.ndim(result) == 0 else np.asarray(result)[np.asarray(alive)]
    if not np.isfinite(living).all():
        raise InputError(
            f"{name} holds values that are not finite; correct them, or leave these particles out by alive"
        )
    return result


def _columns(values: Sequence[Any] | np.ndarray, names: Sequence[str]) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    x, y, z = (_reals(value, name) for value, name in zip(values, names, strict=True))
    for column, name in zip((x, y, z), names, strict=True):
        if column.ndim != 1 or len(column) != len(x):
            raise InputError(
                f"{name} has the shape {column.shape}, {names[0]} {x.shape}; give arrays of one dimension and equal length"
            )
    return x, y, z


def _reals(value: Any, name: str) -> np.ndarray:
    """Return the values in double precision: themselves, or a copy where they came in another."""
    if isinstance(value, np.ma.MaskedArray):
        raise InputError(f"{name} is a masked array; give its data, and alive = ~mask")
    try:
        reals = np.asarray(value)
    except Exception as refused:  # ragged lists, arrays on other devices
        raise InputError(f"{name} is no array of numbers ({type(refused).__name__}); give a NumPy array") from None
    if reals.dtype.kind not in "fiu":
        raise InputError(f"{name} holds values of type {reals.dtype}; give real numbers")
    reals = reals.astype(np.float64, copy=False)
    even = reals.flags.aligned and all(stride % reals.itemsize == 0 for stride in reals.strides)
    return reals if even else reals.copy()


def _mask(alive: Any, count: int) -> np.ndarray | None:
    mask = np.asarray(alive)
    if mask.dtype != bool or mask.shape != (count,):
        raise InputError(
            f"alive has the shape {mask.shape} and type {mask.dtype}; give one bool per particle, ({count},)"
        )
    return None if mask.all() else mask


def _brief(value: Any) -> str:
    text = " ".join(repr(value).split())
    return text if len(text) <= 40 else f"{text[:37]}..."

"""The domain: a cuboid cut into base cells, with a boundary condition per face."""

from __future__ import annotations

import operator
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from ..errors import HierarchyError

BOUNDARIES = ("open", "dirichlet", "neumann", "periodic")
AXES = "xyz"
FACES = tuple(f"{axis}_{side}" for axis in AXES for side in ("lower", "upper"))
Faces = tuple[tuple[str, str], tuple[str, str], tuple[str, str]]
BoundarySpec = str | Mapping[str, str | Sequence[str]]


@dataclass(frozen=True, init=False)
class Domain:
    """A cuboid in metres, cut into `cells` base cells, with a boundary condition per face.

    Corners and cells are three values each, or one for all axes. `boundary` is one name for all faces, or a mapping from axis
    to a name or to a pair of names (lower, upper); kept as ((x lower, x upper), (y lower, y upper), (z lower, z upper)). Axes
    that a mapping leaves out are open.

    Raises HierarchyError for an unknown name, a box without volume, or fewer than two cells along an axis.
    """

    lower: tuple[float, float, float]
    upper: tuple[float, float, float]
    cells: tuple[int, int, int]
    boundary: Faces

    def __init__(
        self,
        lower: Sequence[float] | float,
        upper: Sequence[float] | float,
        cells: Sequence[int] | int,
        boundary: BoundarySpec | Faces = "open",
    ) -> None:
        set_ = object.__setattr__
        set_(self, "lower", _three(lower, float, "domain.lower"))
        set_(self, "upper", _three(upper, float, "domain.upper"))
        set_(self, "cells", _three(cells, operator.index, "domain.cells"))
        set_(self, "boundary", _faces(boundary))
        for axis in range(3):
            if not self.lower[axis] < self.upper[axis] < np.inf or not np.isfinite(self.lower[axis]):
                raise HierarchyError(
                    f"domain along {AXES[axis]} reaches from {self.lower[axis]} to {self.upper[axis]} m; "
                    "the upper end must lie above the lower one and both must be finite"
                )
            if self.cells[axis] < 2:
                raise HierarchyError(f"domain.cells along {AXES[axis]} is {self.cells[axis]}; give at least 2")

    @property
    def spacing(self) -> np.ndarray:
        """Base cell widths, (3,) in m."""
        return (np.array(self.upper) - np.array(self.lower)) / np.array(self.cells)

    @property
    def periodic(self) -> tuple[bool, bool, bool]:
        """Whether space repeats along each axis."""
        return tuple(faces[0] == "periodic" for faces in self.boundary)  # type: ignore[return-value]

    def period(self, axis: int) -> float:
        """Length in m after which space repeats along an axis; infinity where it does not."""
        return self.upper[axis] - self.lower[axis] if self.periodic[axis] else np.inf

    def faces(self, kind: str) -> np.ndarray:
        """Return the coordinates of the lower and the upper faces of a kind (2, 3), m; -inf and inf for other ones."""
        return np.where(np.equal(self.boundary, kind).T, (self.lower, self.upper), ((-np.inf,), (np.inf,)))

    @property
    def singular(self) -> bool:
        """Whether the faces fix the potential only up to a constant."""
        return all(face in ("neumann", "periodic") for faces in self.boundary for face in faces)

    @property
    def zero_of_phi(self) -> str:
        """What fixes the constant in the potential, in words."""
        faces = {face for pair in self.boundary for face in pair}
        closed = [axis for axis, pair in enumerate(self.boundary) if "open" not in pair]
        if "dirichlet" in faces:
            return "φ is that of the Dirichlet faces"
        if "open" not in faces:
            return "the mean of φ is zero"
        if not closed:
            return "φ is zero at infinity"
        if len(closed) == 2:
            return "far away φ tends to -σ|d|/2ε₀, d being the distance from the charge, σ its density per area"
        (axis,) = closed
        period = (self.upper[axis] - self.lower[axis]) * (1 if self.periodic[axis] else 2)
        return f"far away φ tends to -λ ln(r/L)/2πε₀, λ being the charge per length and L = {period:g} m"


def _three(values: Sequence[Any] | float, kind: Callable[[Any], Any], name: str) -> tuple:
    try:
        x, y, z = (kind(value) for value in ((values,) * 3 if np.ndim(values) == 0 else values))  # type: ignore[union-attr]
    except (TypeError, ValueError, OverflowError):
        whole = "whole " if kind is operator.index else ""
        raise HierarchyError(f"{name} is {values!r}; give one {whole}number, or three, for x, y and z") from None
    return x, y, z


def _faces(boundary: BoundarySpec | Faces) -> Faces:
    if isinstance(boundary, str):
        per_axis: list[str | Sequence[str]] = [boundary] * 3
    elif isinstance(boundary, Mapping):
        if unknown := sorted(set(boundary) - set(AXES)):
            raise HierarchyError(f"boundary names axis {unknown[0]!r}; use x, y and z")
        per_axis = [boundary.get(axis, "open") for axis in AXES]
    else:
        per_axis = list(boundary)
        if len(per_axis) != 3:
            raise HierarchyError(
                f"boundary names {len(per_axis)} axes; give one name, or one entry for each of x, y, z"
            )
    faces = tuple((a, a) if isinstance(a, str) else tuple(a) for a in per_axis)
    for axis, pair in zip(AXES, faces, strict=True):
        for name in pair:
            if name not in BOUNDARIES:
                raise HierarchyError(f"boundary along {axis} is {name!r}; use one of {', '.join(BOUNDARIES)}")
        if len(pair) != 2:
            raise HierarchyError(f"boundary along {axis} names {len(pair)} faces; give one name or (lower, upper)")
    return faces  # type: ignore[return-value]

"""Walls across the motion of fast charge, whose images in them move against it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from .domain import AXES, Domain

SIGNS = {"dirichlet": -1, "neumann": 1}  # of an image over its charge, by the kind of wall
ON_LATTICE = 1e-6  # of a cell by which a plane may miss the lattice on which it mirrors


class MirrorPlane(NamedTuple):
    """An infinite plane across an axis."""

    place: float  # along the axis, m
    kind: str  # "dirichlet": a conductor at 0 V; "neumann": a magnetic wall, without flux of E


@dataclass(frozen=True)
class Mirror:
    """The planes across an axis in which charge that moves along it has its images.

    A plane lies at the face of its side, or outside the mesh, where it stays when the mesh goes on. Dirichlet and Neumann
    faces across the axis are no more walls for the equation, whether there is a plane or not.
    """

    axis: int = 2
    lower: MirrorPlane | None = None
    upper: MirrorPlane | None = None

    @property
    def planes(self) -> tuple[MirrorPlane | None, MirrorPlane | None]:
        return self.lower, self.upper

    @property
    def reflects(self) -> bool:
        """Whether there is a plane."""
        return self.planes != (None, None)

    @classmethod
    def of_faces(cls, domain: Domain, axis: int, moved: float = 0.0) -> Mirror:
        """Return the mirror of the walls across an axis of a domain that has `moved` so far (m) from them along it."""
        places = domain.lower[axis], domain.upper[axis]
        lower, upper = (
            MirrorPlane(place - moved, kind) if kind in SIGNS else None
            for place, kind in zip(places, domain.boundary[axis], strict=True)
        )
        return cls(axis, lower, upper)

    @classmethod
    def from_dict(cls, values: Mapping[str, Any]) -> Mirror:
        """Return the mirror of what `dataclasses.asdict` made of it, also after it was JSON."""
        lower, upper = (None if values[side] is None else MirrorPlane(*values[side]) for side in ("lower", "upper"))
        return cls(values["axis"], lower, upper)

    def refusal(self, domain: Domain) -> str | None:
        """Return why a domain has no such mirror, and what to do; None if it has."""
        if self.axis not in range(3) or domain.periodic[self.axis]:
            return f"mirror.axis is {self.axis}; give that of faces that are not periodic, 0 to 2"
        width = domain.spacing[self.axis]
        faces = domain.lower[self.axis], domain.upper[self.axis]
        for name, plane, face, out in zip(("lower", "upper"), self.planes, faces, (-1, 1), strict=True):
            if plane is None:
                continue
            if plane.kind not in SIGNS:
                return f"mirror.{name} is of kind {plane.kind!r}; use one of {', '.join(SIGNS)}"
            half_cells = 2 * out * (plane.place - face) / width
            if not half_cells > -ON_LATTICE:
                remedy = f"put it at the face, {face:g} m, or outside"
                return f"mirror.{name} lies inside the mesh, at {AXES[self.axis]} = {plane.place:g} m; {remedy}"
            if not abs(half_cells - np.round(half_cells)) < ON_LATTICE:
                return (
                    f"mirror.{name} lies {half_cells / 2:.6g} base cells outside the face; move it, so that they are whole "
                    "or half ones"
                )
        if None not in self.planes and leaves_no_way_round(domain, self.axis):
            sides = " or ".join(sorted(sides_along(domain, self.axis)))
            return f"a mirror has two planes and all sides are {sides}: images add up for ever; make a side dirichlet or open"
        return None


def sides_along(domain: Domain, axis: int) -> set[str]:
    """Return the kinds of the faces along an axis."""
    return {kind for side_axis in range(3) if side_axis != axis for kind in domain.boundary[side_axis]}


def leaves_no_way_round(domain: Domain, axis: int) -> bool:
    """Whether a current along an axis that ends at a wall repeats without end beside itself: it has no magnetic field."""
    return sides_along(domain, axis) <= {"neumann", "periodic"}

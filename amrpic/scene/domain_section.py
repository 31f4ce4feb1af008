"""The section [domain] of a scene: the cuboid, its base cells and what holds at its faces."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Annotated, Any, Self

from pydantic import BeforeValidator, Field, WithJsonSchema, model_validator

from ..errors import HierarchyError
from ..mesh.domain import AXES, BOUNDARIES, FACES, Domain
from ..mesh.rims import rims_of
from .boundary_values import Function, Potentials, Slopes, pairs_of, require_kind, schema_of, wall_function
from .complaints import close_match, complaint, complaint_of
from .section import Section
from .units import Index3, Length3

SHORTEST, LONGEST = 1e-30, 1e30  # m; of a domain: squares of volumes are numbers still
RESOLVED = 1e-10  # of a place: how wide cells are at least, so that a place in one has four digits on 15 levels
JUMP = 1e-2  # of a potential at a rim, from where on it draws a remark
LARGEST_INDEX = 2**31 - 1  # cells are counted in 32 bits along an axis and on a rank
_FACE = {"enum": list(BOUNDARIES)}
BOUNDARY_SCHEMA = {"anyOf": [_FACE, schema_of(_FACE)]}


class CuboidSection(Section):
    """A cuboid and its cells."""

    lower: Length3 = Field(description="Lower corner, m.")
    upper: Length3 = Field(description="Upper corner, m; above the lower one along each axis.")
    cells: Index3 = Field(description="Cells per axis, at least 2.")

    @model_validator(mode="after")
    def _sound(self) -> Self:
        try:
            _ = self.value
        except HierarchyError as refused:
            raise complaint_of(refused) from None
        for axis, (lower, upper, cells) in enumerate(zip(self.lower, self.upper, self.cells, strict=True)):
            _require_measurable(AXES[axis], lower, upper, cells)
        return self

    @property
    def value(self) -> Domain:
        """The domain that hierarchies are made of."""
        return Domain(self.lower, self.upper, self.cells)


class DomainSection(CuboidSection):
    """The cuboid that is computed, its base cells and what holds at its faces."""

    cells: Index3 = Field(description="Base cells per axis, at least 2; any number will do.")
    boundary: Annotated[
        dict[str, tuple[str, str]],
        BeforeValidator(lambda value: _per_face(value)),
        WithJsonSchema(BOUNDARY_SCHEMA),
    ] = Field(
        default=dict.fromkeys(AXES, ("open", "open")),
        description="open, dirichlet (0 V), neumann (no flux) or periodic: one for all faces, or per axis one or a pair "
        "(lower, upper). Open is the default because a bunch in free space is the usual case. All kinds go together: behind "
        "open faces lies free space, with the images of the charge in walls and periods, which reach on without end. "
        "While a face is open or Dirichlet, the net charge may be any. Dirichlet faces fix φ. Without any, φ(∞) = 0; "
        "but where one axis has no open face, φ tends to -λ ln(r/L)/2πε₀ around it, where two have none to -σ|z|/2ε₀ "
        "beside them, λ and σ being the charge per length and area, and L the period, or twice the distance of "
        "Neumann faces. Without open faces the mean of φ is zero.",
    )
    potential: Potentials = Field(
        default={},
        description='Potential of Dirichlet faces, V, per axis one or a pair (lower, upper): numbers, strings such as "5 kV", '
        'or formulas in x, y and z (m) such as "1e6*(x^2 - y^2)". Faces without one are at 0 V. Beyond '
        "open faces a wall goes on at the mean of its potential where it meets them.",
    )
    slope: Slopes = Field(
        default={},
        description="Outward derivative of φ on Neumann faces, V/m, per axis one or a pair (lower, upper), as for "
        "potential; the flux of E out of the face is minus this. Faces without one have none, as walls have beyond open faces.",
    )

    @model_validator(mode="before")
    @classmethod
    def _of_domain(cls, data: Any) -> Any:
        if not isinstance(data, Domain):
            return data
        boundary = dict(zip(AXES, data.boundary, strict=True))
        return {"lower": data.lower, "upper": data.upper, "cells": data.cells, "boundary": boundary}

    @model_validator(mode="after")
    def _faces_fit(self) -> Self:
        require_kind(self.potential, self.boundary, "dirichlet", "potential")
        require_kind(self.slope, self.boundary, "neumann", "slope")
        return self

    def wall_functions(self) -> tuple[Function | None, Function | None]:
        """The potential on Dirichlet faces and the slope on Neumann faces, as functions of x, y and z; None where zero."""
        return (
            wall_function(self.potential, self.lower, self.upper, "domain.potential"),
            wall_function(self.slope, self.lower, self.upper, "domain.slope"),
        )

    def remarks(self) -> list[str]:
        """Return one sentence for each Dirichlet face whose potential jumps where it meets open faces.

        Raises InputError where a formula has no finite value.
        """
        potential, _ = self.wall_functions()
        rims = rims_of(self.value, potential) if potential is not None else {}
        return [
            f"domain.potential.{AXES[axis]} jumps at the rim of {FACES[2 * axis + side]}: beyond the open faces there its wall "
            f"goes on at {rim.potential:.3g} V, the mean along the rim, from which it differs by up to {rim.jump:.0%} of what "
            "it does on the face; let it be constant along the rim, or move the open faces away"
            for (axis, side), rim in rims.items()
            if rim.jump > JUMP
        ]

    @property
    def value(self) -> Domain:
        """The domain that hierarchies are made of."""
        return Domain(self.lower, self.upper, self.cells, self.boundary)


def _require_measurable(axis: str, lower: float, upper: float, cells: int) -> None:
    """Refuse a domain whose volumes, or places of cells, double precision cannot represent."""
    length, farthest = upper - lower, max(abs(lower), abs(upper))
    if not SHORTEST <= length <= LONGEST:
        raise complaint(
            f"along {axis} reaches from {lower:g} to {upper:g} m, which is {length:g} m",
            f"give it a length from {SHORTEST:g} to {LONGEST:g} m",
            found="",
        )
    if length / cells < RESOLVED * farthest:
        raise complaint(
            f"along {axis} has cells of {length / cells:g} m at {farthest:g} m, too fine for numbers of 64 bits",
            "move it nearer to 0, or give it fewer cells",
            found="",
        )


def _per_face(value: Any) -> Any:
    if isinstance(value, str):
        value = dict.fromkeys(AXES, value)
    if not isinstance(value, Mapping):
        raise complaint("is no boundary", f"write one of {', '.join(BOUNDARIES)}, or one per axis")
    pairs = pairs_of(value)
    for axis, pair in pairs.items():
        for name in pair:
            if name not in BOUNDARIES:
                raise complaint(
                    "is not a boundary condition", close_match(str(name), BOUNDARIES), path=axis, found=name
                )
        if "periodic" in pair and pair != ("periodic", "periodic"):
            raise complaint(
                "is periodic at one face alone", "make it periodic on both or on none", path=axis, found=value[axis]
            )
    return {axis: pairs.get(axis, ("open", "open")) for axis in AXES}

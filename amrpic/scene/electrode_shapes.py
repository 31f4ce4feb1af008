"""The key `shape` of [[electrodes]]: bodies with units, and bodies made of others."""

from __future__ import annotations

import operator
from collections.abc import Callable
from dataclasses import dataclass
from functools import reduce
from pathlib import Path
from typing import Annotated, Any, ClassVar, Literal, Self

import numpy as np
from pydantic import AfterValidator, Field, PlainValidator, WithJsonSchema, model_validator

from .. import shapes
from ..errors import InputError
from ..shapes import checks
from ..shapes.revolved import read_profile
from ..units import UNITS
from .complaints import complaint, complaint_of
from .expression import formula
from .section import Section
from .units import Angle, Length, Length3


def _direction(value: Any) -> Any:
    try:
        checks.direction("it", value)
    except InputError:
        raise complaint("points nowhere", 'give "x", "y", "z" or a vector such as [0, 0, 1]', found=value) from None
    return value if isinstance(value, str) else tuple(map(float, value))


_VECTOR = {"type": "array", "items": {"type": "number"}, "minItems": 3, "maxItems": 3}
# A vector of any length but 0, or the name of an axis.
Direction = Annotated[
    Any, PlainValidator(_direction), WithJsonSchema({"anyOf": [{"enum": list(checks.AXES)}, _VECTOR]})
]
Radius = Annotated[Length, Field(gt=0)]


@dataclass(frozen=True)
class Formula:
    """A formula in x, y and z as a function that can be compared and sent to other ranks."""

    text: str

    def __call__(self, x: np.ndarray, y: np.ndarray, z: np.ndarray) -> np.ndarray:
        with np.errstate(all="ignore"):
            return np.asarray(formula(self.text)(x, y, z))


def _known_formula(text: str) -> str:
    formula(text)
    return text


Maker = Callable[..., shapes.Shape]


class Turn(Section):
    """A turn of a body, counter-clockwise about an axis through a point."""

    axis: Direction = Field(description="About which it is turned: a vector, or the name of an axis.")
    angle: Angle = Field(description="By how much, rad.")
    about: Length3 = Field(default=(0.0, 0.0, 0.0), description="A point on the axis, m.")


class Body(Section):
    """A body; turned first, and then moved."""

    shape: ClassVar[Maker]  # makes the solid from the values of the keys, where these are its arguments

    turned: Turn | None = Field(default=None, description="How it is turned.")
    moved: Length3 = Field(default=(0.0, 0.0, 0.0), description="By how much it is moved, m.")

    def _as_given(self) -> shapes.Shape:
        """Return it as it is before it is turned and moved: the `shape` with the keys of this section. Raises InputError."""
        keys = type(self).model_fields.keys() - Body.model_fields.keys() - {"kind"}
        return self.shape(**{key: getattr(self, key) for key in keys})

    @property
    def value(self) -> shapes.Shape:
        """The body, read from files where it is in any. Raises InputError."""
        shape = self._as_given()
        if self.turned is not None:
            shape = shape.turned(self.turned.axis, self.turned.angle, self.turned.about)
        return shape.moved(self.moved) if any(self.moved) else shape

    @property
    def files(self) -> list[str]:
        """The files that it is read from."""
        return []

    def _check(self) -> None:
        """Raise a complaint about keys that do not fit together."""

    @model_validator(mode="after")
    def _can_be_made(self) -> Self:
        self._check()
        if not self.files:  # which are read when a run is set up: its outputs go without them
            try:
                _ = self.value
            except InputError as refused:
                raise complaint_of(refused) from None
        return self


class SphereShape(Body):
    """A ball."""

    kind: Literal["sphere"] = "sphere"
    shape: ClassVar[Maker] = shapes.Sphere
    centre: Length3 = Field(default=(0.0, 0.0, 0.0), description="Its middle, m.")
    radius: Radius = Field(description="Of the ball, m.")


class BoxShape(Body):
    """A box along the axes."""

    kind: Literal["box"] = "box"
    shape: ClassVar[Maker] = shapes.Box
    lower: Length3 = Field(description="Its lower corner, m.")
    upper: Length3 = Field(description="Its upper corner, m.")


class Rod(Body):
    """A body about a line between two points."""

    start: Length3 = Field(description="Middle of one end, m.")
    end: Length3 = Field(description="Middle of the other end, m.")


class CylinderShape(Rod):
    """A round rod with flat ends."""

    kind: Literal["cylinder"] = "cylinder"
    shape: ClassVar[Maker] = shapes.Cylinder
    radius: Radius = Field(description="Of the rod, m.")


class ConeShape(Rod):
    """A cone, or a part of one, with flat ends."""

    kind: Literal["cone"] = "cone"
    shape: ClassVar[Maker] = shapes.Cone
    radius_start: Length = Field(ge=0, description="At the start, m.")
    radius_end: Length = Field(ge=0, description="At the end, m.")


class TorusShape(Body):
    """A ring."""

    kind: Literal["torus"] = "torus"
    shape: ClassVar[Maker] = shapes.Torus
    centre: Length3 = Field(default=(0.0, 0.0, 0.0), description="Its middle, m.")
    axis: Direction = Field(default="z", description="Of the ring.")
    radius: Radius = Field(description="Of the circle in the middle of the tube, m.")
    tube: Radius = Field(description="Radius of the tube, m.")


class PlaneShape(Body):
    """All that lies behind a plane, against its normal: to cut other bodies."""

    kind: Literal["plane"] = "plane"
    shape: ClassVar[Maker] = shapes.Plane
    point: Length3 = Field(description="On the plane, m.")
    normal: Direction = Field(description="Out of the body.")


class DiskShape(Body):
    """A round foil of no thickness."""

    kind: Literal["disk"] = "disk"
    shape: ClassVar[Maker] = shapes.Disk
    centre: Length3 = Field(default=(0.0, 0.0, 0.0), description="Its middle, m.")
    normal: Direction = Field(default="z", description="Of the foil.")
    radius: Radius = Field(description="Of the foil, m.")


class InFile(Body):
    """A body that may be in a file."""

    file: str | None = Field(default=None, description="A file with it; a relative path starts at the scene file.")
    unit: str = Field(default="m", description="Of the lengths in the file.")

    @property
    def files(self) -> list[str]:
        return [] if self.file is None else [self.file]

    def _check(self) -> None:
        if self.unit not in UNITS["length"]:
            self.refuse("unit", "is no unit of length", f"use one of {', '.join(UNITS['length'])}")


class RevolvedShape(InFile):
    """A polygon turned about an axis: its points are given, or the rows z, r of a CSV file."""

    kind: Literal["revolved"] = "revolved"
    points: list[tuple[Length, Length]] | None = Field(
        default=None,
        description="Corners (z, r), m; z counts along the axis from the origin. The last joins the first.",
    )
    axis: Direction = Field(default="z", description="About which it is turned.")
    origin: Length3 = Field(default=(0.0, 0.0, 0.0), description="The place of z = 0 on the axis, m.")

    def _check(self) -> None:
        super()._check()
        self.require_one("points", "file")

    def _as_given(self) -> shapes.Shape:
        points = self.points
        if self.file is not None:
            metres = UNITS["length"][self.unit]
            points = [(z * metres, r * metres) for z, r in read_profile(self.file)]
        return shapes.Revolved(points or (), self.axis, self.origin)


class STLShape(InFile):
    """What the triangles of an STL file enclose."""

    kind: Literal["stl"] = "stl"
    file: str = Field(description="The STL file; a relative path starts at the scene file.")
    foil: bool = Field(default=False, description="Whether the triangles themselves are metal, of no thickness.")

    def _as_given(self) -> shapes.Shape:
        return shapes.Mesh(self.file, self.unit, self.foil)


class LevelSetShape(Body):
    """Where a formula of x, y and z (m) is at most zero, in a box along the axes."""

    kind: Literal["level-set"] = "level-set"
    formula: Annotated[str, AfterValidator(_known_formula)] = Field(description='Such as "z^2 - (x^2 + y^2)/2 - 2e-5".')
    lower: Length3 = Field(description="Lower corner of the box, m.")
    upper: Length3 = Field(description="Upper corner of the box, m.")
    samples: int = Field(default=128, ge=2, description="Steps in which lines through the box are looked at.")

    def _as_given(self) -> shapes.Shape:
        return shapes.LevelSet(Formula(self.formula), self.lower, self.upper, self.samples)


class Combined(Body):
    """A body made of others."""

    join: ClassVar[Maker]  # of two bodies

    of: list[ShapeKind] = Field(min_length=1, description="The bodies.")

    def _as_given(self) -> shapes.Shape:
        return reduce(self.join, (body.value for body in self.of))

    @property
    def files(self) -> list[str]:
        return [name for body in self.of for name in body.files]


class UnionShape(Combined):
    """All that is in any of some bodies."""

    kind: Literal["union"] = "union"
    join: ClassVar[Maker] = operator.or_


class IntersectionShape(Combined):
    """What some bodies have in common."""

    kind: Literal["intersection"] = "intersection"
    join: ClassVar[Maker] = operator.and_


class DifferenceShape(Combined):
    """The first of some bodies without the others."""

    kind: Literal["difference"] = "difference"
    join: ClassVar[Maker] = operator.sub


ShapeKind = Annotated[
    SphereShape
    | BoxShape
    | CylinderShape
    | ConeShape
    | TorusShape
    | PlaneShape
    | DiskShape
    | RevolvedShape
    | STLShape
    | LevelSetShape
    | UnionShape
    | IntersectionShape
    | DifferenceShape,
    Field(discriminator="kind"),
]


def anchor_files(part: Any, folder: Path) -> None:
    """Make paths of files in a table of shapes, and in those that it is made of, start at a folder."""
    for member in part.values() if isinstance(part, dict) else part if isinstance(part, list) else ():
        anchor_files(member, folder)
    if isinstance(part, dict) and isinstance(part.get("file"), str):
        part["file"] = str(folder / part["file"])

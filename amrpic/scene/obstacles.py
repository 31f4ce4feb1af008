"""The sections [[apertures]] and [[screens]] of a scene: what particles are lost at, and where they are recorded."""

from __future__ import annotations

import math
import re
from abc import abstractmethod
from collections.abc import Iterable, Iterator, Sequence
from typing import Annotated, Literal, Self

import numpy as np
from pydantic import Field, model_validator

from ..mesh.window import axes
from ..shapes import Box, Cylinder, Shape
from ..shapes.shape import placed
from .electrode_shapes import ShapeKind
from .section import Section
from .units import Angle, Direction3, Length, Length3

HalfWidth = Annotated[Length, Field(gt=0)]
SEEN = "Whether the field ends on it, as on an electrode at 0 V; without that particles alone meet it."


class Obstacle(Section):
    """Something with a name of its own."""

    name: str = ""

    @model_validator(mode="after")
    def _is_a_word(self) -> Self:
        if self.name and not re.fullmatch(r"[\w+-]+", self.name):
            self.refuse("name", "cannot stand in tables and names of files", "use letters, digits, _, + and - alone")
        return self


class Turned(Obstacle):
    """Something that may look anywhere."""

    direction: Direction3 = Field(
        default=(0.0, 0.0, 1.0), description="Where its own z points to, along which it is passed; any length but 0."
    )
    roll: Angle = Field(default=0.0, description="Turn about that, from its own x towards y, rad.")
    reach: Length | None = Field(
        default=None,
        gt=0,
        description="Distance from its axis within which particles meet it, m; without it, any. In a ring it keeps those away "
        "that pass on the other side.",
    )

    @property
    def is_along_z(self) -> bool:
        """Whether its axes are those of the laboratory."""
        return self.direction[:2] == (0, 0) and self.direction[2] > 0 and self.roll == 0


class Aperture(Turned):
    """Solid all around a hole along its z. Particles that touch it are lost there."""

    name: str = Field(default="", description="A name of your own, in the records; aperture_0, … if not given.")
    centre: Length3 = Field(default=(0.0, 0.0, 0.0), description="Middle of the hole, in the laboratory, m.")
    length: Length | None = Field(
        default=None, gt=0, description="Of the solid along its z, m; without it the solid has no ends."
    )
    field: bool = Field(default=False, description=SEEN)

    @abstractmethod
    def _hole(self, far: float) -> Shape:
        """Return the hole in its own axes, as long as it reaches, m."""

    def solid(self, domain: float) -> Shape:
        """Return it as a body, as far as it may reach into a domain whose places are at most so far from 0, m."""
        far = 2 * (domain + math.hypot(*self.centre))
        half = far if self.length is None else self.length / 2
        body: Shape = Box((-far, -far, -half), (far, far, half))
        if self.reach is not None:
            body = body & Cylinder((0, 0, -far), (0, 0, far), self.reach)
        return placed(body - self._hole(2 * far), np.array(axes(self.direction, self.roll)).T, self.centre)


class RoundAperture(Aperture):
    """A round hole."""

    kind: Literal["round"] = "round"
    radius: Length = Field(gt=0, description="Of the hole, m.")

    def _hole(self, far: float) -> Shape:
        return Cylinder((0, 0, -far), (0, 0, far), self.radius)


class EllipticAperture(Aperture):
    """An elliptic hole."""

    kind: Literal["elliptic"] = "elliptic"
    half_widths: tuple[HalfWidth, HalfWidth] = Field(description="Half axes of the hole along x and y, m.")

    def _hole(self, far: float) -> Shape:
        return Cylinder((0, 0, -far), (0, 0, far), 1.0).scaled((*self.half_widths, 1.0))


class RectangularAperture(Aperture):
    """A rectangular hole."""

    kind: Literal["rectangular"] = "rectangular"
    half_widths: tuple[HalfWidth, HalfWidth] = Field(description="Of the hole along x and y, m.")

    def _hole(self, far: float) -> Shape:
        x, y = self.half_widths
        return Box((-x, -y, -far), (x, y, far))


class SolidAperture(Obstacle):
    """A solid of any shape."""

    kind: Literal["solid"] = "solid"
    name: str = Field(default="", description="A name of your own, in the records; aperture_0, … if not given.")
    shape: ShapeKind = Field(description="The solid.")
    field: bool = Field(default=False, description=SEEN)

    def solid(self, domain: float) -> Shape:
        """Return the body, read from files where it is in any. Raises InputError."""
        return self.shape.value


AnyAperture = Annotated[
    RoundAperture | EllipticAperture | RectangularAperture | SolidAperture, Field(discriminator="kind")
]


class Screen(Turned):
    """A plane where particles are recorded as they pass, in either direction: of constant z, or across a direction."""

    name: str = Field(min_length=1, description="A name of your own: the records are in screen_<name>.h5.")
    z: Length | None = Field(default=None, description="Where, in the laboratory, m.")
    centre: Length3 | None = Field(
        default=None,
        description="A point of the plane in the laboratory, m, in place of z; with it, direction may be any.",
    )

    @model_validator(mode="after")
    def _one_place(self) -> Self:
        self.require_one("z", "centre", remedy="give z, or centre and direction")
        if self.z is not None and not (self.is_along_z and self.reach is None):
            self.refuse("z", "is that of a plane across z", "give centre in place of z for others")
        return self


def aperture_names(apertures: Sequence[AnyAperture]) -> tuple[str, ...]:
    """Return a name for each aperture."""
    return tuple(aperture.name or f"aperture_{number}" for number, aperture in enumerate(apertures))


def repeated_names(names: Iterable[str], reserved: Iterable[str] = ()) -> Iterator[tuple[int, str]]:
    """Yield number and name of those that have been `reserved`, or are there before."""
    earlier = set(reserved)
    for number, name in enumerate(names):
        if name in earlier:
            yield number, name
        earlier.add(name)


def out_of_reach(apertures: Sequence[AnyAperture], screens: Sequence[Screen], lower: float, upper: float) -> list[str]:
    """Return a sentence for each aperture and screen that no particle meets while z stays from `lower` to `upper`, m."""
    spans = [(f"screens.{number}", screen.z, screen.z) for number, screen in enumerate(screens) if screen.z is not None]
    for number, aperture in enumerate(apertures):
        if isinstance(aperture, SolidAperture) or not aperture.is_along_z:
            continue
        half = math.inf if aperture.length is None else aperture.length / 2
        spans.append((f"apertures.{number}", aperture.centre[2] - half, aperture.centre[2] + half))
    return [
        f"{obstacle} lies outside the domain, which reaches from {lower:g} to {upper:g} m along z: no particle meets it"
        for obstacle, first, last in spans
        if last < lower or first > upper
    ]

"""The sections [[elements]] of a scene: fields of magnets, cavities and maps along a beam line."""

from __future__ import annotations

import math
from typing import Annotated, ClassVar, Literal, Self

import numpy as np
from pydantic import Field, model_validator

from ..particles.species import Species
from ..units import SPEED_OF_LIGHT
from .section import Section
from .units import (
    Angle,
    Direction3,
    ElectricGradient3,
    FieldStrength,
    FieldStrength3,
    Frequency,
    Length,
    Length3,
    MagneticField,
    MagneticField3,
    MagneticGradient,
    Potential,
    WaveNumber3,
)

# Of the magnets of PEP, as COSY INFINITY and OPAL take them (M. Berz, K. Makino, COSY INFINITY beam physics manual).
ENGE_OF_DIPOLES = (0.478959, 1.911289, -1.185953, 1.630554, -1.082657, 0.318111)
ENGE_OF_QUADRUPOLES = (0.296471, 4.533219, -2.270982, 1.068627, -0.036391, 0.022261)
FALLEN = 60.0  # of the polynomial: the profile has then ended, as e^-60 is below rounding with its derivatives
LARGEST_REACH = 100.0  # gaps


def enge_reach(coefficients: tuple[float, ...]) -> float:
    """Return so many gaps from its end a profile has fallen to 0, and inside risen to 1; infinity if it never does."""
    u = np.arange(0.0, LARGEST_REACH, 0.01)
    rising = np.minimum(np.polyval(coefficients[::-1], u), -np.polyval(coefficients[::-1], -u))
    low = np.flatnonzero(~(rising >= FALLEN))
    return float(u[low[-1] + 1]) if low[-1] + 1 < len(u) else math.inf


class Element(Section):
    """A field somewhere along the beam line, in axes of its own. Where elements overlap, their fields add."""

    name: str = Field(default="", description="A name of your own, kept in the outputs.")
    centre: Length3 = Field(default=(0.0, 0.0, 0.0), description="Middle of the element, m.")
    direction: Direction3 = Field(
        default=(0.0, 0.0, 1.0), description="Where its axis, its own z, points to; any length but 0."
    )
    roll: Angle = Field(default=0.0, description="Turn about its axis, from its own x towards y, rad.")
    reach: Length | None = Field(
        default=None, gt=0, description="Distance from its axis within which it acts, m; without it, any."
    )


class PossiblyEverywhere(Element):
    """An element that may have no ends."""

    length: Length | None = Field(
        default=None, gt=0, description="Along its axis, m, with hard edges; without it the field is everywhere."
    )


class UniformElement(PossiblyEverywhere):
    """Uniform fields."""

    kind: Literal["uniform"] = "uniform"
    electric_field: FieldStrength3 = Field(default=(0.0, 0.0, 0.0), description="Along its x, y, z, V/m.")
    magnetic_field: MagneticField3 = Field(default=(0.0, 0.0, 0.0), description="Along its x, y, z, T.")


def gradient_of(wavenumber: float, species: Species, momentum: tuple[float, float, float]) -> float:
    """Return the gradient γ m v² k²/q (V/m²) in which particles of a momentum (kg m/s) oscillate with k (1/m) across it."""
    p = math.hypot(*momentum)
    gamma = math.hypot(1.0, p / (species.mass * SPEED_OF_LIGHT))
    return wavenumber**2 * p * p / (gamma * species.mass * species.charge)


class ConstantFocusingElement(PossiblyEverywhere):
    """Linear focusing: the electric field -(gx x, gy y, gz z)."""

    kind: Literal["constant-focusing"] = "constant-focusing"
    gradient: ElectricGradient3 | None = Field(
        default=None, description="gx, gy, gz in V/m²; positive ones focus positive particles."
    )
    wavenumber: WaveNumber3 | None = Field(
        default=None,
        description="Of the oscillation along its x, y, z, 1/m, in place of the gradient: g = γ m v² k²/q with species and "
        "mean momentum of the first bunch. Along the motion the mass is γ² times larger, and the wave number 1/γ of it.",
    )

    @model_validator(mode="after")
    def _one_strength(self) -> Self:
        self.require_one("gradient", "wavenumber")
        return self

    def gradient_for(self, species: Species, momentum: tuple[float, float, float]) -> tuple[float, float, float]:
        """Return the gradient in V/m², for particles of a mean momentum in kg m/s if it is given by wave numbers."""
        if self.wavenumber is None:
            assert self.gradient is not None
            return self.gradient
        x, y, z = (gradient_of(k, species, momentum) for k in self.wavenumber)
        return (x, y, z)


class FringedElement(Element):
    """A magnet with hard edges, or with the fringe of Enge at both ends."""

    usual: ClassVar[tuple[float, ...]]  # coefficients of the fringe where none are given
    length: Length = Field(gt=0, description="From end to end, m: between hard edges, or the origins of the fringes.")
    fringe: Literal["hard", "enge"] = Field(
        default="hard",
        description="Ends: hard, or the profile 1/(1 + exp(Σ enge_n (s/gap)^n)), s outwards from the end.",
    )
    gap: Length | None = Field(default=None, gt=0, description="Full aperture, m: the length scale of the fringe.")
    enge: list[float] | None = Field(
        default=None, min_length=2, max_length=6, description="Coefficients; without them those of magnets of PEP."
    )

    @model_validator(mode="after")
    def _fringe(self) -> Self:
        if self.fringe == "hard":
            for key, value in (("gap", self.gap), ("enge", self.enge)):
                if value is not None:
                    self.refuse(key, "means nothing to hard edges", 'set fringe = "enge", or leave it out')
        elif self.gap is None:
            self.refuse("gap", "is missing", "add the full aperture that the fringe scales with")
        if math.isinf(enge_reach(self.coefficients)):
            self.refuse(
                "enge",
                f"does not let the field fall from 1 to 0 within {LARGEST_REACH:g} gaps",
                "give a polynomial that grows from below -60 to above 60",
            )
        return self

    @property
    def coefficients(self) -> tuple[float, ...]:
        """The six coefficients of the fringe."""
        enge = tuple(self.enge or self.usual)
        return enge + (0.0,) * (6 - len(enge))


class QuadrupoleElement(FringedElement):
    """A quadrupole: B = (G y, G x, 0) inside."""

    usual = ENGE_OF_QUADRUPOLES
    kind: Literal["quadrupole"] = "quadrupole"
    gradient: MagneticGradient = Field(
        description="G in T/m; a positive one focuses positive particles that move along +z in x."
    )


class DipoleElement(FringedElement):
    """A dipole: B = (0, field, 0) between two pole faces, at right angles to its axis unless they are turned about its y.

    As with MAD-X's rbend, a positive angle makes the magnet shorter at positive x: where particles turn to -x, such a face
    defocuses in x and focuses in y. A sector magnet that turns by θ to -x has both angles -θ/2.
    """

    usual = ENGE_OF_DIPOLES
    kind: Literal["dipole"] = "dipole"
    field: MagneticField = Field(
        description="B_y in T; a positive one turns positive particles that move along +z to -x."
    )
    entrance_angle: Angle = Field(
        default=0.0, gt=-1.5, lt=1.5, description="Of the pole face at its low z, rad; positive: shorter at x > 0."
    )
    exit_angle: Angle = Field(
        default=0.0, gt=-1.5, lt=1.5, description="Of the pole face at its high z, rad; positive: shorter at x > 0."
    )
    turn: Angle = Field(
        default=0.0,
        gt=-3.0,
        lt=3.0,
        description="Of the orbit towards -x, rad: that of the arc which the gradient is about.",
    )
    gradient: MagneticGradient = Field(
        default=0.0, description="Of B_y outwards, about the arc through the middles of both hard faces, T/m."
    )
    edge_integrals: tuple[Length, Length] = Field(
        default=(0.0, 0.0),
        description="Of the fringes that hard faces stand for, ∫ f (1 - f) ds, m: 2 fint hgap of MAD-X. They take focusing "
        "across the bend away, for particles that turn by `turn`.",
    )

    @model_validator(mode="after")
    def _of_hard_faces(self) -> Self:
        for key, value, absent in (
            ("gradient", self.gradient, 0.0),
            ("edge_integrals", self.edge_integrals, (0.0, 0.0)),
        ):
            if value != absent and self.fringe != "hard":
                self.refuse(key, "is for hard faces alone", 'set fringe = "hard", or leave it out')
        if self.edge_integrals != (0.0, 0.0) and self.turn == 0:
            self.refuse("turn", "is missing", "give the angle by which the orbit turns")
        return self


Strengths = Annotated[list[float], Field(max_length=6)]


class MultipoleElement(Element):
    """A multipole: B_y + i B_x = Σ (normal_n + i skew_n) (x + i y)^n / n! inside, with hard edges; n = 0 is a kicker."""

    kind: Literal["multipole"] = "multipole"
    length: Length = Field(gt=0, description="From end to end, m.")
    normal: Strengths = Field(
        default=[], description="Of the dipole, quadrupole, sextupole, … to the sixth, in T, T/m, T/m², …"
    )
    skew: Strengths = Field(default=[], description="The same, turned by a quarter of their symmetry.")


class SolenoidElement(Element):
    """A solenoid: B = (0, 0, field) inside."""

    kind: Literal["solenoid"] = "solenoid"
    length: Length = Field(gt=0, description="From end to end, m.")
    field: MagneticField = Field(description="B_z in T; of a coil as if it were very long.")
    fringe: Literal["hard", "sheet"] = Field(
        default="hard",
        description="Ends: hard, with their radial kick, or those of a thin coil, whose field is everywhere.",
    )
    radius: Length | None = Field(
        default=None, gt=0, description="Of the coil, m; the field is an expansion about its axis, good well inside."
    )

    @model_validator(mode="after")
    def _coil(self) -> Self:
        if self.fringe == "sheet" and self.radius is None:
            self.refuse("radius", "is missing", "add the radius of the coil")
        if self.fringe == "hard" and self.radius is not None:
            self.refuse("radius", "means nothing to hard edges", 'set fringe = "sheet", or leave it out')
        return self


class OscillatingElement(Element):
    """An element whose electric field oscillates as cos(2π frequency t + phase)."""

    frequency: Frequency = Field(default=0.0, ge=0, description="In Hz; 0 is a constant field.")
    phase: Angle = Field(default=0.0, description="At t = 0, rad; 0 is the crest.")

    @model_validator(mode="after")
    def _phase_of_something(self) -> Self:
        if self.phase != 0 and self.frequency == 0:
            self.refuse("phase", "means nothing without a frequency", "give one")
        return self


class GapElement(OscillatingElement):
    """An accelerating gap: on the axis E_z has the profile (1 - (2z/length)²)⁴, of 0.4 lengths at half its height."""

    kind: Literal["rf-gap"] = "rf-gap"
    length: Length = Field(gt=0, description="Of all of the field, m.")
    voltage: Potential = Field(description="Integral of E_z along the axis at the crest, V.")


class CavityElement(OscillatingElement):
    """A pillbox cavity in its mode TM010, between two plates and out to the radius 2.405 c / (2π frequency)."""

    kind: Literal["cavity"] = "cavity"
    length: Length = Field(gt=0, description="From plate to plate, m.")
    field: FieldStrength = Field(description="E_z on the axis at the crest, V/m.")

    @model_validator(mode="after")
    def _oscillates(self) -> Self:
        if self.frequency == 0:
            remedy = "add it; a cavity's radius follows from it"
            self.refuse("frequency", "is missing", remedy, found="nothing")
        return self


class MapElement(OscillatingElement):
    """A field on a regular grid from an openPMD file (HDF5): x, y, z or, around its axis, r, z; zero outside the grid.

    Coordinates of the grid are those of the element, whose centre is their origin. With a frequency, the file holds the
    amplitudes of E cos and of -B sin, for which curl E = 2π frequency B.
    """

    kind: Literal["map"] = "map"
    file: str = Field(description="The file; a relative path starts at the scene file.")
    iteration: int | None = Field(
        default=None, ge=0, description="Which iteration of the file; needed if it holds several."
    )
    scale: float = Field(default=1.0, description="Factor of both fields.")


AnyElement = Annotated[
    UniformElement
    | QuadrupoleElement
    | SolenoidElement
    | DipoleElement
    | MultipoleElement
    | ConstantFocusingElement
    | GapElement
    | CavityElement
    | MapElement,
    Field(discriminator="kind"),
]

"""Bunches from distributions, with the sizes of their phase space.

All except the sphere are sized by the rms size `sigma` per axis, or by `twiss`, emittance and Twiss parameters per plane.
Both are those of the whole bunch, whatever its shape, so bunches of different shapes can be compared as equivalent ones. The
radius at which a shape ends follows by a factor in its description.
"""

from __future__ import annotations

from typing import Literal, Self

import numpy as np
from pydantic import ConfigDict, Field, model_validator

from ..particles import distributions
from ..particles.phase_space import PhasePlane
from ..units import SPEED_OF_LIGHT
from .bunches import Train
from .section import Section, refuse_negative
from .units import Emittance, Length, Length3, Positive3


class TwissPlane(Section):
    """One plane of phase space, such as x and p_x, by emittance and Twiss parameters."""

    emittance: Emittance = Field(
        ge=0,
        description="Normalised rms emittance, sqrt(<x²><p²> - <x p>²) / (m c), m rad, as in the time series; 0 is cold.",
    )
    alpha: float = Field(default=0.0, description="Twiss α: <x p> = -α emittance m c; positive converges.")
    beta: Length | None = Field(
        default=None,
        gt=0,
        description="Twiss β, m: <x²> = β emittance m c / p with the mean momentum p of the bunch, whatever its direction.",
    )
    sigma: Length | None = Field(default=None, ge=0, description="Rms size, m, in place of β.")

    @model_validator(mode="after")
    def _one_size(self) -> Self:
        self.require_one("beta", "sigma")
        if self.sigma == 0 and self.emittance > 0:
            self.refuse("sigma", "is zero although the emittance is not", "give a size")
        return self

    def plane(self, mass: float, momentum: float) -> PhasePlane:
        """Return the plane for particles of a mass (kg) and a mean momentum (kg m/s)."""
        size = self.sigma
        if size is None:
            assert self.beta is not None
            size = float(np.sqrt(self.beta * self.emittance * mass * SPEED_OF_LIGHT / momentum))
        return PhasePlane.of_emittance(self.emittance, self.alpha, size, mass)


class Twiss(Section):
    """The three planes of phase space."""

    x: TwissPlane = Field(description="x and p_x.")
    y: TwissPlane = Field(description="y and p_y.")
    z: TwissPlane = Field(description="z and p_z.")


class SizedBunch(Train):
    """A bunch whose rms sizes are given, and momenta with them or apart."""

    model_config = ConfigDict(
        json_schema_extra={"allOf": [{"oneOf": [{"required": ["sigma"]}, {"required": ["twiss"]}]}]}
    )

    sigma: Length3 | None = Field(
        default=None, description="Rms size of the whole bunch per axis, m; 0 is legal. The main way to size a bunch."
    )
    twiss: Twiss | None = Field(
        default=None,
        description="Emittance and Twiss parameters per plane, in place of sigma and momentum_spread: a bunch whose places "
        "and momenta are correlated.",
    )

    @model_validator(mode="after")
    def _one_size(self) -> Self:
        self.require_one("sigma", "twiss", remedy='add the rms size, such as sigma = "2 mm", or twiss')
        for axis, sigma in enumerate(self.sigma or ()):
            refuse_negative(f"sigma.{axis}", sigma, "m")
        if self.twiss is not None:
            self._check_twiss(self.twiss)
        return self

    def _check_twiss(self, twiss: Twiss) -> None:
        if any(self.momentum_spread):
            self.refuse("momentum_spread", "is given as well as twiss, whose emittances give it", "keep one of the two")
        for axis in "xyz":
            if getattr(twiss, axis).beta is not None and not any(self.mean_momentum):
                self.refuse(
                    f"twiss.{axis}.beta",
                    "needs a mean momentum, to which it refers",
                    "give momentum or velocity, or sigma in place of beta",
                )

    @property
    def planes(self) -> tuple[PhasePlane, PhasePlane, PhasePlane]:
        if self.twiss is not None:
            mass, momentum = self.species.mass, float(np.linalg.norm(self.mean_momentum))
            x, y, z = (plane.plane(mass, momentum) for plane in (self.twiss.x, self.twiss.y, self.twiss.z))
        else:
            assert self.sigma is not None
            pairs = zip(self.sigma, self.momentum_spread, strict=True)
            x, y, z = (PhasePlane(size, 0.0, spread) for size, spread in pairs)
        return (x, y, z)


class GaussianBunch(SizedBunch):
    """Normal distribution along all axes of phase space, which may be cut off along x, y and z.

    With a cutoff c, sigma and twiss are those of the whole distribution; what is left of it has the rms size
    sigma √(1 - √(2/π) c exp(-c²/2) / erf(c/√2)).
    """

    distribution: Literal["gaussian"] = "gaussian"
    cutoff: Positive3 | None = Field(
        default=None, description="No particle is farther from the centre along an axis than so many sigma."
    )

    def unit(self, u: np.ndarray) -> np.ndarray:
        return distributions.gaussian(u) if self.cutoff is None else distributions.cut_gaussian(u, self.cutoff)

    @property
    def rms(self) -> tuple[float, float, float]:
        if self.cutoff is None:
            return super().rms
        x, y, z = (size * distributions.cut_rms(c) for size, c in zip(super().rms, self.cutoff, strict=True))
        return (x, y, z)


class SphereBunch(Train):
    """Constant density in a sphere, whose rms size per axis is its radius / √5; normal momenta."""

    distribution: Literal["sphere"] = "sphere"
    radius: Length = Field(description="Radius, m; 0 is legal.")

    @model_validator(mode="after")
    def _size(self) -> Self:
        refuse_negative("radius", self.radius, "m")
        return self

    @property
    def planes(self) -> tuple[PhasePlane, PhasePlane, PhasePlane]:
        x, y, z = (PhasePlane(self.radius / float(np.sqrt(5)), 0.0, spread) for spread in self.momentum_spread)
        return (x, y, z)

    def unit(self, u: np.ndarray) -> np.ndarray:
        return distributions.ball(u)


class WaterbagBunch(SizedBunch):
    """Constant density in a six-dimensional ellipsoid of phase space, which ends at √8 sigma."""

    distribution: Literal["waterbag"] = "waterbag"

    def unit(self, u: np.ndarray) -> np.ndarray:
        return distributions.waterbag(u)


class KVBunch(SizedBunch):
    """Kapchinsky-Vladimirsky: the shell of an ellipsoid in (x, p_x, y, p_y), an even ellipse in (x, y) that ends at 2 sigma.

    Its transverse self-force is linear, so that it keeps its shape. Momenta along z are normal.
    """

    distribution: Literal["kv"] = "kv"
    profile: Literal["uniform", "gaussian"] = Field(
        default="uniform", description="Density along z: uniform ends at √3 sigma, as the idea of a long beam wants it."
    )

    def unit(self, u: np.ndarray) -> np.ndarray:
        return distributions.kapchinsky_vladimirsky(u, self.profile == "gaussian")


class ParabolicBunch(SizedBunch):
    """Density 1 - r² in an ellipsoid, which ends at √7 sigma; normal momenta."""

    distribution: Literal["parabolic"] = "parabolic"

    def unit(self, u: np.ndarray) -> np.ndarray:
        return distributions.parabolic(u)


class HollowBunch(SizedBunch):
    """Constant density between two similar ellipsoids, or two similar elliptic cylinders along z; normal momenta.

    With a = inner, a shell ends at √(5 (1 - a³) / (1 - a⁵)) sigma along each axis, a tube at 2 / √(1 + a²) sigma along x and y
    and √3 sigma along z.
    """

    distribution: Literal["hollow"] = "hollow"
    inner: float = Field(ge=0, lt=1, description="Inner radius as a part of the outer one; 0 is a full ellipsoid.")
    form: Literal["shell", "tube"] = Field(
        default="shell", description="shell: hollow on all sides; tube: open at its two ends along z."
    )

    def unit(self, u: np.ndarray) -> np.ndarray:
        return (distributions.shell if self.form == "shell" else distributions.tube)(u, self.inner)


class HaloBunch(SizedBunch):
    """A normal core, and a normal tail that is larger in places and momenta.

    The core's size is that of the whole divided by √(1 + tail_share (tail_size² - 1)).
    """

    distribution: Literal["halo"] = "halo"
    tail_share: float = Field(gt=0, lt=1, description="Share of the particles that are in the tail.")
    tail_size: float = Field(gt=1, description="Rms size of the tail over that of the core.")

    def unit(self, u: np.ndarray) -> np.ndarray:
        return distributions.halo(u, self.tail_share, self.tail_size)

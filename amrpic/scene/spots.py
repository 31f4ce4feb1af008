"""Where on a plane particles are born."""

from __future__ import annotations

import math
from typing import Annotated, Literal

import numpy as np
from pydantic import Field

from .section import Section
from .units import Length

Pair = tuple[Length, Length]
Sizes = tuple[Annotated[Length, Field(gt=0)], Annotated[Length, Field(gt=0)]]


class Spot(Section):
    """A density on a plane, in two coordinates of its own."""

    centre: Pair = Field(
        default=(0.0, 0.0),
        description="Middle, m: on a face, along its axes in the order x, y, z; on a plane, its own x, y.",
    )

    def place(self, u: np.ndarray) -> np.ndarray:
        """Return places (2, n) in m for numbers (2, n) in (0, 1)."""
        return np.array(self.centre)[:, None] + self._about_centre(u)

    def _about_centre(self, u: np.ndarray) -> np.ndarray:
        raise NotImplementedError

    def holds(self, places: np.ndarray) -> np.ndarray:
        """Return which places (2, n) in m lie in the spot."""
        raise NotImplementedError

    @property
    def reach(self) -> tuple[np.ndarray, np.ndarray]:
        """Lower and upper corner (2,) of a rectangle that holds the spot, m."""
        half = np.array(self._half)
        return np.array(self.centre) - half, np.array(self.centre) + half

    @property
    def _half(self) -> Pair:
        raise NotImplementedError


class DiscSpot(Spot):
    """Even in a circle."""

    shape: Literal["disc"] = "disc"
    radius: Length = Field(gt=0, description="m.")

    def _about_centre(self, u: np.ndarray) -> np.ndarray:
        return _polar(self.radius * np.sqrt(u[0]), u[1])

    def holds(self, places: np.ndarray) -> np.ndarray:
        return np.hypot(*(places - np.array(self.centre)[:, None])) <= self.radius

    @property
    def _half(self) -> Pair:
        return (self.radius, self.radius)


class RectangleSpot(Spot):
    """Even in a rectangle."""

    shape: Literal["rectangle"] = "rectangle"
    half_widths: Sizes = Field(description="From the middle to the sides, m.")

    def _about_centre(self, u: np.ndarray) -> np.ndarray:
        return np.array(self.half_widths)[:, None] * (2 * u[:2] - 1)

    def holds(self, places: np.ndarray) -> np.ndarray:
        return (np.abs(places - np.array(self.centre)[:, None]) <= np.array(self.half_widths)[:, None]).all(axis=0)

    @property
    def _half(self) -> Pair:
        return self.half_widths


class GaussianSpot(Spot):
    """A Gaussian, cut at an ellipse."""

    shape: Literal["gaussian"] = "gaussian"
    sigma: Sizes = Field(description="Rms sizes before the cut, m.")
    cutoff: float = Field(default=5.0, gt=0, description="Radius that is kept, in rms sizes.")

    def _about_centre(self, u: np.ndarray) -> np.ndarray:
        inside = -math.expm1(-(self.cutoff**2) / 2)
        radius = np.minimum(np.sqrt(-2 * np.log1p(-u[0] * inside)), self.cutoff)
        return np.array(self.sigma)[:, None] * _polar(radius, u[1])

    def holds(self, places: np.ndarray) -> np.ndarray:
        units = (places - np.array(self.centre)[:, None]) / np.array(self.sigma)[:, None]
        return np.hypot(*units) <= self.cutoff

    @property
    def _half(self) -> Pair:
        x, y = (self.cutoff * size for size in self.sigma)
        return (x, y)


def _polar(radius: np.ndarray, turn: np.ndarray) -> np.ndarray:
    return radius * np.stack([np.cos(2 * np.pi * turn), np.sin(2 * np.pi * turn)])


AnySpot = Annotated[DiscSpot | RectangleSpot | GaussianSpot, Field(discriminator="shape")]

"""Sources of beams that come from elsewhere: through a plane, by Twiss parameters, or as a Python function says."""

from __future__ import annotations

import math
from typing import Annotated, Any, Literal, Self

import numpy as np
import scipy
from pydantic import Field, model_validator

from ..particles import distributions
from ..units import SPEED_OF_LIGHT
from .bunch_shapes import TwissPlane
from .emitted_momenta import AnyMomenta, BeamMomenta, ColdMomenta
from .section import Section
from .sources import (
    FieldSource,
    FileSource,
    GivenSource,
    OfSpecies,
    PhotoSource,
    SpaceChargeLimitedSource,
    ThermionicSource,
)
from .spots import AnySpot, Pair
from .units import Energy

REACH = 5.0  # rms sizes of the part of the plane that maps show


class TwissAcross(Section):
    """Both planes of phase space across the way of a beam, along the surface's own axes."""

    x: TwissPlane = Field(description="First axis and its momentum.")
    y: TwissPlane = Field(description="Second axis and its momentum.")


class InjectionSource(GivenSource):
    """A beam that comes through a face or a plane: with a steady pulse a direct current, else a bunch."""

    process: Literal["injection"] = "injection"  # type: ignore[assignment]
    spot: AnySpot | None = Field(default=None, description="Not of this source: twiss says where.")
    momenta: AnyMomenta = Field(default=ColdMomenta(), description="Not of this source: energy and twiss give them.")
    centre: Pair = Field(default=(0.0, 0.0), description="Where its middle passes, along the surface's own axes, m.")
    energy: Energy = Field(gt=0, description="Mean kinetic energy, J.")
    energy_spread: Energy = Field(default=0.0, ge=0, description="Rms of the kinetic energy, normally distributed, J.")
    twiss: TwissAcross = Field(description="Emittances and Twiss parameters where it passes.")
    distribution: Literal["gaussian", "waterbag", "kv"] = Field(
        default="gaussian",
        description="Of places and momenta across: normal, a waterbag in six coordinates, or Kapchinsky and Vladimirsky's.",
    )

    @model_validator(mode="after")
    def _by_twiss(self) -> Self:
        for key in ("spot", "momenta"):
            if key in self.model_fields_set and getattr(self, key) not in (None, ColdMomenta()):
                self.refuse(key, "is given as well as twiss", "leave it out")
        return self

    @property
    def momentum(self) -> float:
        """Of the mean energy, kg m/s."""
        return float(self._momentum_of(np.array(self.energy)))

    @property
    def emitted(self) -> AnyMomenta:
        return BeamMomenta(energy=self.energy + 3 * self.energy_spread)

    @property
    def reach(self) -> tuple[np.ndarray, np.ndarray]:
        half = np.array([max(REACH * plane.size, math.ulp(1.0)) for plane in self._planes])
        return np.array(self.centre) - half, np.array(self.centre) + half

    def born(self, u: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        x, y, _, px, py, _ = self._unit(u)
        units = np.array([x, y]), np.array([px, py])
        size, lean, spread = (
            np.array([[getattr(plane, name)] for plane in self._planes]) for name in ("size", "lean", "spread")
        )
        across = lean * units[0] + spread * units[1]
        energy = np.maximum(self.energy + self.energy_spread * scipy.special.ndtri(u[6]), 0.0)
        along = np.sqrt(np.maximum(self._momentum_of(energy) ** 2 - np.square(across).sum(axis=0), 0.0))
        return np.array(self.centre)[:, None] + size * units[0], np.array([along, *across])

    @property
    def _planes(self) -> list[Any]:
        return [plane.plane(self.species.mass, self.momentum) for plane in (self.twiss.x, self.twiss.y)]

    def _unit(self, u: np.ndarray) -> np.ndarray:
        match self.distribution:
            case "gaussian":
                return distributions.gaussian(u)
            case "waterbag":
                return distributions.waterbag(u)
        return distributions.kapchinsky_vladimirsky(u, normal_z=True)

    def _momentum_of(self, energy: np.ndarray) -> np.ndarray:
        rest = self.species.mass * SPEED_OF_LIGHT**2
        return np.sqrt(energy * (energy + 2 * rest)) / SPEED_OF_LIGHT


class FunctionSource(OfSpecies):
    """Particles that are born as a Python function says; from Python only, as files and checkpoints keep nothing but its name.

    It is called once a step on each rank with the times (s) at which the step starts and stops, and returns the same on all:
    times of birth (n,) s, places (n, 3) m, momenta (n, 3) kg m/s and weights (n,), how many real particles each stands for.
    """

    process: Literal["function"] = "function"
    function: Any = Field(default=None, exclude=True, repr=False, description="The function.")

    @model_validator(mode="after")
    def _can_be_called(self) -> Self:
        if not callable(self.function):
            self.refuse(
                "function",
                "is no Python function, which no file or checkpoint keeps",
                "pass the scene from Python with function=…, at a restart by Simulation.restart(comm, path, scene)",
            )
        return self


AnySource = Annotated[
    GivenSource
    | PhotoSource
    | InjectionSource
    | FileSource
    | FunctionSource
    | SpaceChargeLimitedSource
    | ThermionicSource
    | FieldSource,
    Field(discriminator="process"),
]

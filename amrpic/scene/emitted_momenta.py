"""With which momenta the particles of a source are born."""

from __future__ import annotations

import math
from typing import Annotated, Literal, Self

import numpy as np
import scipy
from pydantic import Field, model_validator

from ..particles import emission
from ..units import SPEED_OF_LIGHT
from .section import Section
from .units import Energy, Momentum3

MOST_OF_REST = 0.01  # of m c²: energies of emission beyond it would need relativistic formulas


class Emitted(Section):
    """A distribution of momenta at a surface."""

    def momenta(self, u: np.ndarray, mass: float) -> np.ndarray:
        """Return momenta in kg m/s (3, n), along the normal and across, for numbers (3, n) in (0, 1)."""
        raise NotImplementedError

    def largest_energy(self) -> float:
        """Return a kinetic energy that particles have, about the largest, J."""
        return 0.0


class ColdMomenta(Emitted):
    """At rest: the field takes them away."""

    kind: Literal["cold"] = "cold"

    def momenta(self, u: np.ndarray, mass: float) -> np.ndarray:
        return np.zeros((3, u.shape[1]))


class OfOneEnergy(Emitted):
    """Momenta with an energy."""

    energy: Energy = Field(gt=0, description="J.")

    def largest_energy(self) -> float:
        return self.energy


class ThermalMomenta(OfOneEnergy):
    """The flux of a Maxwellian, as it leaves a hot surface: mean transverse energy and mean normal energy are both kT."""

    kind: Literal["thermal"] = "thermal"
    energy: Energy = Field(gt=0, description="kT, J.")

    def momenta(self, u: np.ndarray, mass: float) -> np.ndarray:
        return emission.thermal(u, self.energy, mass)


class IsotropicMomenta(OfOneEnergy):
    """One kinetic energy, as many in each direction away from the surface; mean transverse energy 2/3 of it."""

    kind: Literal["isotropic"] = "isotropic"

    def momenta(self, u: np.ndarray, mass: float) -> np.ndarray:
        return emission.isotropic(u, self.energy, mass)


class LambertMomenta(OfOneEnergy):
    """One kinetic energy, directions by Lambert's cosine law; mean transverse energy half of it."""

    kind: Literal["lambert"] = "lambert"

    def momenta(self, u: np.ndarray, mass: float) -> np.ndarray:
        return emission.lambert(u, self.energy, mass)


class ThreeStepMomenta(Emitted):
    """Photo-emission from a cold metal in three steps; mean transverse energy (photon_energy - work_function) / 3."""

    kind: Literal["three-step"] = "three-step"
    photon_energy: Energy = Field(gt=0, description="J.")
    work_function: Energy = Field(gt=0, description="As the field at the surface lowers it, J.")
    fermi_energy: Energy = Field(gt=0, description="J; 7 eV for copper.")

    @model_validator(mode="after")
    def _frees_electrons(self) -> Self:
        if self.photon_energy <= self.work_function:
            self.refuse(
                "photon_energy", "does not exceed the work function, so that no electron leaves", "give a larger one"
            )
        return self

    def momenta(self, u: np.ndarray, mass: float) -> np.ndarray:
        return emission.three_step(u, self.photon_energy, self.work_function, self.fermi_energy, mass)

    def largest_energy(self) -> float:
        return self.fermi_energy + self.photon_energy


class BeamMomenta(Emitted):
    """A beam: one kinetic energy along the normal, and a normal spread."""

    kind: Literal["beam"] = "beam"
    energy: Energy = Field(ge=0, description="Kinetic energy of the mean momentum, J.")
    spread: Momentum3 = Field(
        default=(0.0, 0.0, 0.0),
        description="Standard deviation of the momentum along the normal and the two axes across, kg m/s.",
    )

    def largest_energy(self) -> float:
        return self.energy

    def momenta(self, u: np.ndarray, mass: float) -> np.ndarray:
        over_mc2 = self.energy / (mass * SPEED_OF_LIGHT**2)
        mean = math.sqrt(over_mc2 * (over_mc2 + 2)) * mass * SPEED_OF_LIGHT
        return np.array([mean, 0.0, 0.0])[:, None] + np.array(self.spread)[:, None] * scipy.special.ndtri(u)


AnyMomenta = Annotated[
    ColdMomenta | ThermalMomenta | IsotropicMomenta | LambertMomenta | ThreeStepMomenta | BeamMomenta,
    Field(discriminator="kind"),
]

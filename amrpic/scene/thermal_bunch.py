"""The bunch that is in thermal equilibrium with its focusing channel and its own field."""

from __future__ import annotations

import math
from typing import Literal, Self

import numpy as np
from pydantic import Field, model_validator

from ..particles import distributions
from ..particles.phase_space import PhasePlane
from ..particles.thermal_equilibrium import line_gradient, matched
from ..units import SPEED_OF_LIGHT
from .bunches import Train
from .elements import gradient_of
from .units import ElectricGradient, Emittance, Length, Momentum, WaveNumber

SIZES = ("sigma", "emittance", "tune_depression")


class ThermalBunch(Train):
    """Thermal equilibrium of a continuous round beam along z in linear focusing, the same in x and y, with its own field.

    The bunch is a piece of it, so the domain should be periodic along z, over the length of the bunch. The density is normal
    without charge, and constant with a sharp edge at zero temperature. Beams in channels that focus x and y differently, or z
    too, have no such equilibrium here.
    """

    distribution: Literal["thermal"] = "thermal"
    gradient: ElectricGradient | None = Field(
        default=None, description="Of the focusing in V/m², as of a constant-focusing element; for beams at rest, too."
    )
    wavenumber: WaveNumber | None = Field(
        default=None, gt=0, description="Of the oscillation without charge, 1/m, in place of the gradient."
    )
    length: Length = Field(gt=0, description="Along z, m: the density is constant there.")
    sigma: Length | None = Field(default=None, gt=0, description="Rms size along x and y, m.")
    emittance: Emittance | None = Field(default=None, ge=0, description="Normalised rms emittance, m rad, for sigma.")
    tune_depression: float | None = Field(
        default=None, ge=0, lt=1, description="k/k0, of the wave numbers with and without charge, for sigma; 0 is cold."
    )
    longitudinal_spread: Momentum | None = Field(
        default=None,
        ge=0,
        description="Standard deviation of the momentum along z, kg m/s. Without it the temperature is the same along z, in "
        "the frame of the beam: one that is much colder along z than across is unstable (Harris).",
    )
    mismatch: float = Field(
        default=1.0, gt=0, description="Factor on places across the beam, and of momenta its inverse; 1 is matched."
    )

    @model_validator(mode="after")
    def _matched(self) -> Self:
        self._check_direction()
        self.require_one("gradient", "wavenumber")
        if self.wavenumber is not None and not any(self.mean_momentum):
            self.refuse(
                "wavenumber",
                "needs a mean momentum, to which it refers",
                "give momentum or velocity, or gradient in place of wavenumber",
            )
        if self.species.charge == 0:
            self.refuse("species", "has no charge, which the focusing acts on", "give another one", found=0.0)
        if self.gradient is not None and self.gradient * self.species.charge <= 0:
            self.refuse(
                "gradient",
                f"does not focus particles of {self.species.charge:g} C",
                "give one of the sign of the charge",
            )
        self.require_one(*SIZES)
        self._check_size()
        return self

    def _check_direction(self) -> None:
        if any(self.mean_momentum[:2]):
            self.refuse(
                next(name for name in ("momentum", "velocity", "direction") if getattr(self, name) is not None),
                "is not along z, where the beam is continuous",
                "give a momentum, velocity or direction along z",
                found=list(self.momentum or self.velocity or self.direction or ()),
            )
        if any(self.momentum_spread):
            self.refuse(
                "momentum_spread",
                "is given although the temperature gives it",
                "leave it out, or give longitudinal_spread",
            )

    def _check_size(self) -> None:
        if self.tune_depression is not None and self._self_force == 0:
            self.refuse("tune_depression", "needs a charge that depresses it", "give sigma or emittance")
        if self.sigma is not None and self._equilibrium[1] < 0:
            cold, _ = matched(self._focusing, self._self_force, emittance=0.0)
            self.refuse(
                "sigma",
                f"is less than {cold:.4g} m, the size of the cold beam of this charge and focusing",
                "enlarge it, or focus more",
            )

    @property
    def _gamma(self) -> float:
        return math.hypot(1.0, *(p / (self.species.mass * SPEED_OF_LIGHT) for p in self.mean_momentum))

    @property
    def _focusing(self) -> float:
        """N/m."""
        if self.gradient is not None:
            return self.species.charge * self.gradient
        assert self.wavenumber is not None
        return self.species.charge * gradient_of(self.wavenumber, self.species, self.mean_momentum)

    @property
    def _self_force(self) -> float:
        """Mean of x F_x of its own field in J, whose magnetic part leaves 1/γ² of it; whatever the size."""
        return self.species.charge * line_gradient(self.bunch_charge / self.length, 1.0, 1.0) / self._gamma**2

    @property
    def _equilibrium(self) -> tuple[float, float]:
        """Rms size, m, and temperature, J."""
        inertia = self._gamma * self.species.mass
        to_emittance = self.species.mass * SPEED_OF_LIGHT / math.sqrt(inertia)
        emittance = None if self.emittance is None else self.emittance * to_emittance
        return matched(
            self._focusing, self._self_force, size=self.sigma, emittance=emittance, depression=self.tune_depression
        )

    @property
    def planes(self) -> tuple[PhasePlane, PhasePlane, PhasePlane]:
        size, temperature = self._equilibrium
        spread = math.sqrt(self._gamma * self.species.mass * max(temperature, 0.0))
        across = PhasePlane(size * self.mismatch, 0.0, spread / self.mismatch)
        along = self._gamma * spread if self.longitudinal_spread is None else self.longitudinal_spread
        return (across, across, PhasePlane(self.length / math.sqrt(12), 0.0, along))

    def unit(self, u: np.ndarray) -> np.ndarray:
        size, temperature = self._equilibrium
        depression = math.sqrt(max(temperature, 0.0) / self._focusing) / size if size > 0 else 1.0
        return distributions.thermal(u, min(depression, 1.0))

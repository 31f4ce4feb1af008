"""What solids are made of. Formulas: native/material, docs/mpm.md."""

from __future__ import annotations

import math
from dataclasses import dataclass

from .. import _native
from ..errors import InputError

MOST_TERMS = 3


def _require(good: bool, message: str) -> None:
    if not good:
        raise InputError(message)


@dataclass(frozen=True)
class Damage:
    """A phase field (AT2): `toughness` G in J/m², `length` ℓ of a crack's profile in m, `residual` stiffness k of the broken.

    InputError unless G and ℓ are positive and k lies between 0 and 1.
    """

    toughness: float
    length: float
    residual: float = 0.01

    def __post_init__(self) -> None:
        _require(
            0 < self.toughness < math.inf, f"toughness is {self.toughness}; give a positive energy per area in J/m²"
        )
        _require(0 < self.length < math.inf, f"the length of damage is {self.length}; give a positive one in m")
        _require(0 < self.residual < 1, f"residual is {self.residual}; give a part of the stiffness between 0 and 1")


@dataclass(frozen=True)
class NeoHookean:
    """`young` E in Pa and `poisson` ν of small strains, and whether it can break.

    ψ = μ/2 (I₁ - 3) - μ ln J + λ/2 ln²J; with `damage` it is split into changes of shape and of volume, which is another energy
    at large strains, also where nothing is damaged. InputError unless E > 0 and -1 < ν < 1/2.
    """

    young: float
    poisson: float
    damage: Damage | None = None

    def __post_init__(self) -> None:
        _require(0 < self.young < math.inf, f"Young's modulus is {self.young}; give a positive one in Pa")
        _require(-1 < self.poisson < 0.5, f"Poisson's ratio is {self.poisson}; give one between -1 and 1/2")

    @property
    def mu(self) -> float:
        """Shear modulus, Pa."""
        return self.young / (2 * (1 + self.poisson))

    @property
    def lame(self) -> float:
        """λ, Pa."""
        return self.young * self.poisson / ((1 + self.poisson) * (1 - 2 * self.poisson))

    def native(self) -> _native.NeoHookean | _native.DamagedNeoHookean:
        """Return the law that kernels take."""
        if self.damage is None:
            return _native.NeoHookean(self.mu, self.lame)
        return _native.DamagedNeoHookean(self.mu, self.lame, self.damage.residual)


@dataclass(frozen=True)
class Ogden:
    """One to three `terms` (μ in Pa, α), and λ in Pa, of principal stretches λᵢ.

    ψ = Σ μ/α (λ₁^α + λ₂^α + λ₃^α - 3) - Σ μ ln J + λ/2 ln²J. InputError for other numbers of terms, an α of zero, or a shear
    modulus of small strains, Σ μ α / 2, that is not positive.
    """

    terms: tuple[tuple[float, float], ...]
    lame: float

    damage = None

    def __post_init__(self) -> None:
        _require(1 <= len(self.terms) <= MOST_TERMS, f"Ogden's law has {len(self.terms)} terms; give 1 to {MOST_TERMS}")
        _require(all(alpha != 0 for _, alpha in self.terms), "Ogden's law has a term with α = 0; leave it out")
        _require(self.mu > 0, f"the shear modulus of Ogden's terms, Σ μ α / 2, is {self.mu} Pa; it must be positive")
        _require(
            math.isfinite(self.lame) and self.lame + 2 / 3 * self.mu > 0,
            f"λ is {self.lame} Pa: with a shear modulus of {self.mu} Pa the bulk modulus is not positive; give more than "
            f"{-2 / 3 * self.mu:g} Pa",
        )

    @property
    def mu(self) -> float:
        """Shear modulus of small strains, Pa."""
        return sum(mu * alpha for mu, alpha in self.terms) / 2

    def native(self) -> _native.Ogden:
        """Return the law that kernels take."""
        return _native.Ogden([(float(mu), float(alpha)) for mu, alpha in self.terms], self.lame)


Material = NeoHookean | Ogden

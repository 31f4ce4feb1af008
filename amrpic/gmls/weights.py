"""Weights of samples by r, their distance from the target over the reach; all vanish beyond r = 1."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

from ..errors import InputError


@dataclass(frozen=True)
class Weight:
    """A function of r that is 1 at the target."""

    code: ClassVar[int]

    def parameters(self) -> tuple[float, float]:
        """Its two numbers, as the native solver takes them."""
        return (0.0, 0.0)


@dataclass(frozen=True)
class Power(Weight):
    """(1 - r^inner)^exponent, whole numbers above zero."""

    exponent: int = 2
    inner: int = 1
    code = 0

    def __post_init__(self) -> None:
        if not all(isinstance(n, int) and 1 <= n <= 20 for n in (self.exponent, self.inner)):
            raise InputError(f"{self} has exponents that are not whole numbers from 1 to 20; use for instance Power(2)")

    def parameters(self) -> tuple[float, float]:
        return (self.exponent, self.inner)


QUADRATIC = Power(2)


@dataclass(frozen=True)
class Gaussian(Weight):
    """exp(-r²/(2 width²)); at the default width what is cut off at the reach is 1 % of the target's weight."""

    width: float = 1 / 3
    code = 1

    def __post_init__(self) -> None:
        if not self.width > 0:
            raise InputError(f"a Gaussian weight has width {self.width}; use a positive one, for instance 1/3")

    def parameters(self) -> tuple[float, float]:
        return (self.width, 0.0)


class CubicSpline(Weight):
    """Hermite's cubic, (1 - r)² (1 + 2 r)."""

    code = 2


class CardinalSpline(Weight):
    """The cardinal cubic B-spline with knots at r = 0, 1/2 and 1."""

    code = 3


class Cosine(Weight):
    """cos(π r / 2)."""

    code = 4


@dataclass(frozen=True)
class Sigmoid(Weight):
    """1/(1 + exp(steepness (2 r^exponent - 1))), over its value at r = 0."""

    steepness: float = 6.0
    exponent: float = 1.0
    code = 5

    def __post_init__(self) -> None:
        if not (self.steepness > 0 and self.exponent > 0):
            raise InputError(f"{self} has a number that is not positive; use for instance Sigmoid(6, 1)")

    def parameters(self) -> tuple[float, float]:
        return (self.steepness, self.exponent)

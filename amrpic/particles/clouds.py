"""The clouds that particles are spread into: their shape, and what becomes of them at coarse-fine faces."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np

from .. import _native

Shape = Literal["nearest-grid-point", "cloud-in-cell", "triangular-shaped-cloud"]

Kernels = Literal["vectors", "kokkos"]

CompensationKind = Literal["none", "clouds", "clouds-and-mesh"]

SHAPES: dict[Shape, _native.Shape] = {
    "nearest-grid-point": _native.Shape.nearest_grid_point,
    "cloud-in-cell": _native.Shape.cloud_in_cell,
    "triangular-shaped-cloud": _native.Shape.triangular,
}

# A cloud multiplies what varies over many cells by 1 + c Σ h²∂², c half its variance per axis; deposit and gather do so once
# each. It is exact for triangular ones, and the mean over the places in a cell for the others.
SMOOTHING: dict[Shape, float] = {
    "nearest-grid-point": 1 / 24,
    "cloud-in-cell": 1 / 12,
    "triangular-shaped-cloud": 1 / 8,
}
# What κ has besides in cubes, over h²/ε₀. With "clouds": for the terms in h⁴ that clouds and the difference of ρ leave.
OF_HIGHER: dict[Shape, float] = {
    "nearest-grid-point": 0.0,
    "cloud-in-cell": 0.0,
    "triangular-shaped-cloud": 0.02,  # from the error of a round bunch with two cells per σ
}
# With "clouds-and-mesh": for what the Laplacian and the difference of φ do to E, 0.05 in the mean over all directions, and
# for all terms in h⁴ together, 0.015, which makes the error of a round bunch least at four cells per σ.
OF_MESH = 0.065
CUBES = 1.001  # largest width over the smallest one of cells that count as cubes


@dataclass(frozen=True)
class Clouds:
    """How particles meet the mesh; deposit, field and gather must use the same, so that no particle pushes itself.

    Own-level clouds are as wide as the cells of their particle's level. Matched ones are as wide as the next coarser cells for
    particles less than two fine cells inside a coarse-fine face, in both deposit and gather: the force of such a particle on
    itself falls from 0.6 to 0.01 of q²/(4πε₀h²), at the price of the coarser resolution there.
    """

    shape: Shape = "cloud-in-cell"
    matched: bool = False
    compensation: CompensationKind = "none"  # what gather takes back of their smoothing: E − κ∇ρ
    kernels: Kernels = (
        "vectors"  # of the processor, or Kokkos' kernels; push in the fields of elements is by vectors always
    )

    def compensated(self, widths: np.ndarray) -> float:
        """Return ε₀κ in m² where cells have these widths (3,), in the frame where the field is electrostatic.

        Clouds add (2c) Σ h²∂²E to the field, which in cubes is 2c h²∇ρ/ε₀. In other cells the narrowest width is taken: what is
        smoothed along the longer axes alone then stays.
        """
        if self.compensation == "none":
            return 0.0
        further = OF_MESH if self.compensation == "clouds-and-mesh" else OF_HIGHER[self.shape]
        return (2 * SMOOTHING[self.shape] + (further if are_cubes(widths) else 0.0)) * float(widths.min()) ** 2

    @property
    def native(self) -> tuple[_native.Shape, bool, bool]:
        """The clouds as the native kernels take them."""
        return SHAPES[self.shape], self.matched, self.kernels == "kokkos"

    @property
    def covered(self) -> Literal["mean", "difference"]:
        """What the electric field must hold in covered cells for the gather."""
        return "difference" if self.matched else "mean"


PLAIN = Clouds()


def are_cubes(widths: np.ndarray) -> bool:
    """Whether cells of these widths (3,) are cubes."""
    return bool(widths.max() <= CUBES * widths.min())


EQUAL_PARTICLES = 140  # per square of the bunch's size in cells, above which own-level clouds are better


def matched_pays(number: float, sizes: np.ndarray) -> bool:
    """Whether matched clouds serve a bunch better: `number` equal particles, rms sizes (3,) in cells of the finest level.

    The force of an own-level particle on itself at a face, against the mean field of the bunch, is about 2.8 (σ/h)²/number;
    below 2 % the coarser resolution of matched clouds costs more than they save. (σ/h)² stands for the cross-section of the
    bunch, so it is the product of its two largest sizes; a bunch counts as at least one cell wide.
    """
    _, middle, largest = np.sort(np.maximum(sizes, 1.0))
    return bool(0 < number <= EQUAL_PARTICLES * middle * largest)


# Particles per cell where a bunch is densest, over the square of its smallest size in cells, from which compensation pays.
PAYING: dict[Shape, float] = {
    "nearest-grid-point": 1.2,
    "cloud-in-cell": 0.8,
    "triangular-shaped-cloud": 0.5,
}


def compensation_pays(number: float, sizes: np.ndarray, shape: Shape) -> bool:
    """Whether compensated clouds serve a bunch better: `number` equal particles, rms sizes (3,) in cells of the finest level.

    What clouds smooth is (h/σ)² of the field. What compensation adds in noise has the wavelengths of cells alone; it is (h/σ)
    of the field over the root of the particles per cell. So they are equal where these are some (σ/h)². The density at its
    peak is that of a normal distribution of these sizes; a bunch counts as at least one cell wide.
    """
    sizes = np.maximum(sizes, 1.0)
    per_cell = number / float((2 * np.pi) ** 1.5 * np.prod(sizes))
    return bool(per_cell > PAYING[shape] * float(sizes.min()) ** 2)

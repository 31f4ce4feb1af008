"""The clouds that particles are spread into: their shape, and what becomes of them at coarse-fine faces."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np

from .. import _native

Shape = Literal["nearest-grid-point", "cloud-in-cell", "triangular-shaped-cloud"]

SHAPES: dict[Shape, _native.Shape] = {
    "nearest-grid-point": _native.Shape.nearest_grid_point,
    "cloud-in-cell": _native.Shape.cloud_in_cell,
    "triangular-shaped-cloud": _native.Shape.triangular,
}


@dataclass(frozen=True)
class Clouds:
    """How particles meet the mesh; deposit, field and gather must use the same, so that no particle pushes itself.

    Own-level clouds are as wide as the cells of their particle's level. Matched ones are as wide as the next coarser cells for
    particles less than two fine cells inside a coarse-fine face, in both deposit and gather: the force of such a particle on
    itself falls from 0.6 to 0.01 of q²/(4πε₀h²), at the price of the coarser resolution there.
    """

    shape: Shape = "cloud-in-cell"
    matched: bool = False

    @property
    def native(self) -> tuple[_native.Shape, bool]:
        """The clouds as the native kernels take them."""
        return SHAPES[self.shape], self.matched

    @property
    def covered(self) -> Literal["mean", "difference"]:
        """What the electric field must hold in covered cells for the gather."""
        return "difference" if self.matched else "mean"


PLAIN = Clouds()

EQUAL_PARTICLES = 140  # per square of the bunch's size in cells, above which own-level clouds are better


def matched_pays(number: float, sizes: np.ndarray) -> bool:
    """Whether matched clouds serve a bunch better: `number` equal particles, rms sizes (3,) in cells of the finest level.

    The force of an own-level particle on itself at a face, against the mean field of the bunch, is about 2.8 (σ/h)²/number;
    below 2 % the coarser resolution of matched clouds costs more than they save. (σ/h)² stands for the cross-section of the
    bunch, so it is the product of its two largest sizes; a bunch counts as at least one cell wide.
    """
    _, middle, largest = np.sort(np.maximum(sizes, 1.0))
    return bool(0 < number <= EQUAL_PARTICLES * middle * largest)

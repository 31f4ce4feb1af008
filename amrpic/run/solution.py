"""What was solved for of the field of particles."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..mesh.field import Field, VectorField
from ..particles.frame import LABORATORY, Frame
from ..stages.poisson import SolveReport
from ..units import SPEED_OF_LIGHT


@dataclass(frozen=True, eq=False)
class Solution:
    """A charge density, and the potential and field that were solved for it."""

    rho: Field  # of the particles, C/m³; without a neutralizing background
    phi: Field  # V
    efield: VectorField  # V/m
    report: SolveReport
    frame: Frame = LABORATORY  # in which the charge rests

    @property
    def bfield(self) -> VectorField:
        """Magnetic field of the charge, β × E / c, T; made anew each time."""
        b = np.array(self.frame.beta) / SPEED_OF_LIGHT
        out = [Field(self.rho.hierarchy, "T") for _ in range(3)]
        for axis in range(3):
            up, down = (axis + 1) % 3, (axis + 2) % 3
            for level in range(self.rho.hierarchy.levels):
                values = out[axis].array(level)
                if b[up] != 0:
                    values += b[up] * self.efield.components[down].array(level)
                if b[down] != 0:
                    values -= b[down] * self.efield.components[up].array(level)
        return VectorField(*out)

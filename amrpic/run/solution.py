"""What was solved for of the field of particles."""

from __future__ import annotations

from dataclasses import dataclass

from ..mesh.field import Field, VectorField
from ..particles.frame import LABORATORY, Frame
from ..stages.poisson import SolveReport


@dataclass(frozen=True, eq=False)
class Solution:
    """A charge density, and the potential and field that were solved for it."""

    rho: Field  # of the particles, C/m³; without a neutralizing background
    phi: Field  # V
    efield: VectorField  # V/m
    report: SolveReport
    frame: Frame = LABORATORY  # in which the charge rests: its magnetic field is β × E / c

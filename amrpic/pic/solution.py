"""What was solved for of the field of particles."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np

from ..mesh.field import Field, VectorField
from ..mesh.hierarchy import Hierarchy
from ..particles.energy_bins import ONE_FRAME, Frames
from ..particles.frame import Frame
from ..space_charge.solvers import Potential
from ..stages.poisson import SolveReport
from ..units import SPEED_OF_LIGHT
from .metal_layer import MetalLayer
from .wall_layer import WallLayer

Part = tuple[Frame, Field, VectorField, SolveReport]  # φ and E of a bin or of its images, solved for in a frame


@dataclass(frozen=True, eq=False)
class Solution:
    """A charge density, and the potential and field that were solved for it: those of all energy bins together.

    What particles feel, and what is shown, are `potential`, `electric` and `bfield`.
    """

    rho: Field  # of the particles, C/m³; without a neutralizing background
    phi: Field  # V; without `walls` and `images`
    efield: VectorField  # V/m; without these
    report: SolveReport  # of the bin that took most cycles
    frames: Frames = ONE_FRAME  # in which the charge of each bin rests
    parts: tuple[Field, ...] = ()  # φ of each bin, if there are more than one, V
    magnetic: VectorField | None = None  # T, if there are more bins than one; without that of `images`
    before: Field | None = None  # φ of the step before on this mesh, where the next solve starts from both, V
    walls: Potential | None = (
        None  # of what walls and electrodes hold, where those above are without: see `Solvers.walls`
    )
    images: Solution | None = None  # of the images of the charge in walls across its motion, which move against it
    # at walls that emit, by the number of their face, and at electrodes, by their name
    layers: Mapping[int | str, WallLayer | MetalLayer] = field(default_factory=dict)

    @cached_property
    def potential(self) -> Field:
        """Potential of the charge, of its images and of what walls hold, V; read-only."""
        if not self._beside:
            return self.phi
        out = self.phi
        for of_others in self._beside:
            out = out + of_others[0]
        out.lock()
        return out

    @cached_property
    def electric(self) -> VectorField:
        """Electric field of the charge, of its images and of what walls hold, V/m; read-only."""
        if not self._beside:
            return self.efield
        out = self.efield
        for of_others in self._beside:
            out = added(out, of_others[1])
        for component in out.components:
            component.lock()
        if self.efield.compensation is not None:
            out.compensate(self.efield.compensation)
        return out

    @property
    def _beside(self) -> list[Potential]:
        """φ and E of what is not the charge itself."""
        of_images = [] if self.images is None else [Potential(self.images.phi, self.images.efield)]
        return of_images if self.walls is None else [self.walls, *of_images]

    @property
    def charges(self) -> dict[str, float]:
        """Charge of each electrode, C."""
        beside = {} if self.walls is None else self.walls.charges
        return {name: charge + beside.get(name, 0.0) for name, charge in self.report.charges.items()}

    @property
    def voltages(self) -> dict[str, float]:
        """Voltage of each electrode, V."""
        beside = {} if self.walls is None else self.walls.voltages
        return {name: volts + beside.get(name, 0.0) for name, volts in self.report.voltages.items()}

    @property
    def guess(self) -> Field:
        """A potential to start the next solve from: the present one, or what it and the one before lead to."""
        if self.before is None:
            return self.phi
        out = self.phi.copy()
        for level in range(out.hierarchy.levels):
            values = out.array(level)
            values *= 2
            values -= self.before.array(level)
        return out

    @property
    def beta(self) -> tuple[float, float, float]:
        """Velocity over c of the charge, if there is one bin: its magnetic field is β × E / c. Else zero: see `magnetic`."""
        only = self.frames.only if self.magnetic is None else None
        return (0.0, 0.0, 0.0) if only is None else only.beta

    @property
    def bfield(self) -> VectorField:
        """Magnetic field of the charge and its images, T; made anew each time unless `magnetic` is all of it."""
        out = self.magnetic
        if out is None:
            out = zeros(self.rho.hierarchy, "T")
            add_magnetic(out, self.efield, self.beta)
        return out if self.images is None else added(out, self.images.bfield)


def superposed(
    rho: Field,
    parts: Sequence[Part],
    frames: Frames,
    walls: Potential | None = None,
) -> Solution:
    """Return the sum of what was solved for each bin, beside the field of what walls hold."""
    hierarchy = rho.hierarchy
    phi, electric, magnetic = Field(hierarchy, "V"), zeros(hierarchy, "V/m"), zeros(hierarchy, "T")
    phi.holds = parts[0][1].holds
    for frame, part, efield, _ in parts:
        _add(phi, 1.0, part)
        efield = efield.with_components()
        for total, component in zip(electric.components, efield.components, strict=True):
            _add(total, 1.0, component)
        add_magnetic(magnetic, efield, frame.beta)
    reports = [of_part[3] for of_part in parts]
    report = max(reports, key=lambda report: report.cycles)
    charges = {name: sum(part.charges[name] for part in reports) for name in report.charges}
    report = replace(report, charges=charges)
    return Solution(rho, phi, electric, report, frames, tuple(of_part[1] for of_part in parts), magnetic, walls=walls)


def added(first: VectorField, second: VectorField) -> VectorField:
    """Return the sum of two fields."""
    pairs = (field.with_components().components for field in (first, second))
    return VectorField(*(a + b for a, b in zip(*pairs, strict=True)))


def zeros(hierarchy: Hierarchy, unit: str) -> VectorField:
    """Return a field of zeros."""
    x, y, z = (Field(hierarchy, unit) for _ in range(3))
    return VectorField(x, y, z)


def add_magnetic(to: VectorField, efield: VectorField, beta: Sequence[float]) -> None:
    """Add the magnetic field β × E / c of charge that moves with β c."""
    b = np.array(beta) / SPEED_OF_LIGHT
    for axis in range(3):
        up, down = (axis + 1) % 3, (axis + 2) % 3
        if b[up] != 0:
            _add(to.components[axis], b[up], efield.components[down])
        if b[down] != 0:
            _add(to.components[axis], -b[down], efield.components[up])


def _add(to: Field, times: float, field: Field) -> None:
    for level in range(field.hierarchy.levels):
        to.array(level)[...] += times * field.array(level)

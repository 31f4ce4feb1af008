"""The layer in front of an electrode that emits: the field at its surface, and along the normal.

Cells that metal cuts have neither. Two and a half cells in front of it the mesh has both field and charge; below, the normal
field in the column of each patch follows from Gauss's law, from the charge in it and the widening of its cross-section.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..conductors.patches import Patches
from ..mesh.field import Field, VectorField
from ..particles.clouds import Clouds
from ..particles.particles import Particles
from ..stages.gather import gather
from ..units import VACUUM_PERMITTIVITY

HEIGHT = 2.5  # cells of a column: half a cell below its top no cell beside the place is cut
BINS = 24  # of a column in which charge is summed, cubic since particles start at rest
EDGES = (np.arange(BINS + 1) / BINS) ** 3


@dataclass(frozen=True, eq=False)
class MetalLayer:
    """The normal field in the columns in front of an electrode."""

    patches: Patches
    below: np.ndarray  # (n, BINS + 1) C, charge in a column below the edges of its bins
    at_wall: np.ndarray  # (n,) V/m, out of the metal
    electric: VectorField  # of the mesh

    @classmethod
    def of(cls, patches: Patches, phi: Field | None, electric: VectorField, particles: Particles) -> MetalLayer:
        """Return the layer in a field with these particles; `phi`: of charge at rest, whose field it gives. Collective."""
        height = HEIGHT * patches.width
        chosen, patch, above = patches.find(particles.position, height)
        charge = (particles.weight * particles.charge)[chosen]
        own_sums = np.bincount(patch * BINS + _bin(above / height), charge, len(patches) * BINS)
        sums = electric.hierarchy.comm.allreduce(own_sums).reshape(-1, BINS)
        below = np.concatenate([np.zeros((len(patches), 1)), np.cumsum(sums, axis=1)], axis=1)
        top = patches.widening(patches.emitting, np.full(len(patches), height)) * _normal(
            patches, phi, electric, height
        )
        at_wall = np.nan_to_num(top - below[:, -1] / (VACUUM_PERMITTIVITY * patches.area))
        return cls(patches, below, at_wall, electric)

    def correct(self, electric: np.ndarray, particles: Particles, clouds: Clouds) -> None:
        """Add to fields at particles (n, 3), V/m, what Gauss's law in columns has beyond the mesh's along the normal.

        Collective.
        """
        height = HEIGHT * self.patches.width
        chosen, patch, above = self.patches.find(particles.position, height)
        part = above / height
        bin = _bin(part)
        low, high = EDGES[bin], EDGES[bin + 1]
        below, over = self.below[patch, bin], self.below[patch, bin + 1]
        charge = below + (over - below) * (part - low) / (high - low)
        within = self.at_wall[patch] + charge / (VACUUM_PERMITTIVITY * self.patches.area[patch])
        within /= self.patches.widening(patch, above)
        order = np.argsort(chosen)
        normal = self.patches.normal[patch[order]]
        gathered = (gather(self.electric, particles.ascending(chosen[order]), clouds) * normal).sum(axis=1)
        electric[chosen[order]] += (within[order] - gathered)[:, None] * normal


def _normal(patches: Patches, phi: Field | None, electric: VectorField, height: float) -> np.ndarray:
    """Return the normal field (n,) at a height in m in front of patches, V/m. Collective."""
    if phi is None:
        places = patches.centre + height * patches.normal
        parts = [of.sample(places) * n for of, n in zip(electric.components, patches.normal.T, strict=True)]
        return np.sum(parts, axis=0)
    high, low = (phi.sample(patches.centre + (height + step * patches.width) * patches.normal) for step in (0.5, -0.5))
    return np.asarray(low - high) / patches.width


def _bin(part: np.ndarray) -> np.ndarray:
    return np.minimum((np.cbrt(part) * BINS).astype(np.int64), BINS - 1)

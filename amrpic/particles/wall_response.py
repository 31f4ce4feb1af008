"""What a mesh smears of the field at a wall, where charge lies in front of it in less than a cell.

There the field that a charge takes from the wall is local: σ/ε₀ at its own place. A mesh has the charge in the middle of cells,
and in clouds, so that it takes a part of the field of faces around. It matters at the rim of a spot alone: where charge is
even, the sum is right.
"""

from __future__ import annotations

import numpy as np
import scipy

from ..mesh.columns import Columns
from ..units import VACUUM_PERMITTIVITY
from .clouds import Shape

SPLINE = {"nearest-grid-point": 0.0, "cloud-in-cell": 1 / 8, "triangular-shaped-cloud": 1 / 6}


class WallResponse:
    """How far the field at a wall is smeared, for columns behind it and clouds of a shape."""

    def __init__(self, columns: Columns, shape: Shape) -> None:
        self.columns = columns
        domain, width = columns.hierarchy.domain, columns.hierarchy.spacing(0)
        squares = [(width[columns.axis] / width[axis]) ** 2 for axis in columns.across]
        self._rasters = []
        for level in np.unique(columns.level):
            cells = np.array(domain.cells)[columns.across] * 2**level
            padded = [n if domain.periodic[axis] else 2 * n for n, axis in zip(cells, columns.across, strict=True)]
            own = columns.level == level
            places = columns.places_on(level)
            self._rasters.append((own, places, padded, symbol(padded, squares, shape)))

    def missing(self, near: np.ndarray) -> np.ndarray:
        """Return what the field of the mesh at the wall lacks, V/m into the domain, (n,), of charge C/m² (n,) close to it."""
        smeared = np.zeros(len(near))
        for own, (x, y), shape, response in self._rasters:
            raster = np.zeros(shape)
            raster[x[own], y[own]] = near[own]
            smeared += scipy.fft.irfft2(scipy.fft.rfft2(raster) * response, shape)[x, y]
        return (smeared - near) / VACUUM_PERMITTIVITY


def symbol(cells: list[int], squares: list[float], shape: Shape) -> np.ndarray:
    """Return which part of a wave of charge in the first cells the faces of a periodic wall take, as for a real transform.

    From the discrete equation on a half-space, whose wall row has the ghost 8/3 φ_w - 2 φ₀ + φ₁/3: with φ_j = φ₀ λ^j the flux
    of the wall over the charge is (3 - λ/3) / (4 + κ - 4λ/3), κ by the `squares` of widths along the normal over those across.
    """
    turns = 2 * np.pi * np.fft.fftfreq(cells[0])[:, None], 2 * np.pi * np.fft.rfftfreq(cells[1])
    kappa = sum(square * (2 - 2 * np.cos(turn)) for square, turn in zip(squares, turns, strict=True))
    decay = 1 + kappa / 2 - np.sqrt(kappa + kappa**2 / 4)
    clouds = [1 - 2 * SPLINE[shape] * (1 - np.cos(turn)) for turn in turns]
    return (3 - decay / 3) / (4 + kappa - 4 * decay / 3) * clouds[0] * clouds[1]

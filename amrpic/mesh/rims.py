"""How Dirichlet walls go on beyond open faces: at a constant potential, that of their rim."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from .domain import Domain
from .field import Function

MOST = 64  # places along an axis where data are looked at


class Rim(NamedTuple):
    """What a wall has where it meets open faces; on all of its face if it meets none."""

    potential: float  # V: the mean
    jump: float  # largest difference of the data from it there, over that on the face; 0 without open faces to meet


def rims_of(domain: Domain, potential: Function) -> dict[tuple[int, int], Rim]:
    """Return the rims of the Dirichlet faces (axis, side) of a domain with open faces, {} without any.

    `potential(x, y, z)` gives V for arrays (n,) of centres of base cells' faces in m.
    """
    if not any("open" in pair for pair in domain.boundary):
        return {}
    faces = [face for face in np.ndindex(3, 2) if domain.boundary[face[0]][face[1]] == "dirichlet"]
    return {(axis, side): _rim(domain, potential, axis, side) for axis, side in faces}


def _rim(domain: Domain, potential: Function, axis: int, side: int) -> Rim:
    across = [d for d in range(3) if d != axis]
    places = []
    for d in range(3):
        cells = np.unique(np.linspace(0, domain.cells[d] - 1, min(domain.cells[d], MOST)).astype(int))
        centres = domain.lower[d] + (cells + 0.5) * domain.spacing[d]
        places.append(centres if d != axis else np.array([(domain.lower, domain.upper)[side][axis]]))
    grid = np.meshgrid(*places, indexing="ij")
    values = np.broadcast_to(potential(*(x.ravel() for x in grid)), grid[0].size).reshape(grid[0].shape).squeeze(axis)
    ends = [values.take(-end, n) for n, d in enumerate(across) for end in (0, 1) if domain.boundary[d][end] == "open"]
    rim = np.concatenate(ends) if ends else values.ravel()
    mean = rim[0] + np.mean(rim - rim[0])  # of a constant this very one
    largest = np.abs(values - mean).max()
    return Rim(float(mean), float(np.abs(rim - mean).max() / largest) if ends and largest > 0 else 0.0)

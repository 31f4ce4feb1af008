"""Which elements points fill, so that their volumes may be scaled to the element's."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from .. import _native
from .hexahedra import Mesh

WITHIN, AROUND = 0.05, 0.1  # volumes in a full element, or those about it, add up to the space there so nearly
WALLS = ((False, False),) * 3  # no face of the mesh is free


def full_elements(
    mesh: Mesh,
    element: np.ndarray,
    reference: np.ndarray,
    volume: np.ndarray,
    rough: np.ndarray | None = None,
    free: ArrayLike = WALLS,
) -> np.ndarray:
    """Return which of this rank's elements are full, (elements,). Collective.

    These and their 26 neighbours hold points, and volumes add up to the space: to `WITHIN` in the element, or to `AROUND` about
    it, if no element there is `rough` (elements,). Those in the element alone say little: where one row of k crosses a face,
    they change by 1/k. Beyond the mesh there is a wall, which counts as filled, or, where a face is `free` (3, 2), nothing.

    Volumes about an element are those at its eight corners, shared by the functions of degree 1, over what these would have:
    rows of two or more in an element leave their mean as it is, wherever they lie. A gap that it does not see, half an element
    by itself, is less than a tenth of what is around.
    """
    count = len(mesh.elements)
    corners = mesh.native if mesh.degree == 1 else _native.FemLattice(mesh.hierarchy.native, 1)
    own = np.arange(count, dtype=np.int32)
    centres = _native.FemPoints(corners, own, np.zeros((count, 3)), np.ones(count), gauss=False)
    points = _native.FemPoints(corners, element.astype(np.int32, copy=False), reference, volume, gauss=False)
    within = np.bincount(element, volume, count) / mesh.element_volume

    def at_corners(values: np.ndarray) -> np.ndarray:
        return centres.integrals(1, values.astype(np.float64))

    def about(values: np.ndarray) -> np.ndarray:
        return centres.values(1, values)

    space, empty = at_corners(np.ones(count)), at_corners(within == 0)
    at = corners.nodes()
    for axis, pair in enumerate(np.asarray(free)):
        for face, is_free in zip((0, mesh.domain.cells[axis]), pair, strict=True):
            empty[at[:, axis] == face] += is_free
    filled = points.integrals(1, np.ones(len(element))) / (mesh.element_volume * space)
    fills = np.abs(about(filled) - 1) <= AROUND
    if rough is not None:
        fills &= about(at_corners(rough)) == 0
    return (fills | (np.abs(within - 1) <= WITHIN)) & (about(empty) == 0)

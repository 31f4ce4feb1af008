"""From one mesh to the next: points move with the displacement and take along what they carry."""

from __future__ import annotations

import numpy as np

from ..errors import InputError
from ..fem import Mesh, given
from ..fem.points import Weights
from ..parallel import raise_together
from .solid import Solid

AT_FACE = 1e-9  # parts of a mesh's size: so far outside points may be, by rounding and the solver's tolerance


def carried(solid: Solid, u: np.ndarray, mesh: Mesh, *, weights: Weights = "moments") -> Solid:
    """Return the solid after a displacement, (nodes, 3) in m, on a mesh that has none. Collective.

    Points move by u and have F and volumes from there on; damage and driving energy stay. Each rank sees all points, so
    they must fit one. InputError on all ranks for points that are outside the mesh.
    """
    states, points = solid.states(u), solid.points
    lower, upper = np.array(mesh.domain.lower), np.array(mesh.domain.upper)
    place = points.position + points.values(u)
    clipped = np.clip(place, lower, upper)
    out = np.abs(place - clipped).max(axis=1, initial=0.0) > AT_FACE * float((upper - lower).max())
    first = int(np.argmax(out)) if out.any() else 0
    raise_together(
        mesh.comm,
        f"point {int(points.number[first])} has left the mesh to {place[first]} m" if out.any() else None,
        InputError,
    )
    volume = points.volume * states.j / solid.j
    all_of = [
        np.concatenate(solid.mesh.comm.allgather(a))
        for a in (clipped, volume, states.deformation, solid.material, solid.damage, solid.driving)
    ]
    places, volumes, deformation, material, damage, driving = all_of
    there = given(mesh, places, volumes, weights)
    own = there.number
    return Solid(
        there,
        solid.materials,
        material[own],
        deformation=deformation[own],
        damage=damage[own],
        driving=driving[own],
    )

"""What files of a state show: values of points, and their means over elements."""

from __future__ import annotations

import numpy as np

from ..mesh.field import Field
from .scene import Scene
from .state import LoadState

STRESSES = {
    "stress_xx": (0, 0),
    "stress_yy": (1, 1),
    "stress_zz": (2, 2),
    "stress_yz": (1, 2),
    "stress_xz": (0, 2),
    "stress_xy": (0, 1),
}


def cauchy_of(state: LoadState) -> np.ndarray:
    """Return Cauchy's stress at this rank's points, (n, 3, 3) in Pa. Collective."""
    solid = state.placed.solid
    at_rest = np.zeros((len(state.placed.mesh.node_indices), 3))
    return solid.states(at_rest).cauchy[state.placed.body]


def point_values(state: LoadState) -> tuple[dict[str, np.ndarray], dict[str, str]]:
    """Return what files of points hold besides their places, by names, and the units of these. Collective."""
    points = state.placed.points
    values = {
        "id": points.id,
        "material": points.material,
        "F": points.deformation.reshape(-1, 9),
        "J": points.j,
        "stress": cauchy_of(state).reshape(-1, 9),
        "damage": points.damage,
        "volume": points.volume,
    }
    return values, {"stress": "Pa", "volume": "m^3"}


def element_means(state: LoadState, scene: Scene) -> dict[str, Field]:
    """Return means over the elements, weighted by volumes, by names; zero where there are no points. Collective.

    `filled` is the share of the element's volume that points have, `material` the number of the material that has most of it,
    -1 for none, `pressure` a third of minus the trace of Cauchy's stress, `mises` von Mises's stress of the mean.
    """
    placed = state.placed
    points, mesh, element = placed.points, placed.mesh, placed.weighed.element
    count, volume = len(mesh.elements), placed.points.volume
    whole = np.bincount(element, volume, count)

    def mean(values: np.ndarray) -> np.ndarray:
        return np.bincount(element, volume * values, count) / np.where(whole > 0, whole, 1)

    stress = cauchy_of(state)
    means = {name: mean(stress[:, i, j]) for name, (i, j) in STRESSES.items()}
    xx, yy, zz, yz, xz, xy = means.values()
    shares = np.stack([mean((points.material == number).astype(float)) for number in range(len(scene.materials))])
    fields = {
        "material": np.where(whole > 0, shares.argmax(axis=0), -1).astype(float),
        "filled": whole / mesh.element_volume,
        "J": mean(points.j),
        "damage": mean(points.damage),
        "pressure": -(xx + yy + zz) / 3,
        "mises": np.sqrt(((xx - yy) ** 2 + (yy - zz) ** 2 + (zz - xx) ** 2) / 2 + 3 * (yz**2 + xz**2 + xy**2)),
        **means,
        **{f"share_{name}": share for name, share in zip(scene.materials, shares, strict=True)},
    }
    out = {}
    for name, values in fields.items():
        pascals = name in ("pressure", "mises", *STRESSES)
        out[name] = Field(mesh.hierarchy, "Pa" if pascals else "")
        out[name].array(0)[:] = values
    return out

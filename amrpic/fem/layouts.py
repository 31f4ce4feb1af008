"""Where points lie: the same in every element, at random, or where they are given.

Random places follow from the seed and the number of the point alone, so that they do not depend on ranks or boxes.
"""

from __future__ import annotations

import operator

import numpy as np
from numpy.typing import ArrayLike

from .. import _native
from ..errors import InputError
from ..parallel import raise_together, together
from .hexahedra import Mesh
from .points import Points, Weights, reals, require_weights

STREAM = 26  # of random numbers, apart from those of particles
MOST_PER_AXIS = 32


def gauss(mesh: Mesh, per_axis: int | None = None) -> Points:
    """Return Gauss's points with his weights, degree + 1 along each axis of an element if not said otherwise. Collective.

    Operators at degree + 1 points are applied axis by axis, many times as fast as at points anywhere. InputError on all ranks
    for no number of points.
    """
    count = mesh.degree + 1 if per_axis is None else _checked(mesh, per_axis)
    place, weight = _native.fem_gauss_rule(count)
    volume = mesh.element_volume * np.einsum("k,j,i->kji", *[weight / 2] * 3).ravel()
    return _everywhere(mesh, _tensor(place), "volume", volume, count)


def uniform(mesh: Mesh, per_axis: int, weights: Weights = "moments") -> Points:
    """Return points in the middle of each of per_axis³ equal parts of every element. Collective.

    InputError on all ranks for weights that do not exist, or no number of parts.
    """
    count = _checked(mesh, per_axis, weights)
    return _everywhere(mesh, _tensor((2 * np.arange(count) + 1) / count - 1), weights)


def jittered(mesh: Mesh, per_axis: int, seed: int = 1, weights: Weights = "moments") -> Points:
    """Return one random point in each of per_axis³ equal parts of every element. Collective.

    InputError on all ranks for weights that do not exist, or no number of parts.
    """
    count = _checked(mesh, per_axis, weights, seed)
    part = _tensor(np.arange(count)) + _drawn(mesh, count**3, seed)
    return _everywhere(mesh, 2 * part / count - 1, weights)


def random(mesh: Mesh, per_axis: int, seed: int = 1, weights: Weights = "moments") -> Points:
    """Return per_axis³ points anywhere in every element. Collective.

    InputError on all ranks for weights that do not exist, or no number of points.
    """
    count = _checked(mesh, per_axis, weights, seed)
    return _everywhere(mesh, 2 * _drawn(mesh, count**3, seed) - 1, weights)


def given(mesh: Mesh, position: ArrayLike, volume: ArrayLike | None = None, weights: Weights = "moments") -> Points:
    """Return points at positions (n, 3) in m; all ranks give all of them, and keep those of their elements. Collective.

    Without volumes (n,) in m³ those of an element share it equally. Points on faces between elements belong to the upper one,
    on the upper faces of the mesh to the last. InputError on all ranks for points outside the mesh or volumes that are not
    positive.
    """
    with together(mesh.comm, InputError):
        require_weights(weights)
        places, volumes = _places(mesh, position), None
        if volume is not None:
            volumes = reals(volume, "volume", f"({len(places)},) in m³")
            if volumes.shape != (len(places),):
                raise InputError(f"volume has shape {volumes.shape} for {len(places)} points; give one for each")
            if not (good := np.isfinite(volumes) & (volumes > 0)).all():
                first = int(np.argmin(good))
                raise InputError(f"the volume of point {first} is {volumes[first]}; give a positive one in m³")
    elements, reference = mesh.native.locate(places)
    number = np.flatnonzero(elements >= 0)
    count = mesh.comm.allreduce(len(number))
    raise_together(
        mesh.comm,
        f"ranks gave different points: {count} are kept of {len(places)}; give all of them on all ranks"
        if count != len(places)
        else None,
        InputError,
    )
    number = number[np.argsort(elements[number], kind="stable")]
    element = elements[number]
    if volumes is None:
        per_element = np.bincount(element, minlength=len(mesh.elements))
        own = mesh.element_volume / per_element[element]
    else:
        own = volumes[number]
    return Points(mesh, element, reference[number], own, number, weights)


def _checked(mesh: Mesh, per_axis: int, weights: str = "volume", seed: int = 0) -> int:
    with together(mesh.comm, InputError):
        require_weights(weights)
        try:
            count, _ = operator.index(per_axis), operator.index(seed)
        except TypeError:
            raise InputError(f"per_axis is {per_axis!r} and seed {seed!r}; give whole numbers") from None
        if not 1 <= count <= MOST_PER_AXIS:
            raise InputError(f"per_axis is {count}; give 1 to {MOST_PER_AXIS} points along each axis")
        if not 0 <= seed < 2**64:
            raise InputError(f"seed is {seed}; give a number from 0 to 2^64 - 1")
    return count


def _places(mesh: Mesh, position: ArrayLike) -> np.ndarray:
    places = reals(position, "position", "(n, 3) in m")
    if places.ndim != 2 or places.shape[1] != 3:
        raise InputError(f"position has shape {places.shape}; give (n, 3) in m")
    inside = ((places >= mesh.domain.lower) & (places <= mesh.domain.upper)).all(axis=1)
    if not inside.all():
        first = int(np.argmin(inside))
        at = ", ".join(f"{x:g}" for x in places[first])
        raise InputError(
            f"point {first} at ({at}) m lies outside the mesh, as {int((~inside).sum())} of {len(places)} do; leave them out "
            "or enlarge the mesh"
        )
    return places


def _tensor(along: np.ndarray) -> np.ndarray:
    """Places (n³, 3) with these coordinates along each axis, x fastest."""
    z, y, x = np.meshgrid(along, along, along, indexing="ij")
    return np.stack([x.ravel(), y.ravel(), z.ravel()], axis=1)


def _numbers(mesh: Mesh, count: int) -> np.ndarray:
    """Number of each point where every element of the mesh has so many, (elements, count)."""
    element = np.ravel_multi_index(tuple(mesh.elements.T), mesh.domain.cells, order="F")
    return element[:, None] * count + np.arange(count)


def _drawn(mesh: Mesh, count: int, seed: int) -> np.ndarray:
    """Random numbers (elements, count, 3) in (0, 1)."""
    number = _numbers(mesh, count).ravel()
    out = np.empty((4, len(number)))
    _native.uniforms(seed, STREAM, 0, number, out)
    return out[:3].T.reshape(-1, count, 3)


def _everywhere(
    mesh: Mesh, places: np.ndarray, weights: Weights, volume: np.ndarray | None = None, gauss: int = 0
) -> Points:
    """Points in every element at places (n, 3), or (elements, n, 3) of their own; without volumes (n,) in m³, of equal ones."""
    elements, count = len(mesh.elements), places.shape[-2]
    element = np.repeat(np.arange(elements), count)
    reference = np.broadcast_to(places, (elements, count, 3)).reshape(-1, 3)
    volumes = np.broadcast_to(mesh.element_volume / count if volume is None else volume, (elements, count)).ravel()
    return Points(mesh, element, reference, volumes, _numbers(mesh, count).ravel(), weights, gauss)

"""Integration points of a mesh, sorted by element, with their weights."""

from __future__ import annotations

from collections.abc import Callable
from typing import Literal, get_args

import numpy as np
from numpy.typing import ArrayLike

from .. import _native
from ..errors import InputError
from ..parallel import together
from .full import WALLS, full_elements
from .hexahedra import Mesh

Weights = Literal["moments", "volume"]
COMPONENTS = (1, 3)
HIGHEST_DEGREE = 63  # that any weights are exact to: of Gauss's rule with the most points


class Points:
    """This rank's integration points: those of its elements, sorted by element. Made by `fem.jittered` and the like.

    Arrays have an entry for each point: `number` (n,) is that of the point among those of all ranks; `element` (n,), its place
    in `mesh.elements`, `volume` and `weight` (n,) in m³, `reference`, `position` (n, 3) are made when they are asked for.
    `held` (elements,): how many points elements have.

    `exact_to` (elements,) is the highest m to which an element's weights integrate all products x^i y^j z^k, i, j, k ≤ m,
    exactly; -1 where the weights are the volumes: because they are to be, or because it is not full (`full_elements`; `free`:
    faces of the mesh that are no walls). `rough`: elements (elements,) that keep volumes in any case. `volume` may be what
    returns them when they are asked for. `gauss`: they are so many of Gauss's points along each axis of all elements, x
    fastest, and have his weights. `weight`: those that they have instead. Collective to make.
    """

    def __init__(
        self,
        mesh: Mesh,
        element: np.ndarray,
        reference: np.ndarray,
        volume: np.ndarray | Callable[[], np.ndarray],
        number: np.ndarray,
        weights: Weights = "moments",
        gauss: int = 0,
        weight: np.ndarray | None = None,
        rough: np.ndarray | None = None,
        free: ArrayLike = WALLS,
    ) -> None:
        self.mesh = mesh
        self.held = np.bincount(element, minlength=len(mesh.elements))
        self._volume, self.number = volume, number
        self.exact_to = np.full(len(mesh.elements), 2 * gauss - 1 if gauss else -1, dtype=np.int32)
        places = np.ascontiguousarray(reference, dtype=np.float64)
        if weight is None:
            weight = self.volume
            if weights == "moments" and not gauss:
                full = full_elements(mesh, element, places, weight, rough, free)
                weight = self._fit(places, weight, full if rough is None else full & ~rough)
        self.native = _native.FemPoints(
            mesh.native,
            np.ascontiguousarray(element, dtype=np.int32),
            places,
            np.ascontiguousarray(weight),
            gauss == mesh.degree + 1,
        )

    def _fit(self, places: np.ndarray, volume: np.ndarray, full: np.ndarray) -> np.ndarray:
        """The weights of points: in elements that are full, those exact to the highest degree there is. Local."""
        first = np.concatenate([[0], np.cumsum(self.held)]).astype(np.int64)
        weight, self.exact_to = _native.fem_fit_moments(
            first, places, volume, full, self.mesh.element_volume, 2 * self.mesh.degree - 1
        )
        return weight

    def __len__(self) -> int:
        return len(self.number)

    @property
    def element(self) -> np.ndarray:
        """Elements of the points, (n,) int32, ascending."""
        return np.repeat(np.arange(len(self.held), dtype=np.int32), self.held)

    @property
    def volume(self) -> np.ndarray:
        """Volumes of the points, (n,) in m³."""
        volume = self._volume
        return np.ascontiguousarray(volume() if callable(volume) else volume, dtype=np.float64)

    @property
    def reference(self) -> np.ndarray:
        """Where the points lie in their elements, (n, 3) from -1 to 1."""
        return self.native.reference()

    @property
    def weight(self) -> np.ndarray:
        """Weights of the points, (n,) in m³."""
        return self.native.weight()

    @property
    def position(self) -> np.ndarray:
        """Places of the points, (n, 3) in m."""
        out = self.reference
        out += 1
        out /= 2
        for d in range(3):
            out[:, d] += self.mesh.elements[:, d][self.element]
        out *= self.mesh.spacing
        out += np.array(self.mesh.domain.lower)
        return out

    def exactness(self) -> dict[int, int]:
        """Return how many elements of all ranks have each value of `exact_to`, the lowest first. Collective."""
        counts = self.mesh.comm.allreduce(np.bincount(self.exact_to + 1, minlength=HIGHEST_DEGREE + 2))
        return {int(degree) - 1: int(counts[degree]) for degree in np.flatnonzero(counts)}

    def values(self, u: ArrayLike) -> np.ndarray:
        """Return a vector of the mesh at the points: (n,), or (n, 3) of three components. Collective.

        InputError on all ranks for an array of another shape.
        """
        vector, components = checked_vector(self.mesh, u, "the vector")
        return shaped(self.native.values(components, vector), components)

    def slopes(self, u: ArrayLike) -> np.ndarray:
        """Return the gradient of a vector of the mesh at the points: (n, 3), or (n, 3, 3), ∂u_i/∂x_j, in 1/m. Collective.

        InputError on all ranks for an array of another shape.
        """
        vector, components = checked_vector(self.mesh, u, "the vector")
        slopes = self.native.slopes(components, vector)
        return slopes.reshape(-1, 3) if components == 1 else slopes.reshape(-1, 3, 3)

    def integrate(self, values: ArrayLike) -> np.ndarray:
        """Return the integrals of values at the points, (n,) or (n, 3), times each node's function: a vector. Collective.

        InputError on all ranks for an array of another shape.
        """
        with together(self.mesh.comm, InputError):
            array = numbers(values, len(self), "the array of values at points")
        components = _components(array)
        return shaped(self.native.integrals(components, array.reshape(-1)), components)


def reals(values: ArrayLike, name: str, shape: str) -> np.ndarray:
    """Return values as a contiguous array of any shape. InputError if they are no real numbers. Local."""
    try:
        array = np.asarray(values)
        if np.iscomplexobj(array):
            raise TypeError
        return np.asarray(array, dtype=np.float64, order="C")
    except (TypeError, ValueError):
        raise InputError(f"{name} is no array of real numbers; give {shape}") from None


def mask_of(fixed: ArrayLike, count: int, components: int, shapes: str) -> np.ndarray:
    """Return which unknowns are fixed, (count, components). InputError for no mask of nodes or of unknowns. Local."""
    try:
        mask = np.asarray(fixed)
    except ValueError:
        raise InputError(f"fixed is no array; give a mask {shapes}") from None
    if mask.dtype != bool or mask.shape not in ((count,), (count, components)):
        raise InputError(f"fixed is of {mask.dtype} with shape {mask.shape} on a rank; give a mask {shapes}")
    return np.ascontiguousarray(np.broadcast_to(mask if mask.ndim == 2 else mask[:, None], (count, components)))


def held_of(values: ArrayLike | float, shape: tuple[int, ...]) -> np.ndarray:
    """Return the values of fixed unknowns, of that shape, to be read. InputError for what does not fit. Local."""
    try:
        return np.broadcast_to(reals(values, "values", f"a number or an array {shape} on this rank"), shape)
    except ValueError:
        raise InputError(f"values do not fit nodes; give a number or an array {shape} on this rank") from None


def numbers(values: ArrayLike, count: int, name: str) -> np.ndarray:
    """Return values as a contiguous array (count,) or (count, 3). InputError if they are something else. Local."""
    array = reals(values, name, f"({count},) or ({count}, 3)")
    if array.shape not in ((count,), (count, 3)):
        raise InputError(f"{name} has shape {array.shape} on a rank; give ({count},) or ({count}, 3) there")
    return array


def _components(array: np.ndarray) -> int:
    return 1 if array.ndim == 1 else array.shape[1]


def checked_vector(mesh: Mesh, u: ArrayLike, name: str, components: int | None = None) -> tuple[np.ndarray, int]:
    """Return a vector of the mesh with its components side by side, and their number. Collective.

    InputError on all ranks if it is something else, or has other components than there must be.
    """
    with together(mesh.comm, InputError):
        array = numbers(u, len(mesh.node_indices), name)
        if components is not None and _components(array) != components:
            raise InputError(f"{name} has {_components(array)} components; the operator has {components}")
    return array.reshape(-1), _components(array)


def shaped(values: np.ndarray, components: int) -> np.ndarray:
    """Return values of nodes or points, a row each if they have components."""
    return values if components == 1 else values.reshape(-1, components)


def require_weights(weights: str) -> None:
    """Raise InputError unless there are such weights. Local."""
    if not isinstance(weights, str) or weights not in get_args(Weights):
        raise InputError(f'weights are "{weights}"; use {" or ".join(get_args(Weights))}')

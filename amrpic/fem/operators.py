"""Operators whose integrals are sums over points, without matrices."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import scipy
from numpy.typing import ArrayLike

from .. import _native
from ..errors import InputError
from ..mpi import MPI
from ..parallel import together
from .points import COMPONENTS, Points, checked_vector, shaped


class Operator:
    """A symmetric operator on vectors of a mesh: `v = operator @ u`. `Mass` and `Poisson` are its kinds. Collective to make.

    InputError on all ranks unless it has 1 or 3 components.
    """

    _made: Callable[[_native.FemPoints, int], _native.FemOperator]

    def __init__(self, points: Points, components: int = 1) -> None:
        with together(points.mesh.comm, InputError):
            if np.ndim(components) > 0 or components not in COMPONENTS:
                raise InputError(f"components are {components!r}; an operator has 1 or 3")
        self.points, self.mesh, self.components = points, points.mesh, int(components)
        self.native = self._made(points.native, self.components)

    def __matmul__(self, u: ArrayLike) -> np.ndarray:
        """Return the operator times a vector, (nodes,), or (nodes, 3) if it has three components. Collective.

        InputError on all ranks for an array of another shape.
        """
        vector, _ = checked_vector(self.mesh, u, "the vector", self.components)
        return shaped(self.native.apply(vector), self.components)

    def diagonal(self) -> np.ndarray:
        """Return the diagonal as a vector, exactly and without products with unit vectors. Collective."""
        return shaped(self.native.diagonal(), self.components)

    def to_scipy(self) -> scipy.sparse.csr_array | None:
        """Return the matrix on rank 0, and None on others. Collective.

        Its rows are the unknowns of all ranks, rank after rank, in the order of vectors with components side by side.
        """
        row, column, value = (_gathered(self.mesh.comm, entries) for entries in self.native.entries())
        if self.mesh.comm.rank > 0:
            return None
        size = int(self.mesh.node_counts.prod()) * self.components
        return scipy.sparse.csr_array((value, (row, column)), shape=(size, size))


def _gathered(comm: MPI.Intracomm, values: np.ndarray) -> np.ndarray:
    """The arrays of all ranks behind each other on rank 0; an empty one on others."""
    parts = comm.gather(values)
    return np.concatenate(parts) if parts is not None else values[:0]


class Mass(Operator):
    """(u, v): each component by itself."""

    _made = staticmethod(_native.fem_mass)


class Poisson(Operator):
    """(∇u, ∇v): each component by itself."""

    _made = staticmethod(_native.fem_poisson)

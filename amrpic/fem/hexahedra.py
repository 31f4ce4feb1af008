"""The background mesh: equal hexahedra of one degree."""

from __future__ import annotations

import math
from collections.abc import Sequence
from functools import cached_property

import numpy as np

from .. import _native
from ..errors import InputError
from ..mesh.domain import Domain
from ..mesh.hierarchy import Hierarchy
from ..mpi import MPI
from ..parallel import own, together, world_by_default

DEGREES = (1, 2, 3, 4)
BLOCK = 2  # elements that boxes are made of along each axis
LARGEST_BOX = 8  # elements along each axis: what a kernel touches of their nodes stays in a second-level cache
BOXES_PER_RANK = 4  # that equal shares need


def _box_size(cells: Sequence[int], ranks: int) -> int:
    size = LARGEST_BOX
    while size > BLOCK and ranks > 1 and math.prod(-(-n // size) for n in cells) < BOXES_PER_RANK * ranks:
        size //= 2
    return size


class Mesh:
    """A cuboid cut into equal hexahedra with Lagrange's polynomials on Gauss-Lobatto nodes. Collective to make.

    `lower` and `upper` are corners in m, `cells` the numbers of elements along the axes, at least 2 each; three values, or one
    for all axes. Elements are dealt to ranks by boxes of at most `max_grid_size` along each axis, 8 unless that leaves a rank
    less than four boxes. A vector on the mesh is this rank's part alone, (own nodes,) or (own nodes, components), in the order
    of `nodes`.

    `comm` may be left out: all ranks. Raises InputError for a degree outside 1 to 4, and HierarchyError for a domain or boxes
    that cannot be; on all ranks.
    """

    @world_by_default
    def __init__(
        self,
        comm: MPI.Comm,
        lower: Sequence[float] | float,
        upper: Sequence[float] | float,
        cells: Sequence[int] | int,
        degree: int = 1,
        max_grid_size: int | None = None,
    ) -> None:
        self.comm = own(comm)
        with together(self.comm, InputError):
            if np.ndim(degree) > 0 or degree not in DEGREES:
                raise InputError(f"degree is {degree!r}; elements have degree 1, 2, 3 or 4")
            self.domain = Domain(lower, upper, cells, "dirichlet")
        self.degree = int(degree)
        size = _box_size(self.domain.cells, self.comm.size) if max_grid_size is None else max_grid_size
        self.hierarchy = Hierarchy(self.comm, self.domain, (), size, BLOCK)
        self.native = _native.FemLattice(self.hierarchy.native, self.degree)

    @property
    def spacing(self) -> np.ndarray:
        """Widths of an element, (3,) in m."""
        return self.domain.spacing

    @property
    def element_volume(self) -> float:
        """Volume of an element in m³."""
        return float(self.spacing.prod())

    @cached_property
    def elements(self) -> np.ndarray:
        """Indices of this rank's elements along the axes, (n, 3), in their order."""
        return self.native.elements()

    @cached_property
    def node_indices(self) -> np.ndarray:
        """Indices of this rank's nodes along the axes, (n, 3), in the order of vectors."""
        return self.native.nodes()

    @property
    def node_counts(self) -> np.ndarray:
        """Nodes of the whole mesh along the axes, (3,)."""
        return np.array(self.domain.cells) * self.degree + 1

    @cached_property
    def numbers(self) -> np.ndarray:
        """Number of each of this rank's nodes in the whole mesh, x fastest, (n,): the same however it is cut into boxes."""
        return np.ravel_multi_index(tuple(self.node_indices.T), tuple(self.node_counts), order="F")

    @cached_property
    def nodes(self) -> np.ndarray:
        """Places of this rank's nodes, (n, 3) in m."""
        within = (_native.fem_lobatto_nodes(self.degree) + 1) / 2
        element, node = np.divmod(self.node_indices, self.degree)
        return np.array(self.domain.lower) + (element + within[node]) * self.spacing

    @cached_property
    def boundary(self) -> np.ndarray:
        """Whether each of this rank's nodes lies on the surface of the mesh, (n,)."""
        return ((self.node_indices == 0) | (self.node_indices == self.node_counts - 1)).any(axis=1)

    def __repr__(self) -> str:
        nx, ny, nz = self.domain.cells
        return f"Mesh({nx} x {ny} x {nz} elements of degree {self.degree})"

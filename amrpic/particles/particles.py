"""Particles as a structure of arrays."""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from .. import _native
from ..errors import ParticleError
from ..mesh.hierarchy import Hierarchy
from ..mesh.window import AT_REST, Window
from ..mpi import MPI
from ..parallel import global_sum
from ..units import SPEED_OF_LIGHT
from .arrays import columns, empty_columns, recycled, zero_columns
from .species import SpeciesTable


@dataclass(frozen=True)
class Sorting:
    """How particles are sorted: by slot and brick of 8³ cells of a hierarchy.

    The slots are this rank's boxes, level by level, and then bricks of other ranks' boxes that hold particles of this rank.
    """

    hierarchy: Hierarchy
    starts: np.ndarray  # where the particles of each slot start; one value more
    remote: _native.RemoteBricks  # of the last slots
    servers: np.ndarray  # where each rank's part of the curve of bricks starts, int64 (ranks + 1,)

    @property
    def levels(self) -> np.ndarray:
        """Level of each slot."""
        own = [np.full(len(self.hierarchy.local_boxes(level)), level) for level in range(self.hierarchy.levels)]
        return np.concatenate([*own, self.remote.bricks[:, 0]])


@dataclass(frozen=True, eq=False)
class Particles:
    """Macroparticles on this rank; a value that stages take and return.

    Other array layouts are accepted and copied. `sorting` is set by `migrate` and no longer holds once positions change. Equal
    weights take no memory if they are given as one number that is repeated, `np.broadcast_to(weight, n)`, as bunches give them.
    Raises ParticleError if the arrays do not fit together.
    """

    position: np.ndarray  # (n, 3) m; the transpose of an array with one row per component
    momentum: np.ndarray  # (n, 3) kg m/s, of one real particle
    weight: np.ndarray  # (n,) real particles per macroparticle
    id: np.ndarray  # (n,) int64, unique over all ranks
    species: SpeciesTable  # of all ids, the same on all ranks
    sorting: Sorting | None = None

    def __post_init__(self) -> None:
        set_ = object.__setattr__
        set_(self, "position", columns(self.position, "positions of particles"))
        set_(self, "momentum", columns(self.momentum, "momenta of particles"))
        set_(self, "weight", _weights(self.weight))
        set_(self, "id", np.ascontiguousarray(self.id, dtype=np.int64))
        count = len(self.position)
        for name in ("momentum", "weight", "id"):
            if len(getattr(self, name)) != count:
                raise ParticleError(f"particles have {count} positions but {len(getattr(self, name))} values of {name}")

    @staticmethod
    def allocate(count: int, species: SpeciesTable, weight: float | None = None, at_rest: bool = False) -> Particles:
        """Particles whose values are yet to be set, except the weight if all have the same, and momenta of those at rest."""
        return Particles(
            empty_columns(count),
            zero_columns(count) if at_rest else empty_columns(count),
            recycled(count, np.float64) if weight is None else np.broadcast_to(weight, count),
            recycled(count, np.int64),
            species,
        )

    @staticmethod
    def empty(species: SpeciesTable) -> Particles:
        """No particles."""
        return Particles.allocate(0, species)

    def __len__(self) -> int:
        return len(self.weight)

    @property
    def arrays(self) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
        """Position, momentum, weight and id, as the native kernels take them."""
        return self.position, self.momentum, self.weight, self.id

    @cached_property
    def kind(self) -> np.ndarray:
        """(n,) index of each particle's species in `species.kinds`."""
        return self.species.find(self.id)

    def spread(self, values: np.ndarray) -> np.ndarray:
        """One value per species as one per particle (n,); takes no memory if there is one species. Not to be written to."""
        return np.broadcast_to(values[0], len(self)) if len(values) == 1 else values[self.kind]

    @property
    def charge(self) -> np.ndarray:
        """(n,) C, of one real particle."""
        return self.spread(self.species.charges)

    @property
    def mass(self) -> np.ndarray:
        """(n,) kg, of one real particle."""
        return self.spread(self.species.masses)

    @property
    def kinetic_energy(self) -> np.ndarray:
        """(n,) J, of one real particle."""
        square = np.square(self.momentum / (self.mass[:, None] * SPEED_OF_LIGHT)).sum(axis=1)
        # u² / (γ + 1) equals γ - 1 and loses no digits when particles are slow.
        return self.mass * SPEED_OF_LIGHT**2 * (square / (np.sqrt(1 + square) + 1))

    def select(self, chosen: np.ndarray | slice) -> Particles:
        """The particles that an index array, a mask or a slice names."""
        position, momentum, weight, id = (a[chosen] for a in self.arrays)
        return Particles(position, momentum, weight, id, self.species)

    def ascending(self, chosen: np.ndarray) -> Particles:
        """The particles that an ascending index array names, sorted as these are."""
        few = self.select(chosen)
        if self.sorting is None:
            return few
        sorting = replace(self.sorting, starts=np.searchsorted(chosen, self.sorting.starts))
        return Particles(*few.arrays, self.species, sorting)

    def replace(self, position: np.ndarray | None = None, momentum: np.ndarray | None = None) -> Particles:
        """The same particles elsewhere, or with other momenta; what is not given is shared."""
        return Particles(
            self.position if position is None else position,
            self.momentum if momentum is None else momentum,
            self.weight,
            self.id,
            self.species,
            self.sorting if position is None else None,
        )

    def with_weight(self, weight: np.ndarray) -> Particles:
        """The same particles with other weights (n,)."""
        return Particles(self.position, self.momentum, weight, self.id, self.species, self.sorting)

    def turned(self, matrix: np.ndarray) -> Particles:
        """The particles with positions and momenta multiplied by a matrix (3, 3)."""
        position, momentum = empty_columns(len(self)), empty_columns(len(self))
        np.matmul(matrix, self.position.T, out=position.T)
        np.matmul(matrix, self.momentum.T, out=momentum.T)
        return self.replace(position, momentum)

    def seen_from(self, window: Window) -> Particles:
        """The particles in the coordinates of a window, from those of the laboratory."""
        if window == AT_REST:
            return self
        return self.replace(
            window.from_laboratory(self.position - window.origin), window.from_laboratory(self.momentum)
        )

    def in_laboratory(self, window: Window) -> Particles:
        """The opposite."""
        if window == AT_REST:
            return self
        return self.replace(window.places(self.position), window.to_laboratory(self.momentum))

    def read_only(self) -> Particles:
        """The same particles, through arrays that cannot be written to."""
        position, momentum, weight, number = views = [array.view() for array in self.arrays]
        for view in views:
            view.flags.writeable = False
        return Particles(position, momentum, weight, number, self.species, self.sorting)

    @property
    def equal_weights(self) -> bool:
        """Whether the weights are one number that is repeated."""
        return self.weight.strides == (0,)

    def with_own_weights(self) -> Particles:
        """The same particles, with memory for the weight of each even if all are equal."""
        if not self.equal_weights:
            return self
        return Particles(self.position, self.momentum, np.array(self.weight), self.id, self.species, self.sorting)

    def sorted_on(self, hierarchy: Hierarchy) -> Sorting:
        """How the particles are sorted on a hierarchy; raises ParticleError if they are not."""
        if self.sorting is None or self.sorting.hierarchy is not hierarchy:
            raise ParticleError(
                "particles are not sorted on this hierarchy; pass them through migrate(particles, hierarchy) first"
            )
        return self.sorting

    def global_count(self, comm: MPI.Comm) -> int:
        """Number of macroparticles on all ranks. Collective."""
        return int(comm.allreduce(len(self)))

    def total_charge(self, comm: MPI.Comm) -> float:
        """Charge on all ranks in C. Collective."""
        return global_sum(comm, self.own_charge)

    @property
    def own_charge(self) -> float:
        """Charge of this rank's particles in C."""
        return float((self.weight * self.charge).sum())


def concatenate(parts: Sequence[Particles]) -> Particles:
    """One value with the particles of all parts, in order; the parts must have one table of species."""
    species = parts[0].species
    for part in parts:
        if part.species != species:
            raise ParticleError(
                f"particles of the species {part.species} cannot join those of {species}; give all one table of species"
            )
    position, momentum, weight, id = (joined(column) for column in zip(*(part.arrays for part in parts), strict=True))
    return Particles(position, momentum, weight, id, species)


def one_weight_and_most(comm: MPI.Comm, parts: Sequence[Particles]) -> tuple[float | None, int]:
    """The weight that all particles of all parts on all ranks are known to have, if there is one, and the most particles of a
    rank, those of its parts together. Collective.
    """
    bounds = np.array([np.inf, np.inf, -sum(map(len, parts))])
    for part in parts:
        if len(part) > 0:
            own = [part.weight[0], -part.weight[0]] if part.equal_weights else [-np.inf, -np.inf]
            bounds[:2] = np.minimum(bounds[:2], own)
    comm.Allreduce(MPI.IN_PLACE, bounds, MPI.MIN)
    return float(bounds[0]) if bounds[0] == -bounds[1] else None, int(-bounds[2])


def cut(parts: list[Particles], number: int) -> list[Particles]:
    """So many portions of the same particles, in order and of about equal size, each with arrays of its own.

    The list of parts is empty afterwards. Unless somebody else holds them, no more than one column is ever held twice.
    """
    columns, species = emptied(parts)
    pieces = []
    for arrays in columns:
        whole = arrays.pop() if len(arrays) == 1 else joined(arrays)
        arrays.clear()
        ends = [len(whole) * n // number for n in range(number + 1)]
        slices = [whole[begin:end] for begin, end in itertools.pairwise(ends)]
        pieces.append([joined([portion]) for portion in slices] if number > 1 else slices)
        del whole, slices
    positions, momenta, weights, ids = pieces
    return [Particles(*of, species) for of in zip(positions, momenta, weights, ids, strict=True)]


def emptied(parts: list[Particles]) -> tuple[list[list[np.ndarray]], SpeciesTable]:
    """The positions, momenta, weights and ids of some particles, and their species; the list is empty afterwards.

    So each array is freed as soon as it is dropped, unless somebody else holds the particles.
    """
    species = parts[0].species
    columns = [list(column) for column in zip(*(part.arrays for part in parts), strict=True)]
    parts.clear()
    return columns, species


def joined(arrays: Sequence[np.ndarray]) -> np.ndarray:
    """A copy of the values of all arrays, in order, as `Particles` holds them; one number that is repeated stays one."""
    count, filled = sum(map(len, arrays)), [array for array in arrays if len(array) > 0]
    if filled and all(array.strides == (0,) for array in filled) and len({array[0] for array in filled}) == 1:
        return np.broadcast_to(filled[0][0], count)
    out = empty_columns(count) if arrays[0].ndim == 2 else recycled(count, arrays[0].dtype.type)
    return np.concatenate(arrays, out=out)


def _weights(values: np.ndarray) -> np.ndarray:
    values = np.asarray(values, dtype=np.float64)
    return values if values.strides == (0,) else np.ascontiguousarray(values)

"""The layer of cells at a wall that emits: the field at the wall, and within the first two cells.

A mesh knows the mean charge of a cell, but where particles start at rest most of it lies close to the wall. There the field
along the normal follows from Gauss's law within the cell: from the flux at its face, and the part of its charge that is below.
The field across the normal is that along the wall there, mostly zero, and linear up to the centre of the first cell; a mesh
has that of the centre all the way.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from ..mesh.columns import READ, Columns
from ..mesh.field import Field, VectorField
from ..particles.clouds import Clouds, Shape
from ..particles.particles import Particles
from ..particles.wall_response import WallResponse
from ..stages.gather import gather

CELLS = 2  # in which the field follows from Gauss's law
BINS = (
    16  # of each of these two cells, in which charge is summed: cubic in the first one, where particles start at rest
)
EDGES = np.array([(np.arange(BINS + 1) / BINS) ** 3, np.arange(BINS + 1) / BINS])
Function = Callable[[np.ndarray, np.ndarray, np.ndarray], np.ndarray | float]


@dataclass(frozen=True, eq=False)
class NormalField:
    """The field along the normal into the domain in the first cells of columns, V/m."""

    faces: np.ndarray  # (n, READ): at the wall and the faces behind it
    centres: np.ndarray  # (n, READ - 1): as the mesh has it in the cells between these

    def with_exact(self, exact: NormalField) -> NormalField:
        """Return this field of all charge with the faces of a part of it as they are known exactly.

        What is left at the faces is that of the rest: linear between centres, and up to the wall.
        """
        return NormalField(self.faces + exact.faces - _linear(exact.centres), self.centres)

    def with_more_at_wall(self, field: np.ndarray) -> NormalField:
        """Return this field with so much more at the wall, V/m (n,)."""
        return NormalField(np.column_stack([self.faces[:, 0] + field, self.faces[:, 1:]]), self.centres)


def of_potential(columns: Columns, phi: Field, at_wall: Function | None) -> NormalField:
    """Return the normal field of a potential of second order that has given values at the wall, 0 V by default. Collective.

    At the wall it is the flux of the discrete equation there, so that the first cells keep Gauss's law exactly.
    """
    values, faces = columns.read(phi), np.empty((len(columns), READ))
    wall = 0.0 if at_wall is None else at_wall(*columns.centre.T)
    faces[:, 0] = (8 / 3) * wall - 3 * values[:, 0] + values[:, 1] / 3
    faces[:, 1:] = values[:, :-1] - values[:, 1:]
    faces /= columns.width[:, [columns.axis]]
    return NormalField(faces, (faces[:, :-1] + faces[:, 1:]) / 2)


def of_component(columns: Columns, component: Field) -> NormalField:
    """Return the normal field of which the component along the axis is known in cells; linear up to the wall. Collective."""
    centres = columns.inwards * columns.read(component)[:, :-1]
    return NormalField(_linear(centres), centres)


def _linear(centres: np.ndarray) -> np.ndarray:
    """Return values at faces (n, k + 1) from those in cells (n, k): the means, and beyond the ends what goes on linearly."""
    first, last = (1.5 * centres[:, end] - 0.5 * centres[:, next] for end, next in ((0, 1), (-1, -2)))
    return np.column_stack([first, (centres[:, :-1] + centres[:, 1:]) / 2, last])


def along_wall(columns: Columns, at_wall: Function | None) -> np.ndarray:
    """Return the field along a wall with given potentials (n, 3), V/m, by differences within each column."""
    out = np.zeros((len(columns), 3))
    if at_wall is not None:
        for axis in columns.across:
            step = np.zeros((len(columns), 3))
            step[:, axis] = columns.width[:, axis] / 4
            low, high = (at_wall(*(columns.centre + way * step).T) for way in (-1, 1))
            out[:, axis] = (low - high) / (2 * step[:, axis])
    return out


@dataclass(frozen=True, eq=False)
class WallLayer:
    """The field in the first cells at a wall, and how the charge of particles lies in them."""

    columns: Columns
    field: NormalField
    along: np.ndarray  # (n, 3) V/m, of the field along the wall at it
    electric: VectorField  # of the mesh
    below: np.ndarray  # (n, CELLS, BINS + 1): part of the charge of a cell that is below the edges of its bins

    @classmethod
    def of(
        cls,
        columns: Columns,
        field: NormalField,
        along: np.ndarray,
        electric: VectorField,
        particles: Particles,
        response: WallResponse | None = None,
    ) -> WallLayer:
        """Return the layer with these particles in it; with a response the field at the wall is sharp. Collective."""
        near = _Near(columns, particles.position)
        charge = (particles.weight * particles.charge)[near.chosen]
        if response is not None:
            field = field.with_more_at_wall(response.missing(near.close_to_wall(charge)))
        own_sums = np.bincount(near.place, np.abs(charge), len(columns) * CELLS * BINS)
        sums = columns.hierarchy.comm.allreduce(own_sums).reshape(-1, CELLS, BINS)
        total = np.cumsum(sums, axis=2)
        evenly = np.broadcast_to(np.diff(EDGES), sums.shape).cumsum(axis=2)
        below = np.divide(total, total[:, :, -1:], out=evenly, where=total[:, :, -1:] > 0)
        return cls(columns, field, along, electric, np.concatenate([np.zeros((*sums.shape[:2], 1)), below], axis=2))

    @property
    def at_wall(self) -> np.ndarray:
        """(n,) V/m, along the normal into the domain."""
        return self.field.faces[:, 0]

    def correct(self, electric: np.ndarray, particles: Particles, clouds: Clouds) -> None:
        """Add to fields at particles (n, 3), V/m, what Gauss's law within cells has beyond the mesh's field along the normal,
        and what the field along the wall has beyond it across the normal. Collective.

        Gauss's law is taken in the column of a particle alone, so what differs across columns stays as it is gathered.
        """
        near = _Near(self.columns, particles.position)
        column, cell, bin, part = near.column, near.cell, near.bin, near.part
        low, high = (EDGES[cell, bin + up] for up in (0, 1))
        below, above = (self.below[column, cell, bin + up] for up in (0, 1))
        share = below + (above - below) * (part - low) / (high - low)
        faces = self.field.faces
        within = faces[column, cell] + (faces[column, cell + 1] - faces[column, cell]) * share
        gathered = gathered_from(self.field.centres, column, cell, part, clouds.shape)
        electric[near.chosen, self.columns.axis] += self.columns.inwards * (within - gathered)
        low = np.flatnonzero((cell == 0) & (part < 0.5))
        of_mesh = gather(self.electric, particles.ascending(near.chosen[low]), clouds)
        across = (1 - 2 * part[low, None]) * (self.along[column[low]] - of_mesh)
        across[:, self.columns.axis] = 0.0
        electric[near.chosen[low]] += across


def gathered_from(
    centres: np.ndarray, column: np.ndarray, cell: np.ndarray, part: np.ndarray, shape: Shape
) -> np.ndarray:
    """Return what clouds of a shape gather along columns of values in cells, at parts of these; beyond the wall the first."""
    if shape == "nearest-grid-point":
        return centres[column, cell]
    low, high = centres[column, np.maximum(cell - 1, 0)], centres[column, cell + 1]
    way = part - 0.5
    if shape == "triangular-shaped-cloud":
        return 0.5 * (0.5 - way) ** 2 * low + (0.75 - way**2) * centres[column, cell] + 0.5 * (0.5 + way) ** 2 * high
    return centres[column, cell] * (1 - np.abs(way)) + np.where(way < 0, low, high) * np.abs(way)


class _Near:
    """Which particles are in the first cells at a wall, and where there."""

    def __init__(self, columns: Columns, position: np.ndarray) -> None:
        self._columns = columns
        lower, upper = (
            corner[columns.axis] for corner in (columns.hierarchy.domain.lower, columns.hierarchy.domain.upper)
        )
        along, reach = position[:, columns.axis], CELLS * columns.hierarchy.spacing(0)[columns.axis]
        close = np.flatnonzero(along < lower + reach if columns.side == 0 else along > upper - reach)
        column, distance = columns.find(position[close])
        inside = np.flatnonzero((column >= 0) & (distance < CELLS))
        distance = np.maximum(distance[inside], 0.0)
        self.chosen, self.column = close[inside], column[inside]
        self.cell = distance.astype(np.int64)
        self.part = distance - self.cell  # of the cell, from the wall
        scaled = np.where(self.cell == 0, np.cbrt(self.part), self.part)
        self.bin = np.minimum((scaled * BINS).astype(np.int64), BINS - 1)
        self.place = (self.column * CELLS + self.cell) * BINS + self.bin

    def close_to_wall(self, charge: np.ndarray) -> np.ndarray:
        """Return the charge in C/m² (n,) that lies in each first cell, less with its distance from the wall.

        In the middle of a cell, where a mesh has it, none. Collective.
        """
        part = np.where(self.cell == 0, np.maximum(1 - 2 * self.part, 0.0), 0.0)
        own_sums = np.bincount(self.column, charge * part, len(self._columns))
        return self._columns.hierarchy.comm.allreduce(own_sums) / self._columns.area

"""Particles that a step takes from one brick into another, and from the ranks that serve these to others.

Those of a brick are spread evenly over it; momenta are those of a sample, the same everywhere.
"""

from __future__ import annotations

import itertools
from dataclasses import dataclass

import numpy as np

from amrpic import _native
from amrpic.mesh.boxes import Array, unique_rows
from amrpic.mesh.hierarchy import Hierarchy

from .bricks import WORD, Bricks, Served

WITHIN = 0.25  # of a cell: how far behind a face those lie that came through it
QUARTERS = (0.25, 0.75)  # of a brick: finer ones that it meets lie around these


@dataclass(frozen=True)
class Moves:
    """Which part of the particles of a brick comes into which other one."""

    source: Array  # int64 (n,) bricks
    target: Array  # int64 (n,)
    part: Array  # (n,) of the source's particles
    moved: float  # the part of all particles that leaves its brick


def moves(bricks: Bricks, mesh: Hierarchy, displacements: Array) -> Moves:
    """Return where particles of bricks are after `displacements` (m, 3), in m, each as likely as the other. Local.

    What comes into bricks without particles counts as moved alone.
    """
    levels, extents = bricks.rows[:, 0], bricks.cells[:, 3:] - bricks.cells[:, :3] + 1
    kinds, kind = unique_rows(np.column_stack([levels, extents]))
    found, moved = [(np.zeros((0, 2), dtype=np.int64), np.zeros(0))], 0.0
    for number, (level, *extent) in enumerate(kinds.tolist()):
        here = np.flatnonzero(kind == number)
        offsets, chance = _crossings(displacements / (np.array(extent) * mesh.spacing(level)))
        moved += float(bricks.particles[here].sum() * chance.sum())
        for offset, part in zip(offsets, chance, strict=True):
            inside = _behind(offset, np.array(extent))
            at = (bricks.cells[here, None, :3] + inside) * np.array(mesh.spacing(level))
            target = bricks_at(bricks, mesh, at.reshape(-1, 3))
            pairs = np.column_stack([np.repeat(here, len(inside)), target])[target >= 0]
            found.append((pairs, np.full(len(pairs), part / len(inside))))
    pairs, which = unique_rows(np.concatenate([pairs for pairs, _ in found]))
    part = np.bincount(which, np.concatenate([part for _, part in found]), len(pairs))
    return Moves(pairs[:, 0], pairs[:, 1], part, moved / max(bricks.total, 1e-300))


def _crossings(steps: Array) -> tuple[Array, Array]:
    """Return by how many bricks along x, y, z particles are displaced, int64 (k, 3), without those that stay, and the chance
    of each (k,); `steps` (m, 3) are displacements in bricks."""
    first = np.floor(steps)
    beyond = steps - first
    offsets, chances = [], []
    for more in itertools.product((0, 1), repeat=3):
        offsets.append(first + more)
        chances.append(np.where(more, beyond, 1 - beyond).prod(axis=1))
    unique, which = unique_rows(np.concatenate(offsets).astype(np.int64))
    chance = np.bincount(which, np.concatenate(chances), len(unique)) / max(len(steps), 1)
    leaves = unique.any(axis=1) & (chance > 0)
    return unique[leaves], chance[leaves]


def _behind(offset: Array, extent: Array) -> Array:
    """Return places (k, 3), in cells from a brick's lower corner, of particles displaced by so many bricks along each axis:
    behind the face that they came through."""
    along = [
        [extent[d] * q for q in QUARTERS]
        if offset[d] == 0
        else [extent[d] * offset[d] + WITHIN if offset[d] > 0 else extent[d] * (offset[d] + 1) - WITHIN]
        for d in range(3)
    ]
    return np.array(list(itertools.product(*along)))


def bricks_at(bricks: Bricks, mesh: Hierarchy, places: Array) -> Array:
    """Return the finest brick that holds each place (n, 3), in m from the domain's lower corner; -1 where none does. Local."""
    out = np.full(len(places), -1, dtype=np.int64)
    for level in reversed(range(mesh.levels)):
        here, left = np.flatnonzero(bricks.rows[:, 0] == level), np.flatnonzero(out < 0)
        if len(here) and len(left):
            cells = np.floor(places[left] / mesh.spacing(level)).astype(np.int32)
            table = _native.BoxTable(np.ascontiguousarray(bricks.cells[here], dtype=np.int32))
            box = table.find(np.ascontiguousarray(cells))
            out[left[box >= 0]] = here[box[box >= 0]]
    return out


@dataclass(frozen=True)
class Leaving:
    """Particles that ranks send each other in a step."""

    ranks: int
    source: Array  # int64 (n,)
    target: Array  # int64 (n,)
    particles: Array  # (n,) on average
    portions: Array  # (n,) bricks that these come to, on average

    @property
    def met(self) -> Array:
        """The chance that there is a message, (n,)."""
        return -np.expm1(-self.particles)

    @property
    def messages(self) -> Array:
        """Those that each rank sends, (ranks,), on average, and as many announcements."""
        return np.bincount(self.source, self.met, self.ranks)

    @property
    def sent(self) -> Array:
        """Particles that each rank sends, (ranks,)."""
        return np.bincount(self.source, self.particles, self.ranks)

    @property
    def announced(self) -> Array:
        """Bytes of announcements, (n,): how many words come, and for each brick its name and how many particles."""
        return WORD * (self.met + 2 * self.portions)

    def of_nodes(self, ranks_per_node: int, values: Array | None = None) -> Array:
        """Return the particles that leave each node, (nodes,), or what else ranks send each other, (n,)."""
        source, target = self.source // ranks_per_node, self.target // ranks_per_node
        given = self.particles if values is None else values
        return np.bincount(source, given * (source != target), -(-self.ranks // ranks_per_node))


def leaving(moves: Moves, held: Served, ranks: int) -> Leaving:
    """Return what servers of bricks send each other of the particles that move between these. Local.

    Who serves a particle follows from its brick and its id: those of one part of a brick's ids come to whoever serves the
    same part of the other one.
    """
    whole = _native.PLACES_PER_BRICK
    brick, server = held.pairs[:, 0], held.pairs[:, 1]
    first = np.searchsorted(brick, np.arange(len(held.bricks.rows) + 1))  # pairs are in the order of bricks
    begin, stop = (np.clip(held.servers[server + i] - held.places[brick], 0, whole) for i in (0, 1))
    move, one = _each(moves.source, first)
    again, other = _each(moves.target[move], first)
    move, one = move[again], one[again]
    common = np.minimum(stop[one], stop[other]) - np.maximum(begin[one], begin[other])
    sent = (common > 0) & (server[one] != server[other])
    move, one, other = move[sent], one[sent], other[sent]
    particles = held.bricks.particles[moves.source[move]] * moves.part[move] * (common[sent] / whole)
    # Those that one rank sends to a brick of another one, from wherever they come, are a portion.
    portions, of = np.unique(server[one] * len(brick) + other, return_inverse=True)
    filled = -np.expm1(-np.bincount(of, particles, len(portions)))
    pairs, which = np.unique(portions // len(brick) * ranks + server[portions % len(brick)], return_inverse=True)
    return Leaving(
        ranks,
        pairs // ranks,
        pairs % ranks,
        np.bincount(which[of], particles, len(pairs)),
        np.bincount(which, filled, len(pairs)),
    )


def _each(bricks: Array, first: Array) -> tuple[Array, Array]:
    """Return for all pairs of some bricks the number of the brick and that of the pair; those of brick b start at first[b]."""
    count = first[bricks + 1] - first[bricks]
    which = np.repeat(np.arange(len(bricks)), count)
    return which, first[bricks[which]] + np.arange(len(which)) - np.repeat(np.cumsum(count) - count, count)

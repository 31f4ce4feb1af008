"""Bricks of 8³ cells that hold particles, the ranks that serve these, and what passes between them and the owners of cells.

The brick, its place on the curve and the shares of the ranks are those of `stages.migrate`; ranks need not exist.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from amrpic import _native
from amrpic.mesh.boxes import Array, unique_rows
from amrpic.mesh.hierarchy import Hierarchy
from amrpic.parallel import Traffic
from amrpic.stages.migrate import brick_cost, share_out

from .densities import Cloud, Densities
from .sent import Sent

SIZE = 8  # cells per axis of a brick
FEWEST = 0.5  # particles of a brick that counts
WORD = 8  # bytes of a number, or of a brick's name


@dataclass(frozen=True)
class Bricks:
    """Bricks with their particles, the same for any distribution over ranks."""

    rows: Array  # int32 (n, 3): level, box, and number in the box
    cells: Array  # int64 (n, 6): lower and upper corners, in cells of the level
    particles: Array  # (n,)

    @cached_property
    def total(self) -> float:
        return float(self.particles.sum())


def bricks_of(clouds: Sequence[Cloud], mesh: Hierarchy) -> Bricks:
    """Return all bricks of a mesh with particles in cells that no finer level covers."""
    densities = Densities(clouds, mesh)
    rows, cells, particles = [], [], []
    for level in range(mesh.levels):
        corners = mesh.boxes(level).astype(np.int64)
        for place, box in enumerate(densities.boxes[level].tolist()):
            values = densities.box_values(level, place, lambda c: c.particles)
            if level + 1 < mesh.levels:
                values = values * (mesh.native.covered(level, box) == 0)
            starts = [np.arange(0, n, SIZE) for n in values.shape]
            for axis in range(3):
                values = np.add.reduceat(values, starts[axis], axis=axis)
            counts = values.ravel(order="F")  # bricks are numbered x fastest
            number = np.flatnonzero(counts >= FEWEST)
            at = np.array(np.unravel_index(number, values.shape, order="F")).T
            lower = corners[box, :3] + SIZE * at
            rows.append(np.column_stack([np.full((len(number), 2), (level, box)), number]))
            cells.append(np.hstack([lower, np.minimum(lower + SIZE - 1, corners[box, 3:])]))
            particles.append(counts[number])
    return Bricks(
        np.concatenate([np.zeros((0, 3)), *rows]).astype(np.int32),
        np.concatenate([np.zeros((0, 6)), *cells]).astype(np.int64),
        np.concatenate([np.zeros(0), *particles]),
    )


@dataclass(frozen=True)
class Served:
    """Bricks on the ranks of a mesh, and what servers and owners of cells send each other."""

    bricks: Bricks
    servers: Array  # as in `particles.Sorting`
    places: Array  # of the bricks, on the curve
    particles: Array  # (ranks,)
    pairs: Array  # int64 (m, 2): brick, and a rank that serves some of its particles
    exchange: Exchange


@dataclass(frozen=True)
class Exchange:
    """What servers of particles and owners of cells send each other: of each brick its first server meets the owners of its
    cells, and its other servers meet that one.

    Charge goes to the owner, behind a list of the bricks in the same message, the field to the server.
    """

    ranks: int
    server: Array  # (n,)
    owner: Array  # (n,) or the first server, which stands for owners before the others
    names: Array  # (n,) bricks in the list
    cells: Array  # (n,) in the windows around these

    @property
    def messages(self) -> Array:
        """Those that each rank sends, (ranks,)."""
        return np.bincount(self.server, minlength=self.ranks) + np.bincount(self.owner, minlength=self.ranks)

    def deposit(self, rank: int) -> Sent:
        """Return what a rank sends of charge; the collective of the announcement is counted elsewhere."""
        mine = self.server == rank
        return _sent(self.owner[mine], self._charge[mine])

    def gather(self, rank: int) -> Sent:
        """Return what a rank sends of the field."""
        mine = self.owner == rank
        return _sent(self.server[mine], self._field[mine])

    def leaving(self, call: str, ranks_per_node: int) -> float:
        """Return the most bytes that leave a node by "deposit" or "gather"."""
        server, owner = self.server // ranks_per_node, self.owner // ranks_per_node
        node, size = (server, self._charge) if call == "deposit" else (owner, self._field)
        return float(np.bincount(node, size * (server != owner)).max(initial=0.0))

    @property
    def _charge(self) -> Array:
        return WORD * (1 + self.names + self.cells)

    @property
    def _field(self) -> Array:
        return 3 * WORD * self.cells


def _sent(to: Array, size: Array) -> Sent:
    traffic = Traffic(len(to), int(size.sum()), 0)
    return Sent(traffic, dict(zip(to.tolist(), size.tolist(), strict=True)))


def served(bricks: Bricks, mesh: Hierarchy, matched: bool) -> Served:
    """Return who serves the particles on the ranks of a mesh, shared out by work as after a regrid. Local on virtual ranks."""
    ranks = mesh.comm.size
    places, parts = _native.brick_regions(mesh.native, bricks.rows, matched)
    counts = np.rint(bricks.particles).astype(np.int64)
    servers = share_out(mesh.comm, places, counts + brick_cost(mesh.comm, counts))
    inner = servers[1:-1]
    first, last = (np.searchsorted(inner, places + more, side="right") for more in (0, _native.PLACES_PER_BRICK - 1))
    brick = np.repeat(np.arange(len(places)), last - first + 1)
    rank = first[brick] + np.arange(len(brick)) - np.searchsorted(brick, brick)
    begin, stop = (np.clip(servers[rank + i], places[brick], places[brick] + _native.PLACES_PER_BRICK) for i in (0, 1))
    each = bricks.particles[brick] * ((stop - begin) / _native.PLACES_PER_BRICK)
    pairs = np.column_stack([brick, rank])
    between = exchange(mesh, bricks.rows, pairs, parts, first)
    return Served(bricks, servers, places, np.bincount(rank, each, ranks), pairs, between)


def exchange(mesh: Hierarchy, rows: Array, pairs: Array, parts: Array, first: Array) -> Exchange:
    """Return what passes because of bricks, `rows` (n, 3), and ranks that serve particles of them, `pairs` (m, 2). Local.

    `parts` is what `_native.brick_regions` returns of the bricks, `first` (n,) the lowest rank that serves each. A brick of a
    rank's own box needs no messages.
    """
    ranks, brick, server = mesh.comm.size, pairs[:, 0], pairs[:, 1]
    remote = _owners(mesh, rows[:, 0], rows[:, 1])[brick] != server
    brick, server = brick[remote], server[remote]
    cells = np.bincount(parts[:, 0], parts[:, 3], len(rows))
    behind = server != first[brick]
    passed = np.isin(parts[:, 0], brick)  # through the first servers
    of_part, owner = parts[passed], _owners(mesh, parts[passed, 1], parts[passed, 2])
    met = owner != first[of_part[:, 0]]
    by_part = of_part[met, 0], first[of_part[met, 0]], owner[met], of_part[met, 3]
    by_server = brick[behind], server[behind], first[brick[behind]], cells[brick[behind]]
    found = [_meetings(ranks, *values) for values in (by_server, by_part)]
    return Exchange(ranks, *(np.concatenate(both) for both in zip(*found, strict=True)))


def _meetings(ranks: int, brick: Array, server: Array, owner: Array, cells: Array) -> tuple[Array, Array, Array, Array]:
    """Return servers and owners that meet, how many bricks one names to the other, and how many cells pass, each (n,)."""
    meetings, member = np.unique(server * ranks + owner, return_inverse=True)
    named, _ = unique_rows(np.column_stack([member, brick]))  # a brick is named once, whatever its windows
    names = np.bincount(named[:, 0], minlength=len(meetings))
    values = np.bincount(member, cells, len(meetings)).astype(np.int64)
    return meetings // ranks, meetings % ranks, names, values


def _owners(mesh: Hierarchy, levels: Array, boxes: Array) -> Array:
    """Return the owner of each of some boxes, int64 (n,)."""
    out = np.zeros(len(levels), dtype=np.int64)
    for level in range(mesh.levels):
        here = levels == level
        out[here] = mesh.owners(level)[boxes[here]]
    return out

"""What ranks that do not exist would hold and send of a scene: a plan for each number of them, made by one process."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from .. import _native
from ..io.checkpoint_writer import loads
from ..io.writer_ranks import Load
from ..mesh.boxes import Array
from ..mesh.hierarchy import Hierarchy
from ..parallel import Traffic
from ..run.memory import Share, cells_below, placing_bytes, rank_memory
from ..run.restart import FIELDS, LAGGING_BYTES, ROW_BYTES, writers_of
from ..scene.motion import Leapfrog
from ..scene.scene import Scene
from .bricks import Bricks, Served, bricks_of, served
from .densities import charged_regions, clouds_of, planned_mesh
from .measure import cells_of_ranks
from .virtual_ranks import (
    Sent,
    chosen_ranks,
    counts,
    distributed,
    moved_on,
    particles_of,
    sample,
    without_open_walls,
)

SAMPLE = 10**5  # particles of a scene of which momenta are taken
MOVED = 300_000  # particles of a rank, and of those that share its bricks, that are gone through for a migration
LOOKED_AT = 24  # ranks of which messages are counted


@dataclass(frozen=True)
class Walls:
    """What the potential at open walls takes of a rank that was looked at."""

    interactions: int  # of patches with nodes and leaves, evaluated
    traffic: Traffic


@dataclass(frozen=True)
class Choices:
    """What ranks hold at most without one of the choices: see `Plan`."""

    with_whole_boxes: float  # Σ_l max ÷ Σ_l mean of cells
    particles_with_cells: float  # most ÷ mean particles


@dataclass(frozen=True)
class Plan:
    """A scene on so many ranks."""

    ranks: int
    cells: Array  # (levels, ranks)
    boxes: Array  # (levels, ranks)
    particles: Array  # (ranks,)
    memory: Array  # (ranks,) bytes at the fullest
    start_memory: Array  # (ranks,) bytes while particles are made and placed
    checkpoint: list[Load]  # of each writer
    looked_at: list[int]  # ranks of which messages are counted: the heaviest, and others at even distances
    sent: list[dict[str, Sent]]  # of these, by call
    relaxed: float  # Σ_l max over these of the cells relaxed in a cycle, as a part of those of the whole mesh on one rank
    walls: list[Walls]  # of these
    all_interactions: int  # of open walls, on all ranks together, from those that were looked at
    without: Choices

    @property
    def cell_imbalance(self) -> float:
        """Σ_l max ÷ Σ_l mean over ranks of the cells of level l."""
        return imbalance(self.cells)

    @property
    def particle_imbalance(self) -> float:
        """Max ÷ mean over ranks."""
        return float(self.particles.max() / self.particles.mean()) if self.particles.any() else 1.0

    @property
    def swept_cells(self) -> float:
        """Cells of all levels times `relaxed`: those that a cycle takes the time of, halos and multigrid levels included."""
        return float(self.cells.sum()) * self.relaxed

    @property
    def interactions(self) -> int:
        """The most of a rank at open walls."""
        return max(one.interactions for one in self.walls)

    def most(self, call: str, what: str) -> float:
        """Return the most of messages, bytes or collectives by a call, over the ranks that were looked at."""
        return max(getattr(of[call].traffic, what) for of in self.sent)

    def neighbours(self) -> int:
        """Return the most ranks that one sends to in a cycle."""
        return max(of["cycle"].neighbours for of in self.sent)


def imbalance(cells: Array) -> float:
    """Return Σ_l max ÷ Σ_l mean over ranks of cells (levels, ranks): levels are visited in turn."""
    return float(cells.max(axis=1).sum() / cells.mean(axis=1).sum())


class Planner:
    """A scene with its mesh and the particles of each brick, from which plans for any number of ranks follow."""

    def __init__(self, scene: Scene, say: Callable[[str], None] = lambda text: None) -> None:
        self.scene, self._say = scene, say
        self._clouds = clouds_of(scene)
        say("mesh from the densities of the bunches")
        self.mesh, self.notes = planned_mesh(scene, self._clouds)
        say("particles of each brick")
        self._bricks = bricks_of(self._clouds, self.mesh)
        self._sample = sample(scene, SAMPLE)

    def plans(self, ranks: Sequence[int], looked_at: int = LOOKED_AT) -> Iterator[Plan]:
        """Yield a plan for each number of ranks."""
        for number in ranks:
            yield self.plan(number, looked_at)

    def plan(self, ranks: int, looked_at: int = LOOKED_AT) -> Plan:
        """Return the plan for so many ranks; messages of at most `looked_at` of them are counted."""
        scene = self.scene
        self._say(f"{ranks} ranks: boxes and owners")
        mesh = distributed(self.mesh, ranks)
        closed, cells = without_open_walls(mesh), cells_of_ranks(mesh)
        held = served(self._on(mesh), mesh, scene.particles.interface == "matched")
        talks = held.exchange.deposit[:, 0] + held.exchange.gather[:, 0]
        chosen = chosen_ranks(np.vstack([cells, held.particles, talks]), looked_at)
        other, walls_of = moved_on(closed), self._walls(mesh)
        sent, walls, sweeps = [], [], []
        for number, rank in enumerate(chosen, start=1):
            self._say(f"{ranks} ranks: messages of rank {rank}, {number} of {len(chosen)}")
            seen = closed.seen_by(rank)
            mine, each = particles_of(rank, held, seen, self._sample, MOVED)
            found = counts(scene, seen, mine, held.servers, other.seen_by(rank))
            found["migrate"] = _standing_for(found["migrate"], each)
            for call in ("deposit", "gather"):
                more = held.exchange.traffic(call, rank)
                found[call] = replace(found[call], traffic=found[call].traffic + more)
            sent.append(found)
            walls.append(walls_of(rank))
            found["open walls"] = Sent(walls[-1].traffic)
            sweeps.append(self._sweeps(seen))
        return Plan(
            ranks,
            cells,
            np.array([np.bincount(mesh.owners(level), minlength=ranks) for level in range(mesh.levels)]),
            held.particles,
            *self._memory(mesh, cells, held),
            self._checkpoint(cells, held),
            chosen,
            sent,
            sum(max(found.get(level, 0.0) for found in sweeps) for level in self._all_levels) / self._all_sweeps(sweeps),
            walls,
            round(sum(one.interactions for one in walls) / len(chosen) * ranks),
            self._without(mesh, held),
        )

    def _on(self, mesh: Hierarchy) -> Bricks:
        """Return the bricks of a mesh, whose boxes may be cut in another way for more ranks."""
        same = all(np.array_equal(mesh.boxes(level), self.mesh.boxes(level)) for level in range(mesh.levels))
        return self._bricks if same else bricks_of(self._clouds, mesh)

    # ---- the cycle ----

    @property
    def _all_levels(self) -> range:
        return range(-len(cells_below(self.scene)), self.mesh.levels)

    def _sweeps(self, mesh: Hierarchy) -> dict[int, float]:
        """Return the cells that a rank relaxes in a cycle on each level, below the base by negative numbers."""
        solver = self.scene.solver
        work = _native.cycle_work(mesh.native, *solver.sweeps, solver.screening, solver.stretch)
        self._visits = {level.level: level.sweeps for level in work}
        return {level.level: level.relaxed for level in work}

    def _all_sweeps(self, sweeps: Sequence[dict[int, float]]) -> float:
        """Return the same of one rank with all cells, summed over the levels that ranks sweep."""
        cells = dict(enumerate(self.mesh.cells(level) for level in range(self.mesh.levels)))
        cells |= {-number: n for number, n in enumerate(cells_below(self.scene), start=1)}
        return sum(cells[level] * visits for level, visits in self._visits.items() if level in cells)

    # ---- open walls ----

    def _walls(self, mesh: Hierarchy) -> Callable[[int], Walls]:
        """Return what gives the part of a rank in the potential at open walls."""
        if not any("open" in faces for faces in mesh.domain.boundary):
            return lambda rank: Walls(0, Traffic())
        plans = _native.OpenWallPlans(mesh.native)
        charged = charged_regions(self._clouds, mesh)

        def of(rank: int) -> Walls:
            found = plans.counts(rank, charged)
            traffic = Traffic(found["messages"], found["bytes"], len(found["collectives"]))
            return Walls(found["far"] + found["near"], traffic)

        return of

    # ---- memory and files ----

    def _memory(self, mesh: Hierarchy, cells: Array, held: Served) -> tuple[Array, Array]:
        """Return the bytes of each rank at the fullest of a run, and while its particles are made and placed."""
        boxes = [mesh.boxes(level) for level in range(mesh.levels)]
        total, ranks = round(held.bricks.total), mesh.comm.size

        def need(rank: int, cells: int, particles: int) -> float:
            return rank_memory(self.scene, boxes, total, ranks, Share(rank, cells, particles))

        last, many = ranks - 1, 10**6  # writes nothing unless it is alone in its group; it grows in proportion to both
        metadata = sum(mesh.native.metadata_bytes(level) for level in range(mesh.levels))
        none = np.full(ranks, need(last, 0, 0) + metadata)
        writers = [load.ranks.start for load in self._checkpoint(cells, held)]
        of_cells = (need(last, many, 0) - need(last, 0, 0)) / many * cells.sum(axis=0)
        of_particles = (need(last, 0, many) - need(last, 0, 0)) / many * held.particles
        full = none + of_cells + of_particles
        full[writers] += need(0, 0, 0) - need(last, 0, 0)
        return full, none + placing_bytes(self.scene) * held.particles

    def _checkpoint(self, cells: Array, held: Served) -> list[Load]:
        """Return what each writer of a checkpoint does."""
        columns = [*ROW_BYTES, *([LAGGING_BYTES] if isinstance(self.scene.motion, Leapfrog) else [])]
        particles = np.repeat(np.rint(held.particles)[:, None], len(columns), axis=1)
        rows = np.hstack([np.repeat(cells.T, len(FIELDS), axis=1), particles]).astype(np.int64)
        sizes = [8] * (len(cells) * len(FIELDS)) + columns
        return loads(rows, sizes, writers_of(self.scene))

    # ---- what choices are worth ----

    def _without(self, mesh: Hierarchy, held: Served) -> Choices:
        """Return what ranks would hold with whole boxes, and with particles where their cells are."""
        whole = self.mesh
        boxes = [whole.boxes(level) for level in range(1, whole.levels)]
        uncut = Hierarchy(mesh.comm, whole.domain, boxes, whole.max_grid_size, whole.blocking_factor, whole.boxes(0))
        rows = held.bricks.rows
        at_home = np.zeros(mesh.comm.size)
        for level in range(mesh.levels):
            here = rows[:, 0] == level
            owners = mesh.owners(level)[rows[here, 1]]
            at_home += np.bincount(owners, held.bricks.particles[here], mesh.comm.size)
        most = float(at_home.max() / at_home.mean()) if at_home.any() else 1.0
        return Choices(imbalance(cells_of_ranks(uncut)), most)


def _standing_for(of_some: Sent, each: float) -> Sent:
    """Return what all particles of a rank send, of which some were gone through."""
    traffic = of_some.traffic
    return replace(of_some, traffic=replace(traffic, bytes=round(traffic.bytes * each)))

"""What ranks that do not exist would hold and send of a scene: a plan for each number of them, made by one process."""

from __future__ import annotations

import itertools
import math
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from amrpic import _native
from amrpic.io.writer_ranks import writers_of
from amrpic.mesh.boxes import Array
from amrpic.mesh.hierarchy import Hierarchy
from amrpic.parallel import Traffic
from amrpic.pic.flight import deposits_meanwhile
from amrpic.pic.memory import Share, rank_memory
from amrpic.pic.restart import BEFORE, FIELDS
from amrpic.scaling.measure import cells_of_ranks
from amrpic.scene.motion import Leapfrog, RandomWalk
from amrpic.scene.scene import Scene
from exact.virtual_rank import seen_by

from .bricks import Bricks, Exchange, Served, bricks_of, served
from .densities import charged_regions, clouds_of, planned_mesh
from .levels_below import cells_below
from .moves import Leaving, leaving, moves
from .neighbours import neighbours_of_ranks
from .sent import Sent
from .virtual_ranks import (
    chosen_ranks,
    counts,
    cycle_plans,
    displacements,
    distributed,
    moved_on,
    particles_of,
    sample,
    without_open_walls,
)
from .writer_loads import Load, checkpoint_loads

SAMPLE = 10**5  # particles of a scene of which momenta are taken
MOVED = 300_000  # particles of a rank, and of those that share its bricks, that are gone through for a migration
LOOKED_AT = 24  # ranks of which all messages are counted
WALLS = 2**14  # ranks that are gone through for open walls
NODE = 36  # ranks of a node of which all are looked at
PLACING = 112  # bytes of a particle while they are made and brought to their ranks
ROW_BYTES = (24, 24, 8, 8)  # of each column of particles in a checkpoint
LAGGING_BYTES = 24  # of the momenta that leapfrog keeps beside them


@dataclass(frozen=True)
class Walls:
    """What the potential at open walls takes of a rank that was looked at."""

    patches: int  # of 8 x 8 ghosts, and larger ones, evaluated
    interactions: int  # of these with nodes
    near: int  # of these with leaves
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
    faces: Array  # (levels, ranks) cells on the faces of boxes
    particles: Array  # (ranks,)
    bricks: Array  # (ranks,) that hold some of these
    moved: float  # the part of the particles that come into another brick in a step
    walks: bool  # whether particles move by a random walk
    memory: Array  # (ranks,) bytes at the fullest
    start_memory: Array  # (ranks,) bytes while particles are made and placed
    checkpoint: list[Load]  # of each writer
    looked_at: list[int]  # ranks of which messages are counted: the heaviest, others at even distances, and busy nodes
    sent: list[dict[str, Sent]]  # of these, by call
    nodes: list[range]  # ranks of these nodes
    relaxed: float  # Σ_l max over ranks of cells relaxed in a cycle, as a part of those of all on one rank
    walls: list[Walls]  # of ranks that were gone through, all or `WALLS` of them
    without: Choices
    exchange: Exchange  # between servers of particles and owners of cells
    between: Leaving  # particles that come to other servers in a step
    estimates: float  # cycles per solve that find the error of the mesh, besides those that improve the potential
    overlapping: float  # the part of steps that deposit particles while others are under way
    met: Array  # (ranks,) other ranks that one meets, of all levels together
    seconds: float  # of the processor, in which the plan was made

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

    def all_cycles(self, cycles: float) -> float:
        """Return the cycles of a solve that improves the potential by so many."""
        return cycles + (self.estimates if cycles > 0 else 0)

    @property
    def wall_work(self) -> tuple[float, float, float]:
        """The most patches of a rank at open walls, and of their interactions with nodes and with leaves."""
        rows = np.array([(one.patches, one.interactions, one.near) for one in self.walls], dtype=float)
        return tuple(rows.max(axis=0).tolist())

    def most(self, call: str, what: str) -> float:
        """Return the most of messages, bytes or collectives by a call, over the ranks that were looked at; for open walls over
        all that were gone through for them."""
        traffic = (
            [one.traffic for one in self.walls] if call == "open walls" else [of[call].traffic for of in self.sent]
        )
        return max(getattr(of, what) for of in traffic)

    def neighbours(self) -> int:
        """Return the most ranks that one sends to in a cycle."""
        return max(len(of["cycle"].to) for of in self.sent)

    def at_most(self, call: str) -> float:
        """Return how many messages a rank that was not looked at sends by a call at most, if it sends no more for each rank
        that it meets than the worst of those that were."""
        others = np.delete(self.met, self.looked_at)
        each = max(
            of[call].traffic.messages / max(self.met[rank], 1)
            for rank, of in zip(self.looked_at, self.sent, strict=True)
        )
        return float(each * others.max(initial=0))

    def leaving(self, call: str, ranks_per_node: int) -> float:
        """Return the most bytes that leave a node by a call, of the nodes that were looked at, as if they had so many ranks; of
        all nodes for "announce", "migrate", and for what servers of particles and owners of cells send each other."""
        if call == "announce":
            return float(self.between.of_nodes(ranks_per_node, self.between.announced).max())
        if call == "migrate":
            bytes_ = sum(of[call].traffic.bytes for of in self.sent)
            each = bytes_ / max(float(self.between.sent[self.looked_at].sum()), 1.0)  # of a particle
            return each * float(self.between.of_nodes(ranks_per_node).max())
        shared = {"deposit": self.exchange.deposit, "gather": self.exchange.gather}.get(call)
        left = {
            rank: (of[call] - shared(rank) if shared else of[call]).leaving(rank, ranks_per_node)
            for rank, of in zip(self.looked_at, self.sent, strict=True)
        }
        busiest = max(sum(left[rank] for rank in node) / len(node) for node in self.nodes)
        return ranks_per_node * busiest + (self.exchange.leaving(call, ranks_per_node) if shared else 0.0)


def imbalance(cells: Array) -> float:
    """Return Σ_l max ÷ Σ_l mean over ranks of cells (levels, ranks): levels are visited in turn."""
    return float(cells.max(axis=1).sum() / cells.mean(axis=1).sum())


@dataclass(frozen=True)
class Cycles:
    """What a cycle takes of all ranks."""

    messages: Array  # (ranks,)
    bytes: Array  # (ranks,)
    relaxed: Mapping[int, float]  # by level, the base being 0: the most cells of a rank
    sweeps: Mapping[int, int]  # by level

    @classmethod
    def of(cls, plans: _native.CyclePlans, ranks: int) -> Cycles:
        """Return those of so many ranks, gone through one after the other."""
        messages, volume = np.zeros(ranks), np.zeros(ranks)
        relaxed, sweeps = dict[int, float](), dict[int, int]()
        for rank in range(ranks):
            for level in plans.work(rank):
                messages[rank] += level.messages
                volume[rank] += level.bytes
                relaxed[level.level] = max(relaxed.get(level.level, 0.0), level.relaxed)
                sweeps[level.level] = level.sweeps
        return cls(messages, volume, relaxed, sweeps)


def estimates_per_solve(scene: Scene) -> float:
    """Return for what part of the solves of a run the error of the mesh is estimated."""
    if scene.solver.tolerance != "discretization":
        return 0.0
    refinement = scene.refinement
    anew = refinement.regrid_every if refinement.follows and refinement.regrid_every > 0 else math.inf
    return 1 / min(anew, _native.SOLVES_PER_ESTIMATE)


def overlapping_steps(scene: Scene) -> float:
    """Return the part of steps that deposit particles of a rank while others are under way to it."""
    kinds, steps = len({bunch.species for bunch in scene.bunches}), max(scene.refinement.regrid_every, 1)
    return sum(deposits_meanwhile(scene, kinds, step) for step in range(steps)) / steps


def cycles_per_solve(scene: Scene) -> float:
    """Return how many cycles improve the potential: where it is extrapolated one, and two where the error is estimated."""
    return 1 + estimates_per_solve(scene) if scene.extrapolates_potential else 2.0


def spread_out(ranks: int, most: int) -> list[int]:
    """Return all ranks, or so many at even distances."""
    return list(range(ranks)) if ranks <= most else [ranks * n // most for n in range(most)]


def _values_of(ranks: int, values: Mapping[int, float]) -> Array:
    out = np.zeros(ranks)
    out[list(values)] = list(values.values())
    return out


def has_open_walls(mesh: Hierarchy) -> bool:
    return any("open" in faces for faces in mesh.domain.boundary)


def walls_of(found: Mapping[str, Any]) -> Walls:
    """Return what `OpenWallPlans.counts` gives of a rank; what collectives bring counts as bytes."""
    collectives = found["collectives"]
    traffic = Traffic(found["messages"], found["bytes"] + sum(collectives), len(collectives))
    return Walls(found["patches"], found["far"], found["near"], traffic)


class Planner:
    """A scene with its mesh and the particles of each brick, from which plans for any number of ranks follow.

    The mesh is that of the start. Particles are where they are after so many `steps`, as far as a random walk takes them.
    """

    def __init__(self, scene: Scene, say: Callable[[str], None] = lambda text: None, steps: int = 0) -> None:
        self.scene, self._say, since = scene, say, time.process_time()
        self._clouds = clouds_of(scene)
        say("mesh from the densities of the bunches")
        self.mesh, self.notes = planned_mesh(scene, self._clouds)
        say("particles of each brick")
        self._clouds = clouds_of(scene, steps) if steps > 0 else self._clouds
        self._bricks = bricks_of(self._clouds, self.mesh)
        self._sample = sample(scene, SAMPLE)
        self.seconds = time.process_time() - since  # of the processor, before the first plan

    def plans(self, ranks: Sequence[int], looked_at: int = LOOKED_AT) -> Iterator[Plan]:
        """Yield a plan for each number of ranks."""
        for number in ranks:
            yield self.plan(number, looked_at)

    def plan(self, ranks: int, looked_at: int = LOOKED_AT) -> Plan:
        """Return the plan for so many ranks; messages of at most `looked_at` of them are counted."""
        scene, since = self.scene, time.process_time()
        self._say(f"{ranks} ranks: boxes and owners")
        mesh = distributed(self.mesh, ranks)
        closed, cells = without_open_walls(mesh), cells_of_ranks(mesh)
        held = served(self._on(mesh), mesh, scene.particles.interface == "matched")
        neighbours = neighbours_of_ranks(mesh)
        met = neighbours.sum(axis=0)
        moved = moves(held.bricks, mesh, displacements(scene, self._sample))
        between = leaving(moved, held, ranks)
        self._say(f"{ranks} ranks: cycles")
        cycle_of = cycle_plans(scene, closed)
        cycles = Cycles.of(cycle_of, ranks)
        self._say(f"{ranks} ranks: open walls")
        walls_at = self._walls(mesh)
        walls = {rank: walls_at(rank) for rank in spread_out(ranks, WALLS)}
        busy = [
            cycles.messages,
            cycles.bytes,
            _values_of(ranks, {rank: of.traffic.messages for rank, of in walls.items()}),
        ]
        chosen = chosen_ranks(
            np.vstack(
                [*busy, met, neighbours, cells, held.particles, held.exchange.messages, between.messages, between.sent]
            ),
            looked_at,
        )
        other = moved_on(closed)
        looks: dict[int, dict[str, Sent]] = {}

        def look(rank: int) -> dict[str, Sent]:
            if rank not in looks:
                self._say(f"{ranks} ranks: messages of rank {rank}, the {len(looks) + 1}th of about {len(chosen)}")
                walls[rank] = walls[rank] if rank in walls else walls_at(rank)
                mesh_there = seen_by(closed, rank)
                looks[rank] = self._look(mesh_there, held, seen_by(other, rank), walls[rank], cycle_of.work(rank))
            return looks[rank]

        nodes = []
        if (
            ranks > NODE
        ):  # of the rank with the most bytes that leave its node in a cycle, with the most bytes, and most leavers
            far = max(chosen, key=lambda rank: look(rank)["cycle"].leaving(rank, NODE)) // NODE
            most = int(np.bincount(np.arange(ranks) // NODE, cycles.bytes).argmax())
            left = int(between.of_nodes(NODE).argmax())
            nodes = [range(node * NODE, min(node * NODE + NODE, ranks)) for node in sorted({far, most, left})]
        for rank in sorted({*chosen, *itertools.chain.from_iterable(nodes)}):
            look(rank)
        return Plan(
            ranks,
            cells,
            np.array([np.bincount(mesh.owners(level), minlength=ranks) for level in range(mesh.levels)]),
            faces_of_ranks(mesh),
            held.particles,
            np.bincount(held.pairs[:, 1], minlength=ranks),
            moved.moved,
            isinstance(scene.motion, RandomWalk),
            *self._memory(mesh, cells, held),
            self._checkpoint(cells, held),
            list(looks),
            list(looks.values()),
            nodes or [range(ranks)],
            self._relaxed(cycles),
            list(walls.values()),
            self._without(mesh, held),
            held.exchange,
            between,
            estimates_per_solve(scene),
            overlapping_steps(scene),
            met,
            time.process_time() - since,
        )

    def _on(self, mesh: Hierarchy) -> Bricks:
        """Return the bricks of a mesh, whose boxes may be cut in another way for more ranks."""
        same = all(np.array_equal(mesh.boxes(level), self.mesh.boxes(level)) for level in range(mesh.levels))
        return self._bricks if same else bricks_of(self._clouds, mesh)

    def _look(
        self, mesh: Hierarchy, held: Served, other: Hierarchy, walls: Walls, cycle: list[_native.LevelWork]
    ) -> dict[str, Sent]:
        """Return what a virtual rank, that of the mesh, sends and relaxes."""
        rank = mesh.comm.rank
        mine, each = particles_of(rank, held, mesh, self._sample, MOVED)
        sent = counts(self.scene, mesh, mine, held.servers, other, cycle)
        sent["migrate"] = sent["migrate"].times(each)
        sent["deposit"] += held.exchange.deposit(rank)
        sent["gather"] += held.exchange.gather(rank)
        sent["open walls"] = Sent(walls.traffic)
        return sent

    def _relaxed(self, cycles: Cycles) -> float:
        """Return Σ_l max over ranks of the cells relaxed in a cycle, as a part of those of the whole mesh on one rank."""
        cells = dict(enumerate(self.mesh.cells(level) for level in range(self.mesh.levels)))
        cells |= {-number: n for number, n in enumerate(cells_below(self.scene), start=1)}
        return sum(cycles.relaxed.values()) / sum(cells[level] * sweeps for level, sweeps in cycles.sweeps.items())

    # ---- open walls ----

    def _walls(self, mesh: Hierarchy) -> Callable[[int], Walls]:
        """Return what gives the part of a rank in the potential at open walls."""
        if not has_open_walls(mesh):
            return lambda rank: Walls(0, 0, 0, Traffic())
        plans, charged = _native.OpenWallPlans(mesh.native), charged_regions(self._clouds, mesh)
        return lambda rank: walls_of(plans.counts(rank, charged))

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
        return full, none + PLACING * held.particles

    def _checkpoint(self, cells: Array, held: Served) -> list[Load]:
        """Return what each writer of a checkpoint does."""
        columns = [*ROW_BYTES, *([LAGGING_BYTES] if isinstance(self.scene.motion, Leapfrog) else [])]
        particles = np.repeat(np.rint(held.particles)[:, None], len(columns), axis=1)
        fields = len([*FIELDS, *([BEFORE] if self.scene.extrapolates_potential else [])])
        rows = np.hstack([np.repeat(cells.T, fields, axis=1), particles]).astype(np.int64)
        sizes = [8] * (len(cells) * fields) + columns
        return checkpoint_loads(rows, sizes, writers_of(self.scene))

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


def faces_of_ranks(mesh: Hierarchy) -> np.ndarray:
    """Return the cells on the six faces of the boxes of each level on each rank, int64 (levels, ranks)."""

    def of_boxes(boxes: np.ndarray) -> np.ndarray:
        x, y, z = (boxes[:, 3 + axis].astype(np.int64) - boxes[:, axis] + 1 for axis in range(3))
        return 2 * (x * y + y * z + z * x)

    rows = [np.bincount(mesh.owners(l), of_boxes(mesh.boxes(l)), mesh.comm.size) for l in range(mesh.levels)]
    return np.array(rows).astype(np.int64)

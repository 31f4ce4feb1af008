"""What ranks that do not exist would hold and send of a scene: a plan for each number of them, made by one process."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from ..mesh.hierarchy import Hierarchy
from ..particles.particles import Particles
from ..run.memory import run_memory
from ..scene.scene import Scene
from .densities import clouds_of, particles_of_boxes, planned_mesh
from .measure import cells_of_ranks, wall_cells
from .virtual_ranks import Sent, chosen_ranks, counts, distributed, sample, without_open_walls

SAMPLE = 10**6  # particles that are gone through for the messages of a migration
LOOKED_AT = 24  # ranks of which messages are counted
BOX_BYTES = 650  # metadata of a box on every rank: measured

# What today's code has no plan of that a virtual rank can go through.
MISSING = (
    "particles live on the rank of their box: replaced once particles have a distribution of their own",
    "what finds the potential at open walls: its time is modelled by the base cells at walls, its messages are not counted",
    "a regrid: the messages to a mesh of other owners are not counted, those of the same mesh are",
    "a checkpoint: bytes of a rank only, from the memory of its fields and particles; not how they reach the writers",
    "the moments that diagnostics gather",
)


@dataclass(frozen=True)
class Plan:
    """A scene on so many ranks."""

    ranks: int
    cells: np.ndarray  # (levels, ranks)
    boxes: np.ndarray  # (levels, ranks)
    particles: np.ndarray  # (ranks,)
    wall_cells: int  # base cells at open walls
    memory: np.ndarray  # (ranks,) bytes at the fullest
    start_memory: np.ndarray  # (ranks,) bytes while particles are made and placed
    looked_at: list[int]  # ranks of which messages are counted: the heaviest, and others at even distances
    sent: list[dict[str, Sent]]  # of these, by call

    @property
    def cell_imbalance(self) -> float:
        """Σ_l max ÷ Σ_l mean over ranks of the cells of level l."""
        return float(self.cells.max(axis=1).sum() / self.cells.mean(axis=1).sum())

    @property
    def particle_imbalance(self) -> float:
        """Max ÷ mean over ranks."""
        return float(self.particles.max() / self.particles.mean()) if self.particles.any() else 1.0

    def most(self, call: str, what: str) -> float:
        """Return the most of messages, bytes or collectives by a call, over the ranks that were looked at."""
        return max(getattr(of[call].traffic, what) for of in self.sent)

    def neighbours(self) -> int:
        """Return the most ranks that one sends to in a cycle."""
        return max(of["cycle"].neighbours for of in self.sent)


class Planner:
    """A scene with its mesh and the particles of each box, from which plans for any number of ranks follow."""

    def __init__(self, scene: Scene, say: Callable[[str], None] = lambda text: None) -> None:
        self.scene, self._say = scene, say
        self._clouds = clouds_of(scene)
        say("mesh from the densities of the bunches")
        self.mesh, self.notes = planned_mesh(scene, self._clouds)
        say("particles of each box")
        self._particles = particles_of_boxes(self._clouds, self.mesh)
        self._closed = without_open_walls(self.mesh)
        self._sample: tuple[Particles, float] = sample(scene, SAMPLE)

    def plans(self, ranks: Sequence[int], looked_at: int = LOOKED_AT) -> Iterator[Plan]:
        """Yield a plan for each number of ranks."""
        for number in ranks:
            yield self.plan(number, looked_at)

    def plan(self, ranks: int, looked_at: int = LOOKED_AT) -> Plan:
        """Return the plan for so many ranks; messages of at most `looked_at` of them are counted."""
        mesh = distributed(self._closed, ranks)
        cells = cells_of_ranks(mesh)
        particles = particles_of_ranks(mesh, self._on(mesh))
        chosen = chosen_ranks(np.vstack([cells, particles]), looked_at)
        sent = []
        for number, rank in enumerate(chosen, start=1):
            self._say(f"{ranks} ranks: messages of rank {rank}, {number} of {len(chosen)}")
            sent.append(counts(self.scene, mesh.seen_by(rank), *self._sample))
        boxes = np.array([np.bincount(mesh.owners(level), minlength=ranks) for level in range(mesh.levels)])
        return Plan(ranks, cells, boxes, particles, wall_cells(self.mesh), *self._memory(mesh, particles), chosen, sent)

    def _on(self, mesh: Hierarchy) -> list[np.ndarray]:
        """Return the particles of the boxes of a mesh, which may be cut in another way for more ranks."""
        same = all(np.array_equal(mesh.boxes(level), self.mesh.boxes(level)) for level in range(mesh.levels))
        return self._particles if same else particles_of_boxes(self._clouds, mesh)

    def _memory(self, mesh: Hierarchy, particles: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return bytes of each rank at the fullest of a run, and at its start, when all particles pass through base boxes."""
        levels = [mesh.boxes(level) for level in range(mesh.levels)]
        base = Hierarchy(mesh.comm, mesh.domain, (), mesh.max_grid_size, mesh.blocking_factor)
        at_start = particles_of_ranks(base, particles_of_boxes(self._clouds, base))
        whole = run_memory(self.scene, levels, 0, 1)
        fixed = whole.pop("processes") + whole.pop("pictures") + BOX_BYTES * sum(map(len, levels))
        share = cells_of_ranks(mesh).sum(axis=0) / sum(mesh.cells(level) for level in range(mesh.levels))
        each = run_memory(self.scene, levels, 10**6, 1)["particles"] / 10**6
        return fixed + share * sum(whole.values()) + each * particles, fixed + each * at_start


def particles_of_ranks(mesh: Hierarchy, particles: Sequence[np.ndarray]) -> np.ndarray:
    """Return the particles of each rank, (ranks,), given those in each box: they live with the box."""
    return sum(
        (np.bincount(mesh.owners(level), particles[level], mesh.comm.size) for level in range(mesh.levels)),
        np.zeros(mesh.comm.size),
    )

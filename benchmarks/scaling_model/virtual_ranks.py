"""What ranks that do not exist would send: the code itself is gone through on virtual ranks, and its messages are counted.

So counts come from the plans that a run uses; there is no second copy of them here.
"""

from __future__ import annotations

import contextlib
from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np
from mpi4py import MPI

from amrpic import _native
from amrpic.mesh.domain import Domain
from amrpic.mesh.field import Field, VectorField
from amrpic.mesh.hierarchy import Hierarchy
from amrpic.parallel import traffic
from amrpic.particles.clouds import Clouds
from amrpic.particles.particles import Particles
from amrpic.pic.initial_particles import make_particles
from amrpic.scene.bunches import Train
from amrpic.scene.motion import Leapfrog, RandomWalk
from amrpic.scene.scene import Scene
from amrpic.scene.solver_options import SolverOptions
from amrpic.stages.deposit import deposit
from amrpic.stages.diagnostics import measure, moments
from amrpic.stages.gather import compensate, gather
from amrpic.stages.migrate import NONE, migrate, migrate_without
from amrpic.stages.poisson import PoissonSolver
from amrpic.stages.push import push, random_walk
from amrpic.stages.regrid import carry_over
from amrpic.units import SPEED_OF_LIGHT
from exact.virtual_rank import VirtualRank

from .bricks import Bricks, Served
from .sent import Sent

DENSITY = 1e-9  # C/m³, everywhere: any will do, since no answer is looked at
OF_NORM = 1  # collective calls of the norm of a residual
CALLS = ("set-up", "deposit", "solve", "cycle", "gather", "announce", "migrate", "output", "open walls", "regrid")


class Counter:
    """Counts what virtual ranks send, by what they do."""

    def __init__(self) -> None:
        self.sent: dict[str, Sent] = {}

    @contextlib.contextmanager
    def __call__(self, call: str) -> Iterator[None]:
        _native.take_destinations()
        before = traffic()
        yield
        self.sent[call] = Sent(traffic() - before, _native.take_destinations())


def distributed(mesh: Hierarchy, ranks: int) -> Hierarchy:
    """Return a mesh as the first of so many virtual ranks has it; others by its `seen_by`. Cut and shared out by the code."""
    boxes = [mesh.boxes(level) for level in range(1, mesh.levels)]
    return Hierarchy(VirtualRank(0, ranks), mesh.domain, boxes, mesh.max_grid_size, mesh.blocking_factor)


def sample(scene: Scene, number: int) -> Particles:
    """Return about so many particles of a scene, made as a run makes them."""
    part = min(1.0, number / max(scene.particle_count(), 1))
    bunches = [
        bunch.model_copy(update={"particles": -int(-bunch.number * part // 1)}) if isinstance(bunch, Train) else bunch
        for bunch in scene.bunches
    ]
    return make_particles(MPI.COMM_SELF, scene.model_copy(update={"bunches": bunches}))


def displacements(scene: Scene, particles: Particles) -> np.ndarray:
    """Return by how much a step without forces displaces particles, (n, 3) m."""
    match scene.motion:
        case RandomWalk(amplitude=amplitude):
            return random_walk(particles, amplitude, scene.seed, 1).position - particles.position
        case Leapfrog(dt=float(dt)):
            momentum, mass = particles.momentum, particles.mass
            gamma = np.sqrt(1 + (momentum**2).sum(axis=1) / (mass * SPEED_OF_LIGHT) ** 2)
            return dt * momentum / (mass * gamma)[:, None]
    return np.zeros_like(particles.position)


def _spread_over(
    bricks: Bricks, chosen: np.ndarray, part: float, mesh: Hierarchy, like: Particles, rng: np.random.Generator
) -> Particles:
    """Return about this part of the particles of some bricks. They are spread evenly over each, with any ids; momenta are those
    of `like`."""
    which = np.repeat(chosen, rng.poisson(bricks.particles[chosen] * part))
    corners = bricks.cells[which]
    cell = corners[:, :3] + rng.random((len(which), 3)) * (corners[:, 3:] - corners[:, :3] + 1)
    spacings = np.array([mesh.spacing(level) for level in range(mesh.levels)])
    taken = rng.integers(0, max(len(like), 1), len(which))
    equal = like.equal_weights and len(like) > 0
    return Particles(
        np.array(mesh.domain.lower) + cell * spacings[bricks.rows[which, 0]],
        like.momentum[taken],
        np.broadcast_to(like.weight[0], len(which)) if equal else like.weight[taken],
        rng.integers(0, max(round(bricks.total), 1), len(which)),
        like.species,
    )


def particles_of(rank: int, held: Served, mesh: Hierarchy, like: Particles, most: int) -> tuple[Particles, float]:
    """Return about `most` particles in the bricks of which a rank serves some, and for how many of its own each stands.

    They are spread evenly over each brick, with any ids, so that some of them are others'; momenta are those of `like`.
    """
    bricks = held.pairs[held.pairs[:, 1] == rank, 0]
    part = min(1.0, most / max(held.bricks.particles[bricks].sum(), 1.0))
    made = _spread_over(held.bricks, bricks, part, mesh, like, np.random.default_rng(rank))
    mine, _ = migrate(made, mesh, held.servers)  # where the others go does not matter
    return mine, float(held.particles[rank]) / max(len(mine), 1)


def counts(
    scene: Scene,
    mesh: Hierarchy,
    particles: Particles,
    servers: np.ndarray,
    other: Hierarchy,
    work: Sequence[_native.LevelWork],
) -> dict[str, Sent]:
    """Return what a virtual rank, that of the mesh, sends by each of CALLS.

    "cycle" is one cycle of the solver with the residual after it, "solve" all else that a solve sends, without what finds the
    potential at open walls; "regrid" carries the potential over to the `other` mesh; "migrate" what follows a step without
    forces, of `particles` of this rank, and "announce" what says ahead of it how many come to which bricks. In "deposit" and
    "gather" is not what passes because of others' bricks: see `bricks`.
    `work` is that of a cycle of this rank.
    """
    count, clouds = Counter(), scene.particles.clouds
    none = particles.select(slice(0))
    with count("set-up"):
        here, _ = migrate(none, mesh, servers)
        solver = PoissonSolver(mesh, options=_options(scene, cycles=1))
    with count("deposit"):
        deposit(here, mesh, clouds)
    rho = Field(mesh)
    for level in range(mesh.levels):
        rho.array(level)[:] = DENSITY
    with count("solve"):
        phi, _ = solver.solve(rho)
    solver = PoissonSolver(mesh, options=_options(scene, cycles=2))
    with count("cycle"):
        phi, _ = solver.solve(rho)
    with count("gather"):
        efield = solver.deferred_field(phi, covered=clouds.covered)
        compensate(efield, rho, clouds)
        gather(efield, here, clouds)
    moved = _moved(scene, particles, efield, clouds)
    with count("announce"):
        _native.Migration(mesh.particle_mesh, servers, *moved.with_own_weights().arrays, NONE, True)
    with count("migrate"):
        migrate_without(moved, mesh, NONE, servers)
    count.sent["migrate"] = count.sent["migrate"] - count.sent["announce"]
    with count("output"):
        measure(here, moments(mesh.comm, here), (0, 0.0), rho, phi, efield, {})
    with count("regrid"):
        carry_over(phi, other)
    count.sent["cycle"] = count.sent["cycle"] - count.sent["solve"]
    count.sent["solve"] = count.sent["solve"] - count.sent["cycle"]
    # Whether a solve looks at the rounding floor besides depends on its numbers, which are wrong here.
    collectives = sum(level.collectives for level in work) + (OF_NORM if mesh.comm.size > 1 else 0)
    cycle = count.sent["cycle"]
    count.sent["cycle"] = replace(cycle, traffic=replace(cycle.traffic, collectives=collectives))
    return count.sent


def cycle_work(scene: Scene, mesh: Hierarchy) -> list[_native.LevelWork]:
    """Return what a cycle takes of a rank, that of the mesh, by levels."""
    solver = scene.solver
    return _native.cycle_work(mesh.native, *solver.both_sweeps, solver.screening, solver.stretch)


def cycle_plans(scene: Scene, mesh: Hierarchy) -> _native.CyclePlans:
    """Return what gives the same of each rank, for the mesh of a virtual one."""
    solver = scene.solver
    return _native.CyclePlans(mesh.native, *solver.both_sweeps, solver.screening, solver.stretch)


def _moved(scene: Scene, particles: Particles, efield: VectorField, clouds: Clouds) -> Particles:
    """Return the particles after a step without forces."""
    match scene.motion:
        case RandomWalk(amplitude=amplitude):
            return random_walk(particles, amplitude, scene.seed, 1)
        case Leapfrog(dt=float(dt)):
            return push(efield, particles, 0.0, 0.0, dt, clouds)
    return particles


def _options(scene: Scene, cycles: int) -> SolverOptions:
    return scene.solver.model_copy(update={"tolerance": 1e-300, "max_cycles": cycles})


def moved_on(mesh: Hierarchy) -> Hierarchy:
    """Return the mesh with its refined boxes one block further along x, as a regrid may find them; the mesh itself where they
    would leave the domain."""
    step, out = mesh.blocking_factor, []
    for level in range(1, mesh.levels):
        boxes = mesh.boxes(level).copy()
        boxes[:, [0, 3]] += step << (level - 1)
        out.append(boxes)
    leaves = [boxes[:, 3].max() >= mesh.domain.cells[0] << level for level, boxes in enumerate(out, start=1)]
    if not out or any(leaves):
        return mesh
    return Hierarchy(mesh.comm, mesh.domain, out, mesh.max_grid_size, mesh.blocking_factor)


def without_open_walls(mesh: Hierarchy) -> Hierarchy:
    """Return a mesh of one rank between Dirichlet walls where it has open ones.

    What finds the potential at open walls needs the charges of all ranks, which a virtual one does not have.
    """
    boundary = tuple(tuple("dirichlet" if face == "open" else face for face in faces) for faces in mesh.domain.boundary)
    domain = Domain(mesh.domain.lower, mesh.domain.upper, mesh.domain.cells, boundary)  # type: ignore[arg-type]
    boxes = [mesh.boxes(level) for level in range(1, mesh.levels)]
    return Hierarchy(mesh.comm, domain, boxes, mesh.max_grid_size, mesh.blocking_factor)


def chosen_ranks(loads: np.ndarray, most: int) -> list[int]:
    """Return at most so many ranks: those with the largest loads (kinds, ranks), others at even distances."""
    ranks = loads.shape[1]
    if ranks <= most:
        return list(range(ranks))
    heavy = [rank for row in np.argsort(-loads, axis=1)[:, : most // (2 * len(loads)) + 1] for rank in row.tolist()]
    even = np.linspace(0, ranks - 1, most).astype(int).tolist()
    return sorted(list(dict.fromkeys([*heavy, *even]))[:most])

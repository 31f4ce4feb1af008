"""What ranks that do not exist would send: the code itself is gone through on virtual ranks, and its messages are counted.

So counts come from the plans that a run uses; there is no second copy of them here.
"""

from __future__ import annotations

import contextlib
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace

import numpy as np
from mpi4py import MPI

from .. import _native
from ..mesh.domain import Domain
from ..mesh.field import Field, VectorField
from ..mesh.hierarchy import Hierarchy
from ..parallel import Traffic, VirtualRank, traffic
from ..particles.clouds import Clouds
from ..particles.particles import Particles
from ..run.initial_particles import make_particles
from ..scene.bunches import Train
from ..scene.motion import Leapfrog, RandomWalk
from ..scene.scene import Scene
from ..scene.solver_options import SolverOptions
from ..stages.deposit import deposit
from ..stages.diagnostics import measure, moments
from ..stages.gather import gather
from ..stages.migrate import migrate
from ..stages.poisson import PoissonSolver
from ..stages.push import push, random_walk
from ..stages.regrid import Regridding, carry_over, regrid

DENSITY = 1e-9  # C/m³, everywhere: any will do, since no answer is looked at
CALLS = ("set-up", "deposit", "solve", "cycle", "gather", "migrate", "output", "regrid")


@dataclass(frozen=True)
class Sent:
    """What a rank sends by one call, and to how many others."""

    traffic: Traffic
    neighbours: int = 0


class Counter:
    """Counts what virtual ranks send, by what they do."""

    def __init__(self) -> None:
        self.sent: dict[str, Sent] = {}

    @contextlib.contextmanager
    def __call__(self, call: str) -> Iterator[None]:
        _native.take_destinations()
        before = traffic()
        yield
        self.sent[call] = Sent(traffic() - before, len(_native.take_destinations()))


def distributed(mesh: Hierarchy, ranks: int) -> Hierarchy:
    """Return a mesh as the first of so many virtual ranks has it; others by its `seen_by`. Cut and shared out by the code."""
    boxes = [mesh.boxes(level) for level in range(1, mesh.levels)]
    return Hierarchy(VirtualRank(0, ranks), mesh.domain, boxes, mesh.max_grid_size, mesh.blocking_factor)


def sample(scene: Scene, number: int) -> tuple[Particles, float]:
    """Return about so many particles of a scene, made as a run makes them, and how many of the run each stands for."""
    total = scene.particle_count()
    part = min(1.0, number / max(total, 1))
    bunches = [
        bunch.model_copy(update={"particles": -int(-bunch.number * part // 1)}) if isinstance(bunch, Train) else bunch
        for bunch in scene.bunches
    ]
    particles = make_particles(MPI.COMM_SELF, scene.model_copy(update={"bunches": bunches}))
    return particles, total / max(len(particles), 1)


def counts(scene: Scene, mesh: Hierarchy, particles: Particles, each: float) -> dict[str, Sent]:
    """Return what a virtual rank, that of the mesh, sends by each of CALLS.

    "cycle" is one cycle of the solver with the residual after it, "solve" all else that a solve sends, without what finds the
    potential at open walls; "regrid" what a regrid to the same mesh sends; "migrate" what follows a step without forces.
    `particles`, of all ranks, are a sample of which each stands for so many.
    """
    count, clouds = Counter(), Clouds(scene.particles.shape, matched=scene.particles.interface == "matched")
    none = particles.select(slice(0))
    with count("set-up"):
        here, _ = migrate(none, mesh)
        solver = PoissonSolver(mesh, options=_options(scene, cycles=0))
    with count("deposit"):
        deposit(here, mesh, clouds)
    rho = Field(mesh)
    for level in range(mesh.levels):
        rho.array(level)[:] = DENSITY
    with count("solve"):
        phi, _ = solver.solve(rho)
    solver = PoissonSolver(mesh, options=_options(scene, cycles=1))
    with count("cycle"):
        phi, _ = solver.solve(rho)
    with count("gather"):
        efield = solver.deferred_field(phi, covered=clouds.covered)
        gather(efield, here, clouds)
    mine, _ = migrate(particles, mesh)  # all that live here; where the others go does not matter
    moved = _moved(scene, mine, efield, clouds)
    with count("migrate"):
        migrate(moved, mesh)
    with count("output"):
        measure(here, moments(MPI.COMM_SELF, here), none, rho, phi, efield, {})  # what moments gather is not counted
    with count("regrid"):
        settings = Regridding(mesh.levels, scene.refinement.buffer, scene.refinement.nesting)
        regrid(mesh, [], settings, [mesh.boxes(level) for level in range(1, mesh.levels)])
        carry_over(phi, mesh)
    return _by_cycle(count.sent, each)


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


def _by_cycle(sent: Mapping[str, Sent], each: float) -> dict[str, Sent]:
    """Return the same where "cycle" is what a solve of one cycle sends beyond one of none."""
    out, leave = dict(sent), sent["migrate"]
    out["cycle"] = replace(sent["cycle"], traffic=sent["cycle"].traffic - sent["solve"].traffic)
    out["migrate"] = replace(leave, traffic=replace(leave.traffic, bytes=int(leave.traffic.bytes * each)))
    return out


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

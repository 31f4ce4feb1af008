"""The flight of particles from one step to the next, and the records of what they meet on it."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np
from mpi4py import MPI

from .. import _native
from ..errors import ParticleError
from ..mesh.domain import FACES
from ..mesh.hierarchy import Hierarchy
from ..mesh.window import Window
from ..particles.particles import Particles, cut
from ..scene.obstacles import aperture_names
from ..scene.scene import Scene
from ..stages.deposit import Deposition
from ..stages.encounters import MOST_PERIODS, Encounters, Flights
from ..stages.migrate import arranged, migrate_without, share_out, weights
from .leapfrog import kick
from .plan import Plan
from .records import Record
from .state import State

PORTION = 2**15  # particles of a rank that it sends to their servers at a time
NONE = np.zeros(0, dtype=np.int64)
NOTHING = Encounters(NONE, NONE, np.zeros(0), np.zeros((0, 3)), NONE)


def causes(scene: Scene) -> tuple[str, ...]:
    """Return the names of all where particles of a scene are lost: faces of the domain, then apertures."""
    return (*FACES, *aperture_names(scene.apertures))


def place(
    bunches: list[Particles], base: Hierarchy, window: Window, plan: Plan, start: float
) -> tuple[Particles, Record, Record]:
    """Return the particles of bunches at their start (s), and records of losses, of those outside, and of screens. Collective.

    It is known who serves which before any particle moves. They go there in portions, for which the list is emptied, so that no
    rank holds many more than its part at any time.
    """
    scene, species = plan.scene, bunches[0].species
    counted = [weights(bunch, base) for bunch in bunches]
    servers = share_out(plan.comm, *(np.concatenate(column) for column in zip(*counted, strict=True)))
    lost, portions = Record.empty(species, causes(scene)), []
    for made in _portions(plan.comm, bunches):
        here, outside, _ = migrate_without(made, base, NONE, servers)
        portions.append(here)
        left = Flights(made.position, made.position, base.domain, window, window).exits(outside)
        momentum = window.to_laboratory(made.momentum[outside])
        lost = lost.joined(_record(left, momentum, made, np.full(len(left), start), causes(scene)))
        del made, here  # else they live beside what follows
    particles = portions[0] if len(portions) == 1 else arranged(portions, base, servers)
    return particles, lost, Record.empty(species, [screen.name for screen in scene.screens])


def _portions(comm: MPI.Comm, bunches: list[Particles]) -> Iterator[Particles]:
    """Yield the particles of bunches in portions, as many on all ranks; the list is emptied. Collective."""
    counts = comm.allreduce(np.array([len(bunch) for bunch in bunches])) // comm.size
    waiting, count = [], 0
    for of_bunch in counts.tolist():
        waiting.append(bunches.pop(0))
        count += of_bunch
        if count >= PORTION or not bunches:
            portions, count = cut(waiting, count // PORTION + 1), 0
            while portions:
                yield portions.pop(0)


def deposits_meanwhile(scene: Scene, kinds: int, step: int) -> bool:
    """Whether particles of so many kinds are deposited in a step while others are under way to their rank.

    Not where the mesh may change first, of several species, whose charges are found from ids that are under way, and by kernels
    that deposit all at once.
    """
    return kinds == 1 and scene.solver.backend != "kokkos" and not scene.refinement.regrids_at(step)


def fly(
    state: State, moved: Particles, window: Window, plan: Plan
) -> tuple[Particles, Deposition | None, Record, Record]:
    """Return the particles of a state where they have `moved`, and its records of losses and screens with those of the flight.

    Collective. Each flight is a straight line in the laboratory; those that touch an aperture end there. `window`: where the
    mesh is then. The deposit of those that stay on their rank, if it `deposits_meanwhile`, is returned as it has begun.
    """
    scene, hierarchy = plan.scene, state.hierarchy
    flights = Flights(state.particles.position, moved.position, hierarchy.domain, state.window, window)
    if (scene.apertures or scene.screens) and any(hierarchy.domain.periodic):
        _require_followable(plan.comm, flights)
    stopped = flights.losses(plan.apertures) if scene.apertures else NOTHING
    servers = state.particles.sorted_on(hierarchy).servers
    begun: list[Deposition] = []

    def begin_deposit(here: Particles, migration: _native.Migration) -> None:
        with plan.clock("deposit"):
            begun.append(Deposition(here, hierarchy, plan.clouds))
            begun[0].begin(migration)

    begins = deposits_meanwhile(scene, len(moved.species.kinds), state.step + 1)
    meanwhile = (begin_deposit,) if begins else ()
    particles, outside, missing = migrate_without(moved, hierarchy, stopped.flight, servers, True, *meanwhile)
    deposition = begun[0] if begun else None
    lost = replace(stopped, what=stopped.what + len(FACES))
    if len(outside) > 0:
        lost = lost.joined(flights.exits(outside))
    planes, screens = [screen.z for screen in scene.screens], [screen.name for screen in scene.screens]
    passed = flights.crossings(planes, lost) if planes else NOTHING
    if missing == 0 and not (planes and plan.comm.allreduce(len(passed))):
        return particles, deposition, state.lost, state.screens
    met = np.unique(np.concatenate([lost.flight, passed.flight]))
    before = state.window.to_laboratory(_momenta(state, plan, met))

    def recorded(of: Encounters, names: Sequence[str]) -> Record:
        late = window.to_laboratory(moved.momentum[of.flight])
        # Those of the flight belong to its middle.
        momentum = late + (2 * of.share - 1)[:, None] * (late - before[np.searchsorted(met, of.flight)])
        return _record(of, momentum, moved, state.time + of.share * state.flight, names)

    lost_until_now = state.lost.joined(recorded(lost, causes(scene)))
    return particles, deposition, lost_until_now, state.screens.joined(recorded(passed, screens))


def _require_followable(comm: MPI.Comm, flights: Flights) -> None:
    """Raise ParticleError on all ranks if a flight has too many periods to be followed past apertures and screens."""
    most = comm.allreduce(flights.most_periods, MPI.MAX)
    if most > MOST_PERIODS:
        raise ParticleError(
            f"a particle flies through {most:.3g} periods of the domain in a step, past apertures or screens, and is followed "
            f"through at most {MOST_PERIODS}; shorten motion.dt"
        )


def kicked(state: State, plan: Plan) -> State:
    """Return the state whose `synchronized` particles have the momenta of its own time in all digits. Collective."""
    if state.staggered is None or state.staggered.lag == 0 or state.staggered.between is not None:
        return state
    particles = kick(state.solution, state.particles, state.staggered, plan)
    return replace(state, particles=particles, staggered=replace(state.staggered, lag=0.0))


def _momenta(state: State, plan: Plan, chosen: np.ndarray) -> np.ndarray:
    """Return the momenta (m, 3) of some particles, ascending, as `kicked` has them for all. Collective."""
    staggered, few = state.staggered, state.particles.select(chosen)
    if staggered is None or staggered.lag == 0:
        return few.momentum
    if staggered.between is not None:
        return staggered.between[chosen]
    sorting = state.particles.sorted_on(state.hierarchy)
    few = replace(few, sorting=replace(sorting, starts=np.searchsorted(chosen, sorting.starts)))
    return kick(state.solution, few, staggered, plan).momentum


def _record(
    met: Encounters, momentum: np.ndarray, particles: Particles, time: np.ndarray, names: Sequence[str]
) -> Record:
    there = particles.select(met.flight).replace(met.place, momentum)
    return Record(there, time, met.direction, met.what, tuple(names))

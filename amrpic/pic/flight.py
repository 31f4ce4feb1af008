"""The flight of particles from one step to the next, and the records of what they meet on it."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from .. import _native
from ..errors import ParticleError
from ..mesh.domain import FACES
from ..mesh.hierarchy import Hierarchy
from ..mesh.window import Window
from ..mpi import MPI
from ..particles.particles import Particles, concatenate, cut
from ..scene.obstacles import aperture_names
from ..scene.scene import Scene
from ..stages.deposit import Deposition
from ..stages.encounters import MOST_PERIODS, Encounters, Flights
from ..stages.migrate import arranged, migrate_without, share_out, weights
from .births import Born
from .leapfrog import momenta_of
from .records import Record
from .setup import Setup
from .state import State
from .tallies import Tallies

PORTION = 2**15  # particles of a rank that it sends to their servers at a time
NONE = np.zeros(0, dtype=np.int64)
NOTHING = Encounters(NONE, NONE, np.zeros(0), np.zeros((0, 3)), NONE)


def causes(scene: Scene) -> tuple[str, ...]:
    """Return the names of all where particles of a scene are lost: faces of the domain, then apertures and electrodes."""
    return (*FACES, *aperture_names(scene.apertures), *(electrode.name for electrode in scene.electrodes))


@dataclass(frozen=True, eq=False)
class Arrived:
    """Particles on the ranks that serve them, and what they met on their way."""

    particles: Particles
    lost: Record  # since the start of the run
    screens: Record  # likewise
    tallies: Tallies  # likewise
    deposition: Deposition | None = None  # of these particles, if it has begun

    @property
    def records(self) -> tuple[Record, Record, Tallies]:
        return self.lost, self.screens, self.tallies


def place(bunches: list[Particles], base: Hierarchy, window: Window, start: float, setup: Setup) -> Arrived:
    """Return the particles of bunches at their start (s); those outside are lost. Collective.

    It is known who serves which before any particle moves. They go there in portions, for which the list is emptied, so that no
    rank holds many more than its part at any time.
    """
    scene, species = setup.scene, bunches[0].species
    counted = [weights(bunch, base) for bunch in bunches]
    servers = share_out(setup.comm, *(np.concatenate(column) for column in zip(*counted, strict=True)))
    lost, portions = Record.empty(species, causes(scene)), []
    for portion in _portions(setup.comm, bunches):
        inside, outside, _ = migrate_without(portion, base, NONE, servers)
        portions.append(inside)
        left = Flights(portion.position, portion.position, base.domain, window, window).exits(outside)
        momentum = window.to_laboratory(portion.momentum[outside])
        lost = lost.joined(_record(left, momentum, portion, np.full(len(left), start), causes(scene)))
        del portion, inside  # else they live beside what follows
    particles = portions[0] if len(portions) == 1 else arranged(portions, base, servers)
    screens = Record.empty(species, [screen.name for screen in scene.screens])
    return Arrived(particles, lost, screens, Tallies.of_scene(scene))


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


def migrate(state: State, moved: Particles, born: Born | None, setup: Setup) -> Arrived:
    """Return the particles of a state where they have `moved`, those that were `born` since, and its records of losses and
    screens with those of the flight.

    Collective. Each flight is a straight line in the laboratory; those that touch an aperture or an electrode end there. The
    deposit of those that stay on their rank, if it `deposits_meanwhile`, is returned as it has begun.
    """
    scene, hierarchy, window = setup.scene, state.hierarchy, state.staggered.course.window
    start, tallies = state.particles.position, state.tallies
    if born is not None:
        start, moved, tallies = np.concatenate([start, born.start]), concatenate([moved, born.particles]), born.tallies
    flights = Flights(start, moved.position, hierarchy.domain, state.window, window)
    if (setup.obstacles or scene.screens) and any(hierarchy.domain.periodic):
        _require_followable(setup.comm, flights)
    stopped = flights.losses(setup.obstacles) if setup.obstacles else NOTHING
    particles, outside, missing, deposition = _migrated(state, moved, stopped.flight, setup)
    lost = replace(stopped, what=stopped.what + len(FACES))
    if len(outside) > 0:
        lost = lost.joined(flights.exits(outside))
    screens = [screen.name for screen in scene.screens]
    passed = flights.crossings(setup.screens, lost) if screens else NOTHING
    if missing == 0 and not (screens and setup.comm.allreduce(len(passed))):
        return Arrived(particles, state.lost, state.screens, tallies, deposition)
    met = np.unique(np.concatenate([lost.flight, passed.flight]))
    before, begun, duration = _departures(state, born, met, setup)

    def recorded(of: Encounters, names: Sequence[str]) -> Record:
        late = window.to_laboratory(moved.momentum[of.flight])
        # Those of the flight belong to its middle.
        place = np.searchsorted(met, of.flight)
        momentum = late + (2 * of.share - 1)[:, None] * (late - before[place])
        return _record(of, momentum, moved, begun[place] + of.share * duration[place], names)

    lost_until_now = state.lost.joined(recorded(lost, causes(scene)))
    return Arrived(particles, lost_until_now, state.screens.joined(recorded(passed, screens)), tallies, deposition)


def _departures(
    state: State, born: Born | None, met: np.ndarray, setup: Setup
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return the momenta (m, 3) in the laboratory and times (m,) at which some flights, ascending, begin, and their duration,
    s: those of a state, and behind them those of newborn particles. Collective."""
    old = met[: np.searchsorted(met, len(state.particles))]
    momentum, time = momenta_of(state, old, setup), np.full(len(old), state.time)
    duration = np.full(len(old), state.staggered.flight)
    if born is not None:
        new = met[len(old) :] - len(state.particles)
        momentum, time = np.concatenate([momentum, born.momentum[new]]), np.concatenate([time, born.time[new]])
        duration = np.concatenate([duration, state.time + state.staggered.flight - born.time[new]])
    return state.window.to_laboratory(momentum), time, duration


def _migrated(
    state: State, moved: Particles, stopped: np.ndarray, setup: Setup
) -> tuple[Particles, np.ndarray, int, Deposition | None]:
    """Return what `migrate_without` those that are `stopped` returns, and the deposit that has begun meanwhile. Collective."""
    begun: list[Deposition] = []

    def begin_deposit(here: Particles, migration: _native.Migration) -> None:
        with setup.clock("deposit"):
            begun.append(Deposition(here, state.hierarchy, setup.clouds))
            begun[0].begin(migration)

    begins = deposits_meanwhile(setup.scene, len(moved.species.kinds), state.step + 1)
    meanwhile = (begin_deposit,) if begins else ()
    servers = state.particles.sorted_on(state.hierarchy).servers
    arrived = migrate_without(moved, state.hierarchy, stopped, servers, True, *meanwhile)
    return *arrived, begun[0] if begun else None


def _require_followable(comm: MPI.Comm, flights: Flights) -> None:
    """Raise ParticleError on all ranks if a flight has too many periods to be followed past apertures and screens."""
    most = comm.allreduce(flights.most_periods, MPI.MAX)
    if most > MOST_PERIODS:
        raise ParticleError(
            f"a particle flies through {most:.3g} periods of the domain in a step, past apertures or screens, and is followed "
            f"through at most {MOST_PERIODS}; shorten motion.dt"
        )


def _record(
    met: Encounters, momentum: np.ndarray, particles: Particles, time: np.ndarray, names: Sequence[str]
) -> Record:
    struck = particles.select(met.flight).replace(met.place, momentum)
    return Record.of(struck, time, met.direction, met.what, names)

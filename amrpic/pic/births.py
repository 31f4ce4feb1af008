"""Particles that are born in time: those of a step, and their flight to its end."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ..particles.arrays import empty_columns
from ..particles.particles import Particles, concatenate
from ..stages.migrate import NONE, migrate_without
from ..units import SPEED_OF_LIGHT
from .emitters import Span
from .leapfrog import kicked
from .setup import Setup
from .state import State
from .tallies import PARTS, Tallies


@dataclass(frozen=True, eq=False)
class Born:
    """Particles that are born between two states, after their first flight, beside older ones that have moved."""

    particles: Particles  # momenta are half a step before the next state, as those of others; places are seen as theirs
    start: np.ndarray  # (n, 3) m, where they are born, in the window of the first state
    momentum: np.ndarray  # (n, 3) kg m/s, with which they are born
    time: np.ndarray  # (n,) s
    tallies: Tallies  # then


def births(state: State, setup: Setup) -> Born | None:
    """Return the particles that are born until the next state, None if the scene has no sources. Collective.

    Those that are born τ before it go to x + v τ + a τ²/2, and get the momentum that the field at their place gives them in
    τ - Δt/2, which is negative for those born late: the whole kick that follows then ends at the time of the others'. None are
    born outside of the domain.
    """
    if not setup.emitters:
        return None
    stop = state.time + state.staggered.flight
    spans = [_span(state, stop, n, setup) for n in range(len(setup.emitters))]
    with setup.clock("beam"):
        newborn = _sorted(state, spans, setup)
        time, tallies = np.empty(len(newborn)), []
        for emitter, span, tally in zip(setup.emitters, spans, state.tallies.of, strict=True):
            own = emitter.own(newborn.id)
            time[own] = emitter.times(newborn.id[own] - emitter.first, span)
            charge = (newborn.weight * newborn.charge)[own]
            part = emitter.part(state.window.places(newborn.position[own]), PARTS)
            charges = np.bincount(part, charge, 1 if emitter.extent is None else PARTS**2)
            count, *sums = setup.comm.allreduce(np.concatenate([[own.sum()], charges]))
            tallies.append(tally.after(emitter.numbers(span).stop, int(count), np.array(sums)))
    with setup.clock("push"):
        moved = _flown(state, newborn, stop - time, setup)
    return Born(moved, newborn.position, newborn.momentum, time, Tallies(tuple(tallies)))


def _span(state: State, stop: float, number: int, setup: Setup) -> Span:
    """Return what a source knows of a step."""
    surface = setup.emitters[number].source.surface
    layer = None if surface is None else state.solution.layers.get(surface)
    external = setup.external.seen_from(state.window) if setup.scene.elements else None
    added = None if external is None else lambda places: external.fields(places, state.time)[0]
    return Span(state.time, stop, state.tallies.of[number].used, layer, added)


def _sorted(state: State, spans: Sequence[Span], setup: Setup) -> Particles:
    """Return what is born, at the places of birth and on the ranks that serve these. Collective."""
    species = state.particles.species
    parts = [e.newborn(setup.comm, span, species) for e, span in zip(setup.emitters, spans, strict=True)]
    newborn = concatenate(parts).seen_from(state.window)
    servers = state.particles.sorted_on(state.hierarchy).servers
    newborn, _, outside = migrate_without(newborn, state.hierarchy, NONE, servers)
    if outside:
        setup.remarks.remark(
            f"{outside} particles of sources would be born outside of the domain in step {state.step + 1}, and are not; "
            "keep sources inside",
            "sources outside",
        )
    return newborn


def _flown(state: State, newborn: Particles, left: np.ndarray, setup: Setup) -> Particles:
    """Return particles after a flight of `left` (n,) s to the next state, and seen as older ones are then. Collective."""
    halfway, momentum = (
        kicked(state, newborn, time, setup).momentum for time in (left / 2, left - state.staggered.dt / 2)
    )
    mass, position = newborn.mass, empty_columns(len(newborn))
    gamma = np.sqrt(1 + np.square(halfway / (mass * SPEED_OF_LIGHT)[:, None]).sum(axis=1))
    position[...] = newborn.position + halfway * (left / (gamma * mass))[:, None]
    return newborn.replace(position, momentum).in_laboratory(state.window).seen_from(state.staggered.course.window)

"""Where particles go next: they rest, walk, or drift with the momenta that a push gave them."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial

from ..particles.particles import Particles
from ..scene.motion import Leapfrog, RandomWalk
from ..scene.scene import Scene
from ..stages.push import random_walk
from .state import State

Mover = Callable[[State], Particles]  # the particles at their next places, not yet sorted there


def mover_of(scene: Scene) -> Mover:
    """Return the function that moves the particles of a scene."""
    match scene.motion:
        case Leapfrog():
            return drift
        case RandomWalk(amplitude=amplitude):
            return partial(walk, amplitude=amplitude, seed=scene.seed)
    return rest


def rest(state: State) -> Particles:
    """Return the particles where they are."""
    return state.particles


def walk(state: State, amplitude: float, seed: int) -> Particles:
    """Return the particles after a random step of up to `amplitude` (m) along each axis."""
    return random_walk(state.particles, amplitude, seed, state.step + 1)


def drift(state: State) -> Particles:
    """Return the particles after the drift that went with their push, along the axes of the mesh then."""
    moved, turn = state.staggered.moved, state.window.turn_to(state.staggered.course.window)
    return moved if turn is None else moved.turned(turn)

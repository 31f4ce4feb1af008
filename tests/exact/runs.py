"""Runs of scenes step by step, for topics whose answers are known at every time."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any

import numpy as np
from mpi4py import MPI

from amrpic.particles.particles import Particles
from amrpic.pic.state import State
from amrpic.pic.step import advance, begin
from amrpic.scene.scene import Scene


def states(comm: MPI.Comm, scene: Mapping[str, Any]) -> Iterator[State]:
    """The states of a run from its start to its last step. Collective."""
    state, setup = begin(comm, Scene.from_dict(scene))
    yield state
    while state.step < setup.scene.schedule.last_step:
        yield (state := advance(state, setup))


def end(comm: MPI.Comm, scene: Mapping[str, Any]) -> State:
    """The last state of a run. Collective."""
    for state in states(comm, scene):
        last = state
    return last


def collected(comm: MPI.Comm, particles: Particles) -> tuple[np.ndarray, np.ndarray]:
    """Positions (n, 3) in m and momenta (n, 3) in kg m/s of all particles by their ids, on every rank. Collective."""
    id, position, momentum = (
        np.concatenate(comm.allgather(np.array(values)))
        for values in (particles.id, particles.position, particles.momentum)
    )
    order = np.argsort(id)
    return position[order], momentum[order]

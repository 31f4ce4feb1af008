"""The frames in which the self-field of a step's particles is solved for."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from ..errors import InputError
from ..mesh.domain import Domain
from ..mesh.window import AT_REST, Window, part_of, vector
from ..mpi import MPI
from ..particles.energy_bins import ONE_FRAME, Frames, frames_of
from ..particles.frame import LABORATORY
from ..particles.motion_of_charge import charges
from ..particles.particles import Particles
from .charge_images import frames_with_images, mirrored
from .setup import Setup
from .state import State

FEW = 0.1  # share of the charge of a run that has no say in the frame any more where the frame of the rest does not fit it


def first_frames(particles: Particles, setup: Setup) -> Frames:
    """Return the frames of particles at the start of a run. Collective; InputError on all ranks."""
    return _frames(particles, ONE_FRAME, None, AT_REST, setup)


def next_frames(state: State, particles: Particles, lost: Particles, setup: Setup) -> Frames:
    """Return the frames of the particles of the step after a state. Collective; InputError on all ranks.

    Energy bins of the step before stay while they fit. Where no frame fits them, a single particle and the last few of which
    the others are `lost` keep those of the step before.
    """
    if not setup.scene.motion.follows_fields:
        return ONE_FRAME
    staggered, last = state.staggered, frames_with_images(state, setup)
    window = staggered.course.window
    turn = state.window.turn_to(window)
    # the part of the turn that lies between momenta and places
    behind = None if turn is None else part_of(turn.T, staggered.dt / 2 / staggered.flight)
    last = replace(last, turn=None if behind is None else tuple(map(vector, behind)))
    return _frames(particles, last, lost, window, setup)


def _frames(particles: Particles, last: Frames, lost: Particles | None, window: Window, setup: Setup) -> Frames:
    """Return the frames, with the walls that the mesh in this window leaves."""
    motion, comm = setup.scene.motion, setup.comm
    if not motion.follows_fields:
        return ONE_FRAME
    bins = None if motion.energy_bins == "auto" else motion.energy_bins
    try:
        with_momenta = comm, last.straight(particles), setup.scene.domain.value
        frames = _slow(*with_momenta, last) if setup.electrodes else None
        frames = frames or frames_of(*with_momenta, motion.frame, bins, last)
    except InputError:
        if particles.global_count(comm) > 1 and _share_left(particles, lost, setup) > FEW:
            raise
        setup.remarks.remark(
            f"the particles that are left, one or at most {FEW:g} of the charge, have a mean momentum that fits no frame "
            "of their self-field, which is solved for as if they moved on as before"
        )
        frames = last
    else:
        setup.remarks.on_frames(frames, motion)
        frames = replace(frames, turn=last.turn)
    if any(electrode.floats for electrode in setup.electrodes) and frames.only != LABORATORY:
        raise InputError(
            "particles faster than 0.1 c fly beside an electrode that floats, whose voltage in their field is not known; "
            "give it a voltage"
        )
    return mirrored(frames, last, setup.scene, window)


def _slow(comm: MPI.Comm, particles: Particles, domain: Domain, last: Frames) -> Frames | None:
    """Return the laboratory as the one frame of particles beside electrodes, whose images there are at rest; None where the
    magnetic field of the particles counts. Collective.
    """
    try:
        return frames_of(comm, particles, domain, "lab", 1, last)
    except InputError:
        return None


def _share_left(particles: Particles, lost: Particles | None, setup: Setup) -> float:
    """Return the charge of particles over that of theirs and the lost ones together, without its sign. Collective."""
    sums = [0.0 if group is None else charges(group).sum() for group in (particles, lost)]
    left, lost_charge = setup.comm.allreduce(np.array(sums))
    return float(left / (left + lost_charge)) if lost_charge > 0 else 1.0

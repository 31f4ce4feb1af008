"""Energy bins: parts of a beam, each solved for in a frame of its own."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from mpi4py import MPI

from ..mesh.domain import Domain
from ..units import SPEED_OF_LIGHT
from .frame import LABORATORY, Frame, frame_of
from .particles import Particles

WIDTH = 0.2  # of ln γ in a bin that is chosen by itself: γ differs by a tenth to either side
MOST = 16  # bins that are chosen by themselves
FEW = 1e-3  # of the charge: bins with less join their neighbour
EVERY = 16  # steps from one choice to the next


@dataclass(frozen=True)
class Frames:
    """The frames of the bins of a beam, in ascending order of ±ln γ of the motion along an axis: see `Bins`."""

    members: tuple[Frame, ...] = (LABORATORY,)
    axis: int = 2
    edges: tuple[float, ...] = ()  # between the bins

    @property
    def only(self) -> Frame | None:
        """The frame, if there is one bin."""
        return self.members[0] if len(self.members) == 1 else None

    def part(self, particles: Particles, number: int) -> Particles:
        """Return the particles where those of other bins have no weight."""
        if self.only is not None:
            return particles
        inside = np.searchsorted(self.edges, signed_energy(particles, self.axis), side="right") == number
        return particles.with_weight(particles.weight * inside)


ONE_FRAME = Frames()  # of one bin, that of the laboratory


def signed_energy(particles: Particles, axis: int) -> np.ndarray:
    """Return ln γ (n,) of the motion along an axis, negative for those that move downwards; γ² = 1 + (p/mc)²."""
    u = particles.momentum[:, axis] / (particles.mass * SPEED_OF_LIGHT)
    return np.copysign(0.5 * np.log1p(u * u), u)


def frames_of(
    comm: MPI.Comm,
    particles: Particles,
    domain: Domain,
    choice: str = "auto",
    bins: int | None = 1,
    before: Frames | None = None,
) -> Frames:
    """Return the frames in which to solve for the field of the particles. Collective; InputError as `frame_of`.

    `choice` as there; `bins`: so many at most, None: as many as let γ differ by a tenth within one. Bins of `before` are kept,
    and its frames while they fit.
    """
    if before is not None:
        axis, edges, old = before.axis, before.edges, before.members
    else:
        axis, edges = _edges(comm, particles, bins) if choice != "lab" and bins != 1 else (2, ())
        old = (LABORATORY,) * (len(edges) + 1)
    plan = Frames(old, axis, edges)
    members = (frame_of(comm, plan.part(particles, n), domain, choice, frame) for n, frame in enumerate(old))
    return Frames(tuple(members), axis, edges)


def spread(comm: MPI.Comm, particles: Particles, frames: Frames) -> float:
    """Return the rms of ln γ about its mean in each bin, over all real charge. Collective.

    The force of a beam on itself goes with 1/γ², so that bins change it by about twice this.
    """
    square = charge = 0.0
    values = signed_energy(particles, frames.axis)
    for number in range(len(frames.members)):
        weight = frames.part(particles, number).weight * np.abs(particles.charge)
        total, first, second = comm.allreduce(np.array([weight.sum(), weight @ values, weight @ values**2]))
        if total > 0:
            square, charge = square + max(second - first**2 / total, 0.0), charge + total
    return math.sqrt(square / charge) if charge > 0 else 0.0


def _edges(comm: MPI.Comm, particles: Particles, bins: int | None) -> tuple[int, tuple[float, ...]]:
    """Return the axis along which particles move most, and what separates their bins. Collective."""
    moving = comm.allreduce(np.abs(particles.momentum).sum(axis=0))
    axis = int(np.argmax(moving))
    mc = particles.species.masses * SPEED_OF_LIGHT
    along = particles.momentum[:, axis]
    bounds = np.array([-along.min(initial=np.inf), along.max(initial=-np.inf)])
    comm.Allreduce(MPI.IN_PLACE, bounds, MPI.MAX)
    extremes = bounds * (-1.0, 1.0) / mc.min()  # of the lightest species, so that there are no larger ones
    low, high = np.copysign(0.5 * np.log1p(extremes**2), extremes)
    if not high - low > (WIDTH if bins is None else 0.0):
        return axis, ()
    values = signed_energy(particles, axis)
    ends = np.array([-values.min(initial=np.inf), values.max(initial=-np.inf)])
    comm.Allreduce(MPI.IN_PLACE, ends, MPI.MAX)
    low, high = -ends[0], ends[1]
    count = bins if bins is not None else min(math.ceil((high - low) / WIDTH), MOST)
    inner = np.linspace(low, high, count + 1)[1:-1]
    number = np.searchsorted(inner, values, side="right")
    charge = comm.allreduce(np.bincount(number, particles.weight * np.abs(particles.charge), count))
    kept, held = [], 0.0
    for n, edge in enumerate(inner):
        held += charge[n]
        if held > FEW * charge.sum() and charge[n + 1 :].sum() > FEW * charge.sum():
            kept.append(float(edge))
            held = 0.0
    return axis, tuple(kept)

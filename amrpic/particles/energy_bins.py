"""Energy bins: parts of a beam, each solved for in a frame of its own."""

from __future__ import annotations

import math
from collections.abc import Iterator
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
    """The frames of the bins of a beam, in ascending order of ±ln γ of the motion along an axis."""

    members: tuple[Frame, ...] = (LABORATORY,)
    axis: int = 2
    edges: tuple[float, ...] = ()  # between the bins

    @property
    def only(self) -> Frame | None:
        """The frame, if there is one bin."""
        return self.members[0] if len(self.members) == 1 else None

    def parts(self, particles: Particles) -> Iterator[Particles]:
        """Yield for each bin the particles, where those of other bins have no weight."""
        if self.only is not None:
            yield particles
            return
        number = np.searchsorted(self.edges, signed_energy(particles, self.axis), side="right")
        for bin in range(len(self.members)):
            yield particles.with_weight(particles.weight * (number == bin))


ONE_FRAME = Frames()  # of one bin, that of the laboratory


def signed_energy(particles: Particles, axis: int) -> np.ndarray:
    """Return ln γ (n,) of the motion along an axis, negative for those that move downwards; γ² = 1 + (p/mc)²."""
    return _signed(particles.momentum[:, axis] / (particles.mass * SPEED_OF_LIGHT))


def _signed(u: np.ndarray) -> np.ndarray:
    return np.copysign(0.5 * np.log1p(u * u), u)


def frames_of(
    comm: MPI.Comm,
    particles: Particles,
    domain: Domain,
    choice: str = "auto",
    bins: int | None = 1,
    last: Frames = ONE_FRAME,
    anew: bool = True,
) -> Frames:
    """Return the frames in which to solve for the field of the particles. Collective; InputError as `frame_of`.

    `choice` as there; `bins`: so many at most, None: as many as let γ differ by a tenth within one. Bins are chosen `anew`, or
    stay those of `last`, the frames of the step before; these are kept while they fit.
    """
    axis, edges = last.axis, last.edges
    if anew:
        axis, edges = _edges(comm, particles, bins) if choice != "lab" and bins != 1 else (2, ())
    old = last.members if len(edges) == len(last.edges) else (LABORATORY,) * (len(edges) + 1)
    parts = Frames(old, axis, edges).parts(particles)
    members = (frame_of(comm, part, domain, choice, frame) for part, frame in zip(parts, old, strict=True))
    return Frames(tuple(members), axis, edges)


def spread(comm: MPI.Comm, particles: Particles, frames: Frames) -> float:
    """Return the rms of ln γ about its mean in each bin, over all real charge. Collective.

    The force of a beam on itself goes with 1/γ², so that bins change it by about twice this.
    """
    square = charge = 0.0
    values = signed_energy(particles, frames.axis)
    for part in frames.parts(particles):
        weight = part.weight * np.abs(particles.charge)
        total, first, second = comm.allreduce(np.array([weight.sum(), weight @ values, weight @ values**2]))
        if total > 0:
            square, charge = square + max(second - first**2 / total, 0.0), charge + total
    return math.sqrt(square / charge) if charge > 0 else 0.0


def _edges(comm: MPI.Comm, particles: Particles, bins: int | None) -> tuple[int, tuple[float, ...]]:
    """Return the axis along which particles move most, and what separates their bins. Collective."""
    moving = comm.allreduce(np.abs(particles.momentum).sum(axis=0))
    axis = int(np.argmax(moving))
    mc = particles.species.masses * SPEED_OF_LIGHT
    extremes = _range(comm, particles.momentum[:, axis]) / mc.min()  # of the lightest species: there are no larger ones
    low, high = _signed(extremes)
    if not high - low > (WIDTH if bins is None else 0.0):
        return axis, ()
    values = signed_energy(particles, axis)
    low, high = _range(comm, values)
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


def _range(comm: MPI.Comm, values: np.ndarray) -> np.ndarray:
    """Return the least and the largest value (2,) on all ranks. Collective."""
    bounds = np.array([-values.min(initial=np.inf), values.max(initial=-np.inf)])
    comm.Allreduce(MPI.IN_PLACE, bounds, MPI.MAX)
    return bounds * (-1.0, 1.0)

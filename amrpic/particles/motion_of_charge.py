"""How charge moves: its mean velocity, what is left of motion in a frame, and how sure a sample is of either."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from ..mpi import MPI
from ..units import SPEED_OF_LIGHT
from .frame import Frame
from .particles import Particles

BLOCK = 1 << 13  # particles whose numbers stay in a cache
PLACES, EACH = (
    16,
    8,
)  # cells along each axis for four rms sizes, in which mean velocities are compared: most, and particles in one


@dataclass(frozen=True)
class Flow:
    """Sums over the charge of some particles, weighted by |w q| in the laboratory."""

    charge: float  # C
    beta: np.ndarray  # (3,) mean velocity over c
    per_gamma_square: float  # 1 - β² along the axis, without cancellation

    def momentum(self, axis: int) -> float:
        """β γ of the frame along the axis in which the charge rests in the mean."""
        return float(self.beta[axis] / np.sqrt(self.per_gamma_square)) if self.charge > 0 else 0.0


@dataclass(frozen=True)
class Left:
    """What is left of motion in a frame, weighted by |w q| in it."""

    square: np.ndarray  # (3,) means of β_d²
    current: np.ndarray  # (3,) mean square of the mean velocity over c at a place, beyond the noise of the sample


def charges(particles: Particles) -> np.ndarray:
    """Return |w q| (n,), C; takes no memory if all are the same."""
    if particles.equal_weights and len(particles.species.kinds) == 1 and len(particles) > 0:
        return np.broadcast_to(np.abs(particles.weight[0] * particles.charge[0]), len(particles))
    return np.abs(particles.weight * particles.charge)


def largest(comm: MPI.Comm, particles: Particles) -> float:
    """Return an upper bound of (β γ)². Collective."""
    most = np.array([max(p.max(initial=0.0), -p.min(initial=0.0)) for p in particles.momentum.T])
    return float(
        (np.asarray(comm.allreduce(most, MPI.MAX)) ** 2).sum() / (particles.species.masses.min() * SPEED_OF_LIGHT) ** 2
    )


def mean_momentum(comm: MPI.Comm, particles: Particles) -> np.ndarray:
    """Return the mean β γ (3,) of real particles: their total momentum over their total mass times c. Collective."""
    if particles.equal_weights and len(particles.species.kinds) == 1 and len(particles) > 0:  # no pass over either
        momentum = particles.momentum.sum(axis=0) * particles.weight[0]
        mass = len(particles) * particles.weight[0] * particles.mass[0]
    else:
        momentum, mass = particles.weight @ particles.momentum, particles.weight @ particles.mass
    sums = comm.allreduce(np.array([*momentum, mass * SPEED_OF_LIGHT]))
    return sums[:3] / sums[3] if sums[3] > 0 else np.zeros(3)


def _blocks(particles: Particles) -> Iterator[tuple[slice, np.ndarray]]:
    """Yield runs of particles and their p/mc (3, k)."""
    per_mc = 1 / (particles.mass * SPEED_OF_LIGHT)
    momentum = particles.momentum.T
    for start in range(0, len(particles), BLOCK):
        run = slice(start, start + BLOCK)
        yield run, momentum[:, run] * per_mc[run]


def rapidity(particles: Particles, axis: int) -> np.ndarray:
    """Return artanh β_a (n,) along an axis: differences of it are the same in all frames along the axis."""
    out = np.empty(len(particles))
    for run, u in _blocks(particles):
        out[run] = np.arcsinh(u[axis] / np.sqrt(1 + sum(u[d] ** 2 for d in range(3) if d != axis)))
    return out


def momenta(comm: MPI.Comm, particles: Particles) -> tuple[np.ndarray, np.ndarray]:
    """Return the means of β γ and of its square (3,) along the axes, weighted by |w q|. Collective."""
    charge, sums = charges(particles), np.zeros((3, 3))
    for run, u in _blocks(particles):
        sums[0] += u @ charge[run]
        sums[1] += u**2 @ charge[run]
        sums[2] += charge[run].sum()
    mean, square, total = comm.allreduce(sums)
    return (mean / total, square / total) if total[0] > 0 else (np.zeros(3), np.zeros(3))


def flow(comm: MPI.Comm, particles: Particles, axis: int) -> Flow:
    """Return how the charge of particles moves. Collective."""
    weighs, sums = charges(particles), np.zeros(6)
    for run, u in _blocks(particles):
        weight = weighs[run]
        across = 1.0 + sum(u[d] * u[d] for d in range(3) if d != axis)
        gamma = np.sqrt(across + u[axis] * u[axis])
        less = across / (gamma * (gamma + np.abs(u[axis])))  # 1 - |β_a|
        if not u[axis].min() >= 0:
            less = np.where(u[axis] >= 0, less, 2 - less)
        total, ahead = weight.sum(), weight @ less  # of 1 - β_a
        sums += *(u @ (weight / gamma)), ahead, 2 * total - ahead, total
    sums = comm.allreduce(sums)
    total = sums[5]
    if not total > 0:
        return Flow(0.0, np.zeros(3), 1.0)
    return Flow(float(total), sums[:3] / total, float(sums[3] / total * (sums[4] / total)))


def noise(comm: MPI.Comm, particles: Particles, flow: Flow, axis: int) -> float:
    """Return the mean square by which a mean velocity across the axis, over c in the frame, is off by chance. Collective."""
    weighs, sums = charges(particles), np.zeros(2)
    for run, u in _blocks(particles):
        gamma = np.sqrt(1 + (u**2).sum(axis=0))
        off = np.delete(u / gamma - flow.beta[:, None], axis, axis=0)
        sums += weighs[run] ** 2 @ (off**2).sum(axis=0), weighs[run] @ weighs[run]
    square, weights = comm.allreduce(sums)
    share = weights / flow.charge**2 if flow.charge > 0 else 1.0  # one over the number of equal particles
    return float(square / flow.charge**2 / flow.per_gamma_square / (1 - share)) if share < 1 else 0.0


def _seen_from(frame: Frame, u: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return velocities over c (3, k) in a frame of particles with p/mc (3, k), and their γ there over that in the laboratory.

    A difference of large numbers is that of their squares over their sum.
    """
    along, across = u[frame.axis], 1 + sum(u[d] ** 2 for d in range(3) if d != frame.axis)
    gamma = np.sqrt(across + along**2)
    if frame.momentum == 0:
        return u / gamma, np.ones(len(gamma))
    moves, of_frame = abs(frame.momentum), frame.gamma
    slow = moves * np.sqrt(across)  # p/mc along of what goes with the frame
    fast = np.abs(along)
    in_frame = (across * of_frame**2 + along**2) / (of_frame * gamma + moves * fast)
    relative = (fast - slow) * (fast + slow) / (of_frame * fast + moves * gamma)
    if not (ahead := along * frame.momentum > 0).all():
        in_frame = np.where(ahead, in_frame, of_frame * gamma + moves * fast)
        relative = np.where(ahead, relative, -(of_frame * fast + moves * gamma))
    beta = u / in_frame
    beta[frame.axis] = math.copysign(1.0, frame.momentum) * relative / in_frame
    return beta, in_frame / gamma


def squares(particles: Particles, frame: Frame) -> np.ndarray:
    """Return sums (7,) of the charge of this rank's particles as it is in a frame: |w q|, |w q| β_d² there, and w q β_d."""
    weighs, sign, sums = charges(particles), np.sign(particles.charge), np.zeros(7)
    for run, u in _blocks(particles):
        beta, ratio = _seen_from(frame, u)
        weight = weighs[run] * ratio  # a length between charges is another one in each frame
        sums += weight.sum(), *(beta**2 @ weight), *(beta @ (weight * sign[run]))
    return sums


def left(comm: MPI.Comm, particles: Particles, frame: Frame) -> Left:
    """Return what is left of the motion of particles in a frame. Collective.

    Mean velocities are those of the charge with its sign, since currents make fields, in cells of a quarter of the rms size, or
    larger ones where particles are few. What they are by chance is taken away, with three standard deviations of it.
    """
    weighs, charge = charges(particles), particles.charge
    centre, size, count = _extent(comm, particles, weighs)
    places = min(max(round((count / EACH) ** (1 / 3)), 2), PLACES)
    sums, cells = np.zeros(4), np.zeros((8, places**3))
    for run, u in _blocks(particles):
        beta, ratio = _seen_from(frame, u)
        weight = weighs[run] * ratio
        sums += *(beta**2 @ weight), weight.sum()
        place = (
            ((particles.position.T[:, run] - centre) / size * places / 4 + places / 2)
            .clip(0, places - 1)
            .astype(np.int64)
        )
        cell = (place[0] * places + place[1]) * places + place[2]
        square = weight**2
        values = (*(weight * np.sign(charge[run]) * beta), *(square * beta**2), weight, square)
        for k, value in enumerate(values):
            cells[k] += np.bincount(cell, value, places**3)
    sums, cells = comm.allreduce(sums), comm.allreduce(cells)
    total = sums[3]
    if not total > 0:
        return Left(np.zeros(3), np.zeros(3))
    full = cells[:, cells[6] > 0]
    chance = full[3:6] / full[6]
    pairs = (full[6] - full[7] / full[6]).sum()  # of different particles: they alone tell of a mean
    square = (full[:3] ** 2 / full[6] - chance).sum(axis=1) - 3 * np.sqrt(2 * (chance**2).sum(axis=1))
    current = np.maximum(square, 0.0) / pairs if pairs > 1e-9 * total else np.zeros(3)
    return Left(sums[:3] / total, current)


def _extent(comm: MPI.Comm, particles: Particles, weighs: np.ndarray) -> tuple[np.ndarray, np.ndarray, int]:
    """Return the mean place and the rms size (3, 1) of charge, m, and how many particles have any. Collective."""
    x = particles.position.T
    total, count, *first = comm.allreduce(np.array([weighs.sum(), (weighs > 0).sum(), *(x @ weighs)]))
    centre = np.array(first)[:, None] / total if total > 0 else np.zeros((3, 1))
    square = comm.allreduce((x - centre) ** 2 @ weighs)
    size = np.sqrt(square / total)[:, None] if total > 0 else np.zeros((3, 1))
    return centre, np.where(size > 0, size, 1.0), int(count)

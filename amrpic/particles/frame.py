"""The frame in which the self-field of a fast beam is electrostatic."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from mpi4py import MPI

from ..errors import InputError
from ..mesh.domain import AXES, Domain
from ..units import SPEED_OF_LIGHT
from .particles import Particles
from .species import LARGEST_MOMENTUM

STATIC = 1e-4  # β² below which "auto" leaves the magnetic self-field out
SLOW = 0.01  # β² above which it must not be left out
OFF_AXIS = 0.1  # rad / γ between the mean momentum and a mesh axis
FEW = 0.1  # share of the charge of a run that has no say in the frame any more where the frame of the rest does not fit it
SAME = 1e-6  # relative change of β γ below which a frame is kept, and the solver with it


@dataclass(frozen=True)
class Frame:
    """A frame that moves along a mesh axis; the laboratory, where it does not move."""

    axis: int = 2
    momentum: float = 0.0  # β γ

    @property
    def gamma(self) -> float:
        return math.hypot(1.0, self.momentum)

    @property
    def beta(self) -> tuple[float, float, float]:
        """Velocity over c."""
        out = [0.0, 0.0, 0.0]
        out[self.axis] = self.momentum / self.gamma
        return (out[0], out[1], out[2])

    @property
    def stretch(self) -> tuple[float, float, float]:
        """Factors on lengths from the laboratory to this frame: see `PoissonSolver`."""
        out = [1.0, 1.0, 1.0]
        out[self.axis] = self.gamma
        return (out[0], out[1], out[2])


LABORATORY = Frame()


def mean_momentum(comm: MPI.Comm, particles: Particles) -> np.ndarray:
    """Return the mean β γ (3,) of real particles: their total momentum over their total mass times c. Collective."""
    if particles.equal_weights and len(particles.species.kinds) == 1 and len(particles) > 0:  # no pass over either
        momentum = particles.momentum.sum(axis=0) * particles.weight[0]
        mass = len(particles) * particles.weight[0] * particles.mass[0]
    else:
        momentum, mass = particles.weight @ particles.momentum, particles.weight @ particles.mass
    sums = comm.allreduce(np.array([*momentum, mass * SPEED_OF_LIGHT]))
    return sums[:3] / sums[3] if sums[3] > 0 else np.zeros(3)


def frame_of(
    comm: MPI.Comm, particles: Particles, domain: Domain, choice: str = "auto", before: Frame = LABORATORY
) -> Frame:
    """Return the frame in which to solve for the field of the particles. Collective; InputError on all ranks.

    `choice`: "lab"; "rest", that of their mean momentum; or "auto", the laboratory for slow particles, and below β² = 0.01 for
    those that move along no mesh axis. `before`, the frame of the step before, is kept while it fits.
    """
    u = mean_momentum(comm, particles)
    size = math.hypot(*u)
    if not size <= LARGEST_MOMENTUM:
        raise InputError(
            f"the mean momentum is {size:.3g} m c, more than {LARGEST_MOMENTUM:g}; correct momenta (kg m/s) or fields, or "
            "shorten the time step"
        )
    gamma = math.hypot(1.0, size)
    beta_square = (size / gamma) ** 2
    if choice == "lab" and beta_square > SLOW:
        raise InputError(
            f'motion.frame is "lab", but the particles move with {math.sqrt(beta_square):.3g} c, where their magnetic field '
            'counts; use "rest" or "auto"'
        )
    if choice == "lab" or (choice == "auto" and beta_square < STATIC) or beta_square == 0:
        return LABORATORY
    axis = int(np.argmax(np.abs(u)))
    across = float(np.linalg.norm(np.delete(u, axis)) / abs(u[axis]))
    limit = OFF_AXIS / gamma
    if across > limit and choice == "auto" and beta_square <= SLOW:
        return LABORATORY
    if across > limit:
        raise InputError(
            f"the mean momentum lies {across:.3g} rad off the {AXES[axis]} axis, more than {limit:.3g} = 0.1/γ; the self-field "
            "of a fast beam is known along mesh axes alone: turn the scene"
        )
    walls = [kind for kind in domain.boundary[axis] if kind not in ("open", "periodic")]
    if walls and beta_square > SLOW:
        raise InputError(
            f"a face across the motion along {AXES[axis]} is {walls[0]}, which has no field at rest with particles of "
            f'{math.sqrt(beta_square):.3g} c; make both faces of {AXES[axis]} "open" or "periodic"'
        )
    found = Frame(axis, float(u[axis]))
    return before if before.axis == axis and abs(found.momentum - before.momentum) <= SAME * abs(u[axis]) else found

"""Where along z particles are lost, and what they deposit there."""

from __future__ import annotations

import math

import numpy as np

from ..mesh.boxes import unique_rows
from ..mpi import MPI
from ..particles.particles import Particles
from ..units import Column

COLUMNS = (
    Column("cause", is_text=True),
    Column("lower", "m"),
    Column("upper", "m"),
    Column("particles", counts=True),
    Column("charge", "C"),
    Column("energy", "J"),
)


def loss_map(
    comm: MPI.Comm,
    lost: Particles,
    cause: np.ndarray,
    names: tuple[str, ...],
    lower: float,
    upper: float,
    width: float,
) -> list[dict[str, float | str]]:
    """Return a row per cause and bin of z in which particles are lost: how many, their charge and kinetic energy. Collective.

    `cause` (n,) are indices of `names`. Bins are as wide as `width`, one begins at `lower`, and `upper` belongs to the one
    below, m. Each particle counts as the real ones that it stands for.
    """
    z = lost.position[:, 2]
    number = np.where(z == upper, math.ceil((upper - lower) / width - 1e-9) - 1, np.floor((z - lower) / width))
    keys = np.stack([cause, number.astype(np.int64)], axis=1)
    values = np.stack([np.ones(len(lost)), lost.weight * lost.charge, lost.weight * lost.kinetic_energy], axis=1)
    own_sums = _summed(keys, values)
    parts = comm.allgather(own_sums)
    keys, sums = _summed(*(np.concatenate([part[i] for part in parts]) for i in (0, 1)))
    return [
        {
            "cause": names[of],
            "lower": lower + bin_ * width,
            "upper": lower + (bin_ + 1) * width,
            "particles": count,
            "charge": charge,
            "energy": energy,
        }
        for (of, bin_), (count, charge, energy) in zip(keys.tolist(), sums.tolist(), strict=True)
    ]


def _summed(keys: np.ndarray, values: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return each key (cause, bin) once, in order, and the sums of its values."""
    once, place = unique_rows(keys)
    out = np.zeros((len(once), values.shape[1]))
    np.add.at(out, place, values)
    return once, out

"""Electrodes of a run: made once, driven by time and by the charge of particles that hit them, and what is recorded of them."""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial

import numpy as np

from ..conductors.contacts import refuse_contacts
from ..errors import InputError
from ..mpi import MPI
from ..parallel import from_rank_0
from ..scene.electrodes import Electrode
from ..scene.scene import Scene
from .records import Record


def electrodes_of(comm: MPI.Comm, scene: Scene) -> tuple[Electrode, ...]:
    """Return the electrodes of a scene, of which rank 0 reads files. Collective; InputError on all ranks."""
    return from_rank_0(comm, partial(make_electrodes, scene), InputError) if scene.electrodes else ()


def make_electrodes(scene: Scene) -> tuple[Electrode, ...]:
    """Return the electrodes of a scene. Raises InputError for a file that is no shape, and for those that touch."""
    electrodes = tuple(electrode.value for electrode in scene.electrodes)
    refuse_contacts(electrodes)
    return electrodes


def collected(comm: MPI.Comm, lost: Record, electrodes: Sequence[Electrode]) -> dict[str, float]:
    """Return the charge of the particles that hit each electrode so far, C. Collective."""
    sums = np.bincount(lost.cause, lost.particles.weight * lost.particles.charge, minlength=len(lost.names))
    numbers = [lost.names.index(e.name) if e.name in lost.names else -1 for e in electrodes]
    own = np.array([sums[number] if number >= 0 else 0.0 for number in numbers])
    return dict(zip((e.name for e in electrodes), comm.allreduce(own).tolist(), strict=True))

"""The files of records: losses as openPMD and as a map along z, screens as openPMD."""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from ..conductors.hits import first_hits
from ..io import openpmd_writer, time_series
from ..io.provenance import Moment, Provenance
from ..io.writer_ranks import writers_of
from ..mesh.boxes import unique_rows
from ..mpi import MPI
from ..particles.particles import Particles
from ..results.run_results import LOSSES
from ..scene.electrodes import Electrode
from ..scene.scene import Scene
from ..units import Column
from .records import Record
from .state import State

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


LOSS_MAP = "losses.csv"
NEAR = 1e-9  # of coordinates: where the surface is asked on both sides of a place on it
BINS = 100  # of the domain, if the scene gives no length


def write_losses(
    comm: MPI.Comm, state: State, scene: Scene, about: Provenance, electrodes: Sequence[Electrode] = ()
) -> None:
    """Write the losses so far, if there are any, or apertures and electrodes that they could be at. Collective; OutputError on
    all ranks."""
    lost, domain = state.lost, scene.domain
    if not scene.apertures and not scene.electrodes and lost.particles.global_count(comm) == 0:
        return
    columns = {"time": lost.time, "direction": lost.direction, "particleStatus": lost.cause + openpmd_writer.DEAD}
    if electrodes:
        columns["incidence"] = incidence(lost, electrodes)
    path, moment, of_run = scene.directory / LOSSES, Moment(state.step, state.time), (about, columns, lost.names)
    openpmd_writer.write(comm, path, lost.particles, moment, *of_run, writers_of(scene))
    lower, upper = domain.lower[2], domain.upper[2]
    width = scene.diagnostics.loss_bin or (upper - lower) / BINS
    rows = loss_map(comm, lost.particles, lost.cause, lost.names, lower, upper, width)
    time_series.write(comm, scene.directory / LOSS_MAP, COLUMNS, rows, about)


def incidence(lost: Record, electrodes: Sequence[Electrode]) -> np.ndarray:
    """Return the angle (n,) between the momentum of each particle and the normal of the electrode that it hit, rad; nan of
    others."""
    out = np.full(len(lost), np.nan)
    place, momentum = np.array(lost.particles.position), np.array(lost.particles.momentum)
    for electrode in electrodes:
        hit = np.flatnonzero(lost.cause == (lost.names.index(electrode.name) if electrode.name in lost.names else -1))
        size = np.abs(place[hit]).max(initial=0.0)
        with np.errstate(divide="ignore", invalid="ignore"):
            step = NEAR * size * momentum[hit] / np.linalg.norm(momentum[hit], axis=1)[:, None]
        recorded = np.isfinite(step).all(axis=1)
        hits = first_hits([electrode], (place[hit] - step)[recorded], (place[hit] + step)[recorded])
        out[hit[recorded][hits.segment]] = np.arccos(np.clip(hits.cosine, 0.0, 1.0))
    return out


def write_screens(comm: MPI.Comm, state: State, scene: Scene, about: Provenance) -> None:
    """Write what each screen of a scene has seen so far. Collective; OutputError on all ranks."""
    recorded = state.screens
    for screen in scene.screens:
        number = recorded.names.index(screen.name) if screen.name in recorded.names else -1
        at_screen = np.flatnonzero(recorded.cause == number)
        columns = {"time": recorded.time[at_screen], "direction": recorded.direction[at_screen]}
        path = screen_path(scene.directory, screen.name)
        particles, writers = recorded.particles.select(at_screen), writers_of(scene)
        moment = Moment(state.step, state.time)
        openpmd_writer.write(comm, path, particles, moment, about, columns, writers=writers)


def screen_path(directory: Path, name: str) -> Path:
    """Return where the record of a screen lies in a run's directory."""
    return Path(directory) / f"screen_{name}.h5"

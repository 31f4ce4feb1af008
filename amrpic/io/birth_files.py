"""Files of particles that are born at times of their own: openPMD-beamphysics, and ASTRA's text."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import h5py
import numpy as np

from ..errors import InputError
from ..particles.species import Species
from ..units import ELEMENTARY_CHARGE, SPEED_OF_LIGHT
from . import openpmd_reader

# ASTRA's columns, and the status of particles that are at the cathode still, and of those that fly.
COLUMNS = ("x", "y", "z", "px", "py", "pz", "time", "charge", "index", "status")
LIVING = (-1, 5)
KINDS = {1: "electron", 2: "positron", 3: "proton"}  # by index; others are the user's own
PER_NANO, EV_PER_C = 1e-9, ELEMENTARY_CHARGE / SPEED_OF_LIGHT


@dataclass(frozen=True, eq=False)
class Births:
    """Particles in the order of their births."""

    time: np.ndarray  # (n,) s
    position: np.ndarray  # (n, 3) m
    momentum: np.ndarray  # (n, 3) kg m/s
    weight: np.ndarray  # (n,) real particles

    def sorted(self) -> Births:
        """Return them by ascending times; those of one time as they come."""
        order = np.argsort(self.time, kind="stable")
        return Births(*(values[order] for values in (self.time, self.position, self.momentum, self.weight)))


def read(file: str | Path, species: Species, iteration: int | None = None, group: str | None = None) -> Births:
    """Return the births in a file, by time. Raises InputError if they cannot be used.

    An openPMD file has particles of status 0 (at a cathode) or 1, with times of their own. A text of ten columns is ASTRA's.
    """
    path = Path(file)
    if path.exists() and not h5py.is_hdf5(path):
        return _of_astra(path, species).sorted()
    particles, time = openpmd_reader.births(path, iteration, group, species)
    return Births(time, particles.position, particles.momentum, particles.weight).sorted()


def _of_astra(path: Path, species: Species) -> Births:
    """Return the particles of a text by ASTRA: z, p_z and t of all but the first are relative to those of the first."""
    try:
        table = np.loadtxt(path, ndmin=2)
    except (OSError, ValueError) as error:
        raise InputError(
            f"particle file {path} is no table of numbers ({error}); write it by ASTRA or beamphysics"
        ) from None
    if table.shape[1] != len(COLUMNS) or not np.isfinite(table).all():
        raise InputError(
            f"particle file {path} has {table.shape[1]} columns, or numbers that are not finite, where ASTRA has "
            f"{len(COLUMNS)}: {', '.join(COLUMNS)}; write it anew"
        )
    for column in ("z", "pz", "time"):
        table[1:, COLUMNS.index(column)] += table[0, COLUMNS.index(column)]
    table = table[np.isin(table[:, -1], LIVING)]
    if not len(table):
        raise InputError(
            f"particle file {path} has no particles of status {LIVING[0]} or {LIVING[1]}, which are born; correct the status"
        )
    indices = np.unique(table[:, COLUMNS.index("index")])
    openpmd_reader.require_species(path, {KINDS.get(int(index), "") for index in indices}, species)
    if species.charge == 0:
        raise InputError(f"particle file {path} gives weights as charges, but its species has none; give it another")
    weight = np.abs(table[:, COLUMNS.index("charge")] * PER_NANO / species.charge)
    return Births(table[:, 6] * PER_NANO, table[:, :3], table[:, 3:6] * EV_PER_C, weight)

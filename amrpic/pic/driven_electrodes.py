"""Electrodes of a run: made once, driven by time and by the charge of particles that hit them, and what is recorded of them."""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial
from typing import NamedTuple

import numpy as np

from .. import _native
from ..conductors.metal import refuse_contacts
from ..errors import InputError
from ..mesh.domain import AXES
from ..mpi import MPI
from ..parallel import from_rank_0
from ..scene.electrodes import Electrode
from ..scene.obstacles import Aperture, SolidAperture, aperture_names
from ..scene.scene import Scene
from ..shapes import Box
from ..stages.encounters import native_aperture
from ..units import Column
from .records import Record
from .state import State

THICKNESS = 1e-3  # of what stands for a face of the domain, over the domain's extent


def electrodes_of(comm: MPI.Comm, scene: Scene) -> tuple[tuple[Electrode, ...], list[str]]:
    """Return the electrodes of a scene, of which rank 0 reads files, and remarks on them. Collective; InputError on all."""
    return from_rank_0(comm, partial(compared_electrodes, scene), InputError) if scene.conductors else ((), [])


def compared_electrodes(scene: Scene) -> tuple[tuple[Electrode, ...], list[str]]:
    """Return the electrodes of a scene, and remarks. Serial; InputError for those that touch and for bad files."""
    electrodes = tuple(conductor.value for conductor in scene.conductors)
    domain = scene.domain.value
    spacing = domain.spacing / 2**scene.refinement.levels
    return electrodes, refuse_contacts(electrodes, domain.lower, spacing, walls_of(scene))


class Wall(NamedTuple):
    """A sheet of metal behind a Dirichlet face of the domain."""

    name: str
    shape: Box
    voltage: float


def walls_of(scene: Scene) -> list[Wall]:
    """Return the Dirichlet faces of a domain that have one potential (V) each, whatever its place."""
    domain, out = scene.domain.value, []
    for axis, kinds in enumerate(domain.boundary):
        for end, (kind, given) in enumerate(
            zip(kinds, scene.domain.potential.get(AXES[axis], (0.0, 0.0)), strict=True)
        ):
            if kind != "dirichlet" or isinstance(given, str):
                continue
            corners = np.array([domain.lower, domain.upper])
            beyond = THICKNESS * (corners[1, axis] - corners[0, axis]) * np.array([end - 1, end])
            corners[:, axis] = corners[end, axis] + beyond
            out.append(
                Wall(f"the face {AXES[axis]}_{('lower', 'upper')[end]}", Box(*map(tuple, corners.tolist())), given)
            )
    return out


def obstacles_of(comm: MPI.Comm, scene: Scene, electrodes: Sequence[Electrode]) -> list[_native.Aperture | Electrode]:
    """Return what stops particles: apertures, of which those of metal are among the `electrodes`, and the other electrodes.

    Collective; InputError on all ranks.
    """
    of_any_shape = any(isinstance(aperture, SolidAperture) for aperture in scene.apertures)
    solids = from_rank_0(comm, partial(make_solids, scene), InputError) if of_any_shape else {}
    conductors = {**solids, **{electrode.name: electrode for electrode in electrodes}}
    pairs = zip(aperture_names(scene.apertures), scene.apertures, strict=True)
    apertures = [
        native_aperture(aperture) if isinstance(aperture, Aperture) and not aperture.field else conductors[name]
        for name, aperture in pairs
    ]
    return [*apertures, *electrodes[: len(scene.electrodes)]]


def make_solids(scene: Scene) -> dict[str, Electrode]:
    """Return apertures of any shape by their names. Raises InputError for a file that is no shape."""
    pairs = zip(aperture_names(scene.apertures), scene.apertures, strict=True)
    return {name: Electrode(name, a.shape.value, 0.0) for name, a in pairs if isinstance(a, SolidAperture)}


def collected(comm: MPI.Comm, lost: Record, electrodes: Sequence[Electrode]) -> dict[str, float]:
    """Return the charge of the particles that hit each electrode so far, C. Collective."""
    own_charges = dict(zip(lost.names, lost.charges, strict=True))
    own = np.array([own_charges.get(e.name, 0.0) for e in electrodes])
    return dict(zip((e.name for e in electrodes), comm.allreduce(own).tolist(), strict=True))


def columns_of(electrodes: Sequence[Electrode]) -> list[Column]:
    """Return the columns of the series for electrodes."""
    kinds = (("voltage", "V"), ("charge", "C"), ("hit_charge", "C"), ("current", "A"))
    return [Column(f"{kind}_{e.name}", unit) for e in electrodes for kind, unit in kinds]


class Currents:
    """The rows of electrodes, of states one after the other."""

    def __init__(self, state: State, electrodes: Sequence[Electrode]) -> None:
        self._electrodes = electrodes
        self._time = state.time
        self._supplied = self._of(state)[1]

    def row(self, state: State) -> dict[str, float]:
        """Return what columns of electrodes have of a state. Collective.

        `current` is what the supply of an electrode gives in the mean since the row before: by conservation of charge, the
        change of the charge on it without what particles brought that hit it. In a floating one none flows.
        """
        hit, supplied = self._of(state)
        duration, voltages, charges = state.time - self._time, state.solution.voltages, state.solution.charges
        out: dict[str, float] = {}
        for electrode in self._electrodes:
            name = electrode.name
            flown = 0.0 if electrode.floats else supplied[name] - self._supplied[name]
            out[f"voltage_{name}"], out[f"charge_{name}"] = voltages[name], charges[name]
            out[f"hit_charge_{name}"], out[f"current_{name}"] = hit[name], flown / duration if duration > 0 else 0.0
        self._time, self._supplied = state.time, supplied
        return out

    def _of(self, state: State) -> tuple[dict[str, float], dict[str, float]]:
        """Return the charge that has hit each electrode and what its supply has given it since, C. Collective."""
        if not self._electrodes:
            return {}, {}
        hit = collected(state.hierarchy.comm, state.lost, self._electrodes)
        return hit, {name: charge - hit[name] for name, charge in state.solution.charges.items()}

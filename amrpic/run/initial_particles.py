"""The particles that a scene asks for."""

from __future__ import annotations

from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np
from mpi4py import MPI

from ..errors import InputError
from ..io import openpmd_reader
from ..io.vetting import require_readable_on_all
from ..parallel import share, together
from ..particles.particles import Particles, concatenate
from ..particles.phase_space import PhaseSpace
from ..particles.species import LARGEST_MOMENTUM, Species, SpeciesTable
from ..scene.bunch_files import ArrayBunch, OpenPMDBunch
from ..scene.bunches import Bunch, LatticeBunch, Train
from ..scene.scene import Scene
from ..stages import beam
from ..units import SPEED_OF_LIGHT

NO_SPECIES = Species(charge=1.0, mass=1.0)  # of scenes without bunches


def make_particles(comm: MPI.Comm, scene: Scene) -> Particles:
    """Return this rank's share of all bunches, wherever they lie. Collective; InputError, ParticleError on all ranks."""
    return concatenate(make_bunches(comm, scene))


def make_bunches(comm: MPI.Comm, scene: Scene) -> list[Particles]:
    """Return this rank's share of each bunch, those of trains one by one, after an empty one that knows the species.

    Collective; InputError, ParticleError on all ranks.
    """
    require_readable_on_all(comm, [Path(bunch.file) for bunch in scene.bunches if isinstance(bunch, OpenPMDBunch)])
    parts, first_id = [Particles.empty(SpeciesTable((NO_SPECIES,)))], 0
    runs: list[tuple[int, Species]] = []
    for bunch in scene.bunches:
        with together(comm, InputError):
            made = _bunch(comm, scene, bunch, first_id)
            _require_momenta(made)
        parts += made
        runs.append((first_id, made[0].species.kinds[0]))
        first_id += comm.allreduce(sum(map(len, made)))
    table = SpeciesTable.of_runs(runs or [(0, NO_SPECIES)])
    return [replace(part, species=table) for part in parts]


def _require_momenta(made: list[Particles]) -> None:
    """Raise InputError if momenta of this rank's particles are too large to be true, and for the sums that follow."""
    for bunch in made:
        largest = np.abs(bunch.momentum).max(initial=0.0)
        if largest > LARGEST_MOMENTUM * SPEED_OF_LIGHT * bunch.species.masses.min():
            raise InputError(
                f"a bunch has a momentum of {largest:.3g} kg m/s, more than {LARGEST_MOMENTUM:g} m c; correct momenta"
            )


def _bunch(comm: MPI.Comm, scene: Scene, bunch: Bunch, first_id: int) -> list[Particles]:
    """Return this rank's share of the bunches of a train."""
    match bunch:
        case Train():
            make = partial(_one, comm, scene, bunch)
            return [make(place, first_id + index * bunch.number) for index, place in enumerate(bunch.places())]
        case ArrayBunch():
            return [_from_arrays(comm, bunch, first_id)]
        case OpenPMDBunch():
            return [
                openpmd_reader.read(
                    bunch.file, partial(share, comm), bunch.iteration, bunch.group, bunch.species, first_id
                )
            ]
        case LatticeBunch():
            return [_lattice(comm, scene, bunch, first_id)]
    raise TypeError(f"no way to make {bunch}")


def _one(comm: MPI.Comm, scene: Scene, bunch: Train, place: tuple[float, float, float], first_id: int) -> Particles:
    """Return this rank's share of one bunch of a train."""
    return beam.sampled(
        comm,
        bunch.number,
        bunch.unit,
        PhaseSpace(place, bunch.planes, bunch.mean_momentum),
        bunch_charge=bunch.bunch_charge,
        species=bunch.species,
        sampling=bunch.sampling,
        seed=scene.seed,
        first_id=first_id,
    )


def _from_arrays(comm: MPI.Comm, bunch: ArrayBunch, first_id: int) -> Particles:
    arrays = bunch.arrays()
    position, momenta, weight = arrays["position"], arrays["momenta"], arrays["weight"]
    assert position is not None
    return beam.from_arrays(
        comm,
        position,
        species=bunch.species,
        bunch_charge=bunch.charge_of(len(position)) if weight is None else None,
        weight=weight,
        momentum=bunch.mean_momentum if momenta is None else momenta,
        first_id=first_id,
    )


def _lattice(comm: MPI.Comm, scene: Scene, bunch: LatticeBunch, first_id: int) -> Particles:
    return beam.lattice(
        comm,
        bunch.per_axis,
        scene.domain.lower,
        scene.domain.upper,
        bunch_charge=bunch.bunch_charge,
        species=bunch.species,
        displacement=bunch.displacement,
        waves=bunch.waves,
        momentum=bunch.mean_momentum,
        first_id=first_id,
    )

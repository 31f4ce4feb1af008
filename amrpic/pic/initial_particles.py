"""The particles that a scene asks for."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np

from ..errors import InputError
from ..io import openpmd_reader
from ..io.vetting import require_readable_on_all
from ..mesh.domain import Domain
from ..mpi import MPI
from ..parallel import from_rank_0, share, together
from ..particles.particles import Particles, concatenate
from ..particles.phase_space import PhaseSpace
from ..particles.species import LARGEST_MOMENTUM, Species, SpeciesTable
from ..scene.bunch_files import ArrayBunch, MovedBunch, OpenPMDBunch
from ..scene.bunches import Bunch, LatticeBunch, Train
from ..scene.scene import Scene
from ..stages import beam
from ..units import SPEED_OF_LIGHT
from .tallies import with_sources

SAME_TIME = 1e-12  # relative: times of files that differ by less are rounded otherwise
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
    for number, bunch in enumerate(scene.bunches):
        with together(comm, InputError):
            copies = [_placed(copy, bunch) for copy in _bunch(comm, scene, bunch, first_id)]
            _require_momenta(copies, f"bunches.{number}" + (f" ({bunch.source})" if bunch.source else ""))
        parts += copies
        runs.append((first_id, copies[0].species.kinds[0]))
        first_id += comm.allreduce(sum(map(len, copies)))
    runs = runs or ([] if scene.sources else [(0, NO_SPECIES)])
    table = with_sources(runs, scene)
    return [replace(part, species=table) for part in parts]


def start_of(comm: MPI.Comm, scene: Scene) -> tuple[float, list[str]]:
    """Return the time in s at which a scene starts, and a sentence for the log if that is not plain from the scene.

    Collective; InputError on all ranks if files of bunches are of several times and the scene does not choose one.
    """
    times = from_rank_0(comm, lambda: _times_of_files(scene), InputError)
    chosen = scene.schedule.start
    first, at = times[0] if times else ("", 0.0)
    start = at if chosen is None else chosen
    differing = [(file, time) for file, time in times if not math.isclose(time, start, rel_tol=SAME_TIME)]
    if chosen is None and differing:
        raise InputError(
            f"{first} is of the time {at:g} s, {differing[0][0]} of {differing[0][1]:g} s; set schedule.start to the time of "
            "the run, or move the particles of one of them to the time of the other"
        )
    if chosen is None:
        return start, [f"schedule.start: {start:.6g} s, the time of {first}"] if start else []
    times_of_files = ", ".join(f"{time:.6g} s of {file}" for file, time in differing)
    return start, [f"schedule.start: {start:.6g} s, in place of {times_of_files}"] if differing else []


def _times_of_files(scene: Scene) -> list[tuple[str, float]]:
    """Return the openPMD files of bunches that know their time, and this in s."""
    dated = []
    for bunch in scene.bunches:
        if isinstance(bunch, OpenPMDBunch):
            _, time = openpmd_reader.when(bunch.file, bunch.iteration, bunch.group)
            dated += [] if time is None else [(bunch.file, time)]
    return dated


def _placed(particles: Particles, bunch: Bunch) -> Particles:
    """Return the particles of a bunch turned and moved as it asks for, and without weight if they are test particles."""
    if not bunch.self_field:
        particles = particles.with_weight(np.broadcast_to(0.0, len(particles)))
    if not isinstance(bunch, MovedBunch):
        return particles
    turned, position, momentum = bunch.axes, particles.position, particles.momentum
    if (turned != np.eye(3)).any():
        position, momentum = position @ turned, momentum @ turned
    return particles.replace(position + bunch.shift if any(bunch.shift) else position, momentum)


def _require_momenta(bunches: list[Particles], name: str) -> None:
    """Raise InputError if momenta of this rank's particles are too large to be true, and for the sums that follow."""
    for bunch in bunches:
        largest = np.abs(bunch.momentum).max(initial=0.0)
        if largest > LARGEST_MOMENTUM * SPEED_OF_LIGHT * bunch.species.masses.min():
            raise InputError(
                f"{name} has a momentum of {largest:.3g} kg m/s at id {bunch.id[np.abs(bunch.momentum).max(axis=1).argmax()]}, "
                f"more than {LARGEST_MOMENTUM:g} m c; correct momenta"
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


# ---- particles outside the domain ----


def outside(comm: MPI.Comm, bunches: Sequence[Particles], domain: Domain) -> list[str]:
    """Return a sentence for each bunch of which particles are outside. Collective.

    Raises InputError on all ranks if more than half of a bunch, but not all of all, are.
    """
    walls = ~np.array(domain.periodic)
    lower, upper = np.array(domain.lower)[walls], np.array(domain.upper)[walls]
    counts = [
        (len(bunch), int(((bunch.position[:, walls] < lower) | (bunch.position[:, walls] > upper)).any(axis=1).sum()))
        for bunch in bunches
    ]
    of_all = comm.allreduce(np.array(counts, dtype=np.int64).reshape(-1, 2))
    worst = int(np.argmax(2 * of_all[:, 1] - of_all[:, 0]))
    total, outside = of_all[worst].tolist()
    if 2 * outside > total and of_all[:, 1].sum() < of_all[:, 0].sum():
        raise InputError(
            f"{outside} of {total} particles of bunch {worst} of {len(bunches) - 1} lie outside the domain; "
            "move the bunch (one from a file by its shift), make it smaller, or enlarge the domain"
        )
    return [
        f"{outside} of {total} particles of bunch {number} of {len(bunches) - 1} lie outside the domain at the start: lost"
        for number, (total, outside) in enumerate(of_all.tolist())
        if 0 < outside < total
    ]


def require_some_inside(comm: MPI.Comm, inside: Particles, total: int) -> None:
    """Raise InputError on all ranks if none of the particles that were made is inside the domain. Collective."""
    if total > 0 and inside.global_count(comm) == 0:
        raise InputError(
            f"all {total} particles of the scene lie outside the domain; move the bunches (those from files by "
            "their shift) or enlarge it"
        )

"""The particles that a scene asks for."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
from mpi4py import MPI

from . import beam
from .bunches import ArrayBunch, Bunch, GaussianBunch, LatticeBunch, SphereBunch, Train
from .errors import InputError
from .parallel import together
from .particles import Particles, concatenate
from .scene import Scene
from .species import Species, SpeciesTable


def make_particles(comm: MPI.Comm, scene: Scene) -> Particles:
    """Return this rank's share of all bunches, wherever they lie. Collective; InputError, ParticleError on all ranks."""
    parts: list[Particles] = []
    runs, first_id = [(0, Species(charge=1.0, mass=1.0))] if not scene.bunches else [], 0
    for bunch in scene.bunches:
        with together(comm, InputError):
            made = _bunch(comm, scene, bunch, first_id)
        parts += made
        runs.append((first_id, bunch.species))
        first_id += comm.allreduce(sum(map(len, made)))
    species = SpeciesTable.of_runs(runs)
    return concatenate([Particles.empty(species), *(replace(part, species=species) for part in parts)])


def _bunch(comm: MPI.Comm, scene: Scene, bunch: Bunch, first_id: int) -> list[Particles]:
    """Return this rank's share of the bunches of a train."""
    if isinstance(bunch, ArrayBunch):
        return [_from_arrays(comm, bunch, first_id)]
    if isinstance(bunch, LatticeBunch):
        return [_lattice(comm, scene, bunch, first_id)]
    assert isinstance(bunch, Train)
    places = enumerate(bunch.places())
    return [_one(comm, scene, bunch, place, first_id + index * bunch.number) for index, place in places]


def _one(comm: MPI.Comm, scene: Scene, bunch: Train, place: tuple[float, float, float], first_id: int) -> Particles:
    """Return one bunch of a train."""
    common: dict[str, Any] = {
        "centre": place,
        "bunch_charge": bunch.bunch_charge,
        "species": bunch.species,
        "momentum": bunch.mean_momentum,
        "momentum_sigma": bunch.momentum_spread,
        "seed": scene.seed,
        "first_id": first_id,
    }
    if isinstance(bunch, GaussianBunch):
        return beam.gaussian(comm, bunch.number, sigma=bunch.sigma, **common)
    assert isinstance(bunch, SphereBunch)
    return beam.uniform_sphere(comm, bunch.number, radius=bunch.radius, **common)


def _from_arrays(comm: MPI.Comm, bunch: ArrayBunch, first_id: int) -> Particles:
    arrays = bunch.arrays()
    position, momenta, weight = arrays["position"], arrays["momenta"], arrays["weight"]
    assert position is not None
    if momenta is None:
        momenta = np.broadcast_to(np.array(bunch.mean_momentum), position.shape)
    total = None if weight is not None else bunch.charge_of(len(position))
    return beam.from_arrays(
        comm,
        position,
        species=bunch.species,
        bunch_charge=total,
        weight=weight,
        momentum=momenta,
        first_id=first_id,
    )


def _lattice(comm: MPI.Comm, scene: Scene, bunch: LatticeBunch, first_id: int) -> Particles:
    domain = scene.domain
    axes = []
    for axis in range(3):
        width, number = domain.upper[axis] - domain.lower[axis], bunch.per_axis[axis]
        offset = (np.arange(number) + 0.5) / max(number, 1)
        shift = bunch.displacement[axis] * np.sin(2 * np.pi * bunch.waves[axis] * offset)
        axes.append(domain.lower[axis] + width * offset + shift)
    position = np.stack(np.meshgrid(*axes, indexing="ij")).reshape(3, -1).T
    return beam.from_arrays(
        comm,
        position,
        species=bunch.species,
        bunch_charge=bunch.bunch_charge,
        momentum=np.broadcast_to(np.array(bunch.mean_momentum), position.shape),
        first_id=first_id,
    )

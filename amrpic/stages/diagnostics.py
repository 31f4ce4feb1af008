"""What is measured of a state: pure reductions over all ranks."""

from __future__ import annotations

import resource
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from .. import _native
from ..mesh.domain import AXES, Domain
from ..mesh.field import Compensation, Field, VectorField
from ..mesh.hierarchy import Hierarchy
from ..mpi import MPI
from ..parallel import global_sum, global_sums_and_largest
from ..particles.images import Images, periods
from ..particles.particles import Particles
from ..units import VACUUM_PERMITTIVITY, Column

ALL = _native.BeamParts([0], [0], [0.0], [0.0])  # as one part of a beam
STAGES = ("beam", "migrate", "regrid", "deposit", "solve", "push", "output")


def quantities(levels: int) -> list[Column]:
    """Return what `measure` gives for hierarchies of up to `levels` levels, in the order of the time series."""
    return [
        Column("step", counts=True),
        Column("time", "s"),
        Column("s", "m"),  # path length of the reference particle
        *(Column(f"window_{axis}", "m") for axis in AXES),  # origin of the mesh's coordinates
        *(Column(f"cells_{level}", counts=True) for level in range(levels)),
        Column("boxes", counts=True),
        Column("regridded", counts=True),  # 1 where the step changed the mesh
        Column("particles", counts=True),
        Column("lost_particles", counts=True),
        Column("charge", "C"),
        Column("lost_charge", "C"),
        Column("field_energy", "J"),
        Column("potential_energy", "J"),
        Column("kinetic_energy", "J"),
        *(Column(f"momentum_{axis}", "kg m/s") for axis in AXES),
        *(Column(f"mean_{axis}", "m") for axis in AXES),
        *(Column(f"rms_{axis}", "m") for axis in AXES),
        *(Column(f"emittance_{axis}", "m rad") for axis in AXES),
        Column("cycles", counts=True),
        Column("residual"),
        Column("imbalance_cells"),  # the most of a rank over the mean
        Column("imbalance_particles"),
        Column("memory", "B", counts=True),
        Column("seconds", "s"),
        *(Column(f"seconds_{stage}", "s") for stage in STAGES),
    ]


def measure(
    particles: Particles,
    beam: Moments,
    lost: tuple[int, float],
    rho: Field,
    phi: Field,
    efield: VectorField,
    seconds: Mapping[str, float],
    in_metal: Sequence[np.ndarray] = (),
) -> dict[str, float]:
    """Return what can be measured of particles, whose moments are known, and fields at one time. Collective.

    `charge` is that of the composite grid. `seconds` per stage are those of the slowest rank; levels that do not exist
    have no entry. `lost`: how many particles of this rank, and their charge, C. `in_metal` (n,) of each level: this rank's
    cells of no field energy.
    """
    hierarchy = rho.hierarchy
    of_all = global_sums_and_largest(
        hierarchy.comm,
        {
            "particles": len(particles),
            "lost_particles": lost[0],
            "charge": rho.own_integral(),
            "lost_charge": lost[1],
            "field_energy": _energy_of_square(_outside(efield, in_metal).own_integral_of_square()),
            "potential_energy": _energy_of_product(_own_product(rho, phi, efield.compensation)),
        },
        {
            **{f"seconds_{stage}": seconds.get(stage, 0.0) for stage in STAGES},
            "memory": peak_memory(),
            "imbalance_cells": hierarchy.own_cells,
            "imbalance_particles": len(particles),
        },
    )
    cells = hierarchy.cells()
    for name, total in (("imbalance_cells", cells), ("imbalance_particles", of_all["particles"])):
        of_all[name] *= hierarchy.comm.size / max(total, 1)
    return {
        **{f"cells_{level}": hierarchy.cells(level) for level in range(hierarchy.levels)},
        "boxes": box_count(hierarchy),
        **of_all,
        "kinetic_energy": beam.kinetic_energy,
        **{f"momentum_{axis}": beam.momentum[i] for i, axis in enumerate(AXES)},
        **{f"mean_{axis}": beam.mean[i] for i, axis in enumerate(AXES)},
        **{f"rms_{axis}": beam.rms[i] for i, axis in enumerate(AXES)},
        **{f"emittance_{axis}": beam.emittance[i] for i, axis in enumerate(AXES)},
    }


def _outside(efield: VectorField, in_metal: Sequence[np.ndarray]) -> VectorField:
    """Return a field that is 0 in metal, into which E goes on for clouds that reach there; `in_metal` (n,) of each level."""
    if not in_metal:
        return efield
    components = [component.copy() for component in efield.components]
    for component in components:
        for level, cells in enumerate(in_metal):
            component.array(level)[cells] = 0
    return VectorField(*components)


def box_count(hierarchy: Hierarchy) -> int:
    """Return the number of boxes of all levels."""
    return sum(len(hierarchy.boxes(level)) for level in range(hierarchy.levels))


def field_energy(efield: VectorField) -> float:
    """Return ½ ε₀ ∫ E² dV over the domain in J. Collective.

    What the field holds outside an open domain is not in it.
    """
    return _energy_of_square(efield.integral_of_square())


def potential_energy(rho: Field, phi: Field, compensation: Compensation | None = None) -> float:
    """Return ½ ∫ ρ φ dV in J, which in free space is the energy of the field in all of it. Collective.

    With the potential φ + κρ that particles feel, if there is a compensation.
    """
    return _energy_of_product(global_sum(rho.comm, _own_product(rho, phi, compensation)))


def _own_product(rho: Field, phi: Field, compensation: Compensation | None) -> float:
    return rho.own_integral(phi) if compensation is None else rho.own_energy_integral(phi, compensation)


def _energy_of_square(integral: float) -> float:
    return 0.5 * VACUUM_PERMITTIVITY * integral


def _energy_of_product(integral: float) -> float:
    return 0.5 * integral


@dataclass(frozen=True)
class Moments:
    """What is measured of a beam, in which each particle counts as the real ones that it stands for.

    Mean position, rms size about it (m) and normalised rms emittance (m rad) along x, y, z, nan without particles; total
    momentum (kg m/s) and kinetic energy (J); the rms size round each axis on which space repeats over its period, else 0.
    """

    mean: np.ndarray
    rms: np.ndarray
    emittance: np.ndarray
    momentum: np.ndarray
    kinetic_energy: float
    fill: np.ndarray


def moments(
    comm: MPI.Comm,
    particles: Particles,
    later: Particles | None = None,
    weight: float = 0.0,
    domain: Domain | None = None,
) -> Moments:
    """Return the moments of all particles, which are read once, or twice where the domain is periodic. Collective.

    With `later`, the same particles at another time, momenta are the mean of both in which those have this `weight`. Where
    none has a weight, as of test particles alone, each counts as one. Along periodic axes of the `domain` the images of
    particles count that are nearest to their circular mean: see `Images`.
    """
    to = particles if later is None else later
    images, sums = _images_and_sums(comm, particles, to, weight, domain)
    if not sums.weight > 0:
        ones = particles.with_weight(np.broadcast_to(1.0, len(particles)))
        images, sums = _images_and_sums(comm, ones, to, weight, domain)
    totals = np.array(sums.momentum), sums.kinetic_energy
    if not sums.weight > 0:
        unknown = np.full(3, np.nan)
        return Moments(unknown, unknown, unknown, *totals, np.zeros(3))
    xx, uu, xu = (np.array(products) / sums.weight for products in (sums.xx, sums.uu, sums.xu))
    mean = np.array(sums.mean_x)
    mean += images.about(mean, domain).centre - images.centre
    return Moments(mean, np.sqrt(xx), np.sqrt(np.maximum(xx * uu - xu**2, 0)), *totals, images.fill)


def _images_and_sums(
    comm: MPI.Comm, particles: Particles, to: Particles, weight: float, domain: Domain | None
) -> tuple[Images, _native.BeamSums]:
    """Return which images of particles count, and the sums over these. Collective."""
    beam = (comm.py2f(), *particles.arrays, particles.mass, to.momentum, weight)
    circular = np.zeros(8)
    if domain is not None and any(domain.periodic):
        (circular,) = np.array(_native.circular_sums(*beam, ALL, domain.lower, periods(domain)))
    images = Images.of(circular, domain)
    return images, _native.beam_sums(*beam, images.centre.tolist(), images.period.tolist())


def peak_memory() -> int:
    """Return the most memory in bytes that this process has used at a time."""
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * 1024

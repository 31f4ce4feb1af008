"""What must stay: charge, the two forms of the field energy, momentum and energy of a plasma, the cycles after a regrid."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from typing import get_args

import numpy as np
from mpi4py import MPI

from amrpic.mesh.domain import BoundarySpec
from amrpic.mesh.field import Field
from amrpic.particles.clouds import Clouds, Shape
from amrpic.particles.particles import Particles
from amrpic.particles.species import Species, SpeciesTable
from amrpic.pic.state import State
from amrpic.pic.step import advance, begin
from amrpic.scene.scene import Scene
from amrpic.stages.deposit import deposit
from amrpic.stages.diagnostics import Moments, field_energy, moments, potential_energy
from amrpic.stages.migrate import migrate
from amrpic.stages.poisson import PoissonSolver
from amrpic.stages.regrid import carry_over
from amrpic.units import ELECTRON_MASS, ELEMENTARY_CHARGE
from amrpic.verify.table import Cell, Goal, Table
from exact.errors import observed_order
from exact.meshes import MESHES, Mesh
from exact.sources import EPS0, Gaussian, Source, fill

from . import image_force

CELLS = (16, 24, 32, 48)
BUNCH = Gaussian((0.08, 0.07, 0.09), (0.5, 0.5, 0.5))


def tables(comm: MPI.Comm) -> Iterator[Table]:
    """The tables of this topic. Collective."""
    yield Table(
        "Conservation of charge",
        "5000 particles of either sign all over the domain, some within a rounding error of its walls, on three levels that "
        "touch them; clouds of each shape, own-level and matched, the worse of the two. Charge on the mesh less that of the "
        "particles; after the density is carried over to another mesh; of the base alone, whose covered cells hold the means "
        "of finer ones. Over the sum of all magnitudes of charge.",
        ("clouds", "faces", "deposition", "regridding", "restriction"),
        [
            [shape, name, *_charge(comm, shape, boundary)]
            for shape in get_args(Shape)
            for name, boundary in FACES.items()
        ],
    )
    yield Table(
        "Energy of the field",
        "½ ∫ ρφ against ½ ε₀ ∫ E² inside open faces plus ½ ε₀ ∮ φ E·n over them (of the exact φ and E): an ellipsoidal "
        "Gaussian, relative difference on the finest mesh, and its order.",
        ("mesh", "difference", "order"),
        [[name, *_energies(comm, MESHES[name])] for name in ("uniform", "nested cubes", "patch at a face")],
    )
    yield image_force.table(comm)
    yield Table(
        "An isolated plasma for ten plasma periods",
        "Warm electrons in a cloud of protons, half of them inside a refined cube, open faces. Momentum of all particles over "
        "the rms momentum of the electrons times their number; charge against that of the particles inside. Fast electrons "
        "leave: what they take along of the energy is their kinetic energy, and their charge times the potential that the rest "
        "makes where they cross the wall.",
        ("quantity", "largest"),
        _plasma(comm),
    )
    yield Table(
        "Potential carried over a regrid",
        "Most cycles to 1e-10 of a step that starts from the potential of the step before: a bunch flies across the domain "
        "with its mesh, half a cell of the finest level in each step.",
        ("levels", "steps that keep the mesh", "steps that change it", "without a guess"),
        [[levels, *_carried(comm, levels)] for levels in (1, 2, 3)],
    )


# ---- charge ----


FACES: Mapping[str, BoundarySpec] = {
    **{name: name for name in ("open", "dirichlet", "neumann", "periodic")},
    "periodic along x": {"x": "periodic", "y": ("dirichlet", "neumann"), "z": "dirichlet"},
}
TOUCHING = Mesh(((((0, 0, 0), (8, 8, 5)),), (((0, 0, 1), (2, 4, 4)),)))  # walls, along x and y as periodic ones allow
BESIDE = Mesh(((((0, 0, 3), (8, 8, 8)),), (((5, 5, 4), (8, 8, 7)),)))  # and other ones


def _charge(comm: MPI.Comm, shape: Shape, boundary: BoundarySpec) -> list[Cell]:
    hierarchy, other = (mesh.hierarchy(comm, 16, boundary, max_grid_size=8) for mesh in (TOUCHING, BESIDE))
    particles, _ = migrate(_everywhere(comm), hierarchy)
    inside, scale = particles.total_charge(comm), float(comm.allreduce(particles.weight @ np.abs(particles.charge)))
    worst = np.zeros(3)
    for matched in (False, True):
        rho = deposit(particles, hierarchy, Clouds(shape, matched))
        carried = carry_over(rho, other)
        base = sum(float(p.data.sum()) for p in rho.copy().average_down().patches if p.level == 0)
        base = comm.allreduce(base) * float(np.prod(hierarchy.spacing(0)))
        worst = np.maximum(worst, np.abs(np.array([rho.integral(), carried.integral(), base]) - inside) / scale)
    return [Goal(float(w), 1e-14) for w in worst]


def _everywhere(comm: MPI.Comm, count: int = 5000) -> Particles:
    """Particles of two species all over the unit cube, the first thirty at its walls; all on rank 0."""
    rng = np.random.default_rng(3)
    position = rng.uniform(0, 1, (count, 3))
    for number in range(30):
        position[number, number % 3] = (0.0, 1e-17, np.nextafter(1, 0))[number % 9 // 3]
    mine = slice(None) if comm.rank == 0 else slice(0)
    kinds = SpeciesTable.of_runs([(0, Species(charge=1.0, mass=1.0)), (count // 3, Species(charge=-1.0, mass=1.0))])
    weight = rng.uniform(1, 2, count)
    return Particles(position[mine], np.zeros((count, 3))[mine], weight[mine], np.arange(count)[mine], kinds)


# ---- energy ----


def _energies(comm: MPI.Comm, mesh: Mesh) -> list[Cell]:
    surface = _surface_energy(BUNCH)
    differences = []
    for cells in CELLS:
        hierarchy = mesh.hierarchy(comm, cells, "open")
        solver = PoissonSolver(hierarchy)
        rho = fill(Field(hierarchy), BUNCH)
        phi, _ = solver.solve(rho)
        by_charge = potential_energy(rho, phi)
        differences.append(abs(field_energy(solver.electric_field(phi)) + surface - by_charge) / by_charge)
    return [differences[-1], Goal(observed_order(CELLS, differences), 1.9, least=True)]


def _surface_energy(source: Source) -> float:
    """½ ε₀ ∮ φ E·n dA over the unit cube, by Gauss-Legendre."""
    nodes, weights = np.polynomial.legendre.leggauss(40)
    u, v = np.meshgrid((nodes + 1) / 2, (nodes + 1) / 2, indexing="ij")
    weight, total = np.outer(weights, weights) / 4, 0.0
    for axis in range(3):
        for face, side in ((0.0, -1), (1.0, 1)):
            place = [u, v]
            place.insert(axis, np.full_like(u, face))
            total += side * float(np.sum(weight * source.potential(*place) * source.field(*place)[axis]))
    return 0.5 * EPS0 * total


# ---- momentum and charge ----


def _plasma(comm: MPI.Comm) -> list[list[Cell]]:
    sigma, particles, electrons = 1e-3, 20_000, 1e6
    density = electrons / ((2 * math.pi) ** 1.5 * sigma**3)
    frequency = math.sqrt(density * ELEMENTARY_CHARGE**2 / (ELECTRON_MASS * EPS0))
    warm = 0.2 * sigma * frequency * ELECTRON_MASS  # a Debye length of a fifth of the cloud
    kind = {"distribution": "gaussian", "sigma": sigma, "particles": particles}
    charge = electrons * ELEMENTARY_CHARGE
    scene = {
        "domain": {"lower": -8 * sigma, "upper": 8 * sigma, "cells": 32},
        "bunches": [
            {**kind, "species": "electron", "charge": -charge, "momentum_spread": warm},
            {**kind, "species": "proton", "charge": charge},
        ],
        "refinement": {
            "levels": 1,
            "rule": {"kind": "static", "boxes": [{"level": 1, "lower": -2 * sigma, "upper": 2 * sigma}]},
        },
        "motion": {"kind": "leapfrog", "dt": 0.2 / frequency},
    }
    state, setup = begin(comm, Scene.from_dict(scene))
    energy, gone, worst_momentum, worst_charge = _energy(state), 0.0, 0.0, 0.0
    scale = electrons * warm * math.sqrt(3)
    start = _beam(state).momentum
    for _ in range(round(10 * 2 * math.pi / 0.2)):
        before, state = len(state.lost.particles), advance(state, setup)
        gone += _energy_of_lost(state, before)
        drift = _beam(state).momentum + moments(comm, state.lost.particles).momentum - start
        worst_momentum = max(worst_momentum, float(np.abs(drift).max()) / scale)
        inside = state.particles.total_charge(comm)
        worst_charge = max(worst_charge, abs(deposit(state.particles, state.hierarchy).integral() - inside) / charge)
    return [
        ["momentum over rms momentum", Goal(worst_momentum, 1e-3)],
        ["charge on the mesh, less that of the particles, over that of the electrons", Goal(worst_charge, 1e-13)],
        ["energy of particles and field, relative change", Goal(abs((_energy(state) + gone) / energy - 1), 2e-3)],
        ["the same without what particles took along", abs(_energy(state) / energy - 1)],
    ]


def _energy_of_lost(state: State, known: int) -> float:
    """What the particles that left in the latest step took along, J; this rank knew so many before. Collective.

    The potential is that of all others, for the state is without them.
    """
    comm, domain, lost = state.rho.comm, state.hierarchy.domain, state.lost.particles
    new = lost.select(np.arange(known, len(lost)))
    at_wall = np.clip(new.position, domain.lower, np.nextafter(domain.upper, domain.lower))
    places, charges = comm.allgather(at_wall), comm.allgather(new.weight * new.charge)
    potential = state.phi.sample(np.concatenate(places))
    return moments(comm, new).kinetic_energy + float(np.concatenate(charges) @ potential)


def _energy(state: State) -> float:
    return _beam(state).kinetic_energy + potential_energy(state.rho, state.phi, state.efield.compensation)


def _beam(state: State) -> Moments:
    return state.moments()


# ---- regridding ----


def _carried(comm: MPI.Comm, levels: int) -> list[Cell]:
    """Most cycles of steps that keep the mesh, of steps that change it, and of a solve without a guess."""
    cell = 1 / 32 / 2**levels
    bunch = {
        "distribution": "gaussian",
        "sampling": "sobol",
        "sigma": 0.04,
        "particles": 2**15,
        "centre": [0.3, 0.5, 0.5],
        "charge": 1e-26,  # so little that it keeps its shape
        "velocity": [cell / 2, 0.3 * cell, 0],
    }
    scene = {
        "domain": {"lower": 0, "upper": 1, "cells": 32},
        "bunches": [bunch],
        "refinement": {"levels": levels, "regrid_every": 2},
        "motion": {"kind": "leapfrog", "dt": 1.0},
    }
    state, setup = begin(comm, Scene.from_dict(scene))
    cold = state.report.cycles
    most = {False: 0, True: 0}
    for _ in range(24):
        state = advance(state, setup)
        most[state.regridded] = max(most[state.regridded], state.report.cycles)
    return [most[False], Goal(most[True] or math.nan, most[False]), cold]

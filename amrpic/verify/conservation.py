"""What must stay: charge, the two forms of the field energy, the momentum of an isolated bunch, the cycles after a regrid."""

from __future__ import annotations

import math
from collections.abc import Iterator

import numpy as np
from mpi4py import MPI

from ..deposit import deposit
from ..diagnostics import field_energy, kinetic_energy, potential_energy, total_momentum
from ..field import Field
from ..plan import Plan
from ..poisson import PoissonSolver
from ..regrid import carry_over
from ..scene import Scene
from ..step import State, advance, begin
from ..units import ELECTRON_MASS, ELEMENTARY_CHARGE
from .errors import observed_order
from .meshes import MESHES, Mesh
from .sources import EPS0, Gaussian, Source, fill
from .table import Cell, Goal, Table

CELLS = (16, 24, 32, 48)
BUNCH = Gaussian((0.08, 0.07, 0.09), (0.5, 0.5, 0.5))


def tables(comm: MPI.Comm) -> Iterator[Table]:
    """The tables of this topic. Collective."""
    yield Table(
        "Energy of the field",
        "½ ∫ ρφ against ½ ε₀ ∫ E² inside open faces plus ½ ε₀ ∮ φ E·n over them (of the exact φ and E): an ellipsoidal "
        "Gaussian, relative difference on the finest mesh, and its order.",
        ("mesh", "difference", "order"),
        [[name, *_energies(comm, MESHES[name])] for name in ("uniform", "nested cubes", "patch at a face")],
    )
    yield Table(
        "An isolated plasma for ten plasma periods",
        "Warm electrons in a cloud of protons, half of them inside a refined cube, open faces. Momentum of all particles over "
        "the rms momentum of the electrons times their number; charge against that of the particles inside.",
        ("quantity", "largest"),
        _plasma(comm),
    )
    yield Table(
        "Potential carried over a regrid",
        "Cycles to 1e-10 with the potential of the same charge on the mesh before as guess, and without a guess.",
        ("from", "to", "cycles with the guess", "cycles without"),
        [[a, b, *_carried(comm, a, b)] for a, b in (("uniform", "nested cubes"), ("nested cubes", "disjoint patches"))],
    )


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
    plan = Plan(comm, Scene.from_dict(scene))
    state = begin(plan)
    energy, worst_momentum, worst_charge = _energy(state), 0.0, 0.0
    scale = electrons * warm * math.sqrt(3)
    start = total_momentum(comm, state.particles)
    for _ in range(round(10 * 2 * math.pi / 0.2)):
        state = advance(state, plan)
        drift = total_momentum(comm, state.particles) + total_momentum(comm, state.lost.particles) - start
        worst_momentum = max(worst_momentum, float(np.abs(drift).max()) / scale)
        inside = state.particles.total_charge(comm)
        worst_charge = max(worst_charge, abs(deposit(state.particles, state.hierarchy).integral() - inside) / charge)
    return [
        ["momentum over rms momentum", Goal(worst_momentum, 1e-3)],
        ["charge on the mesh, less that of the particles, over that of the electrons", Goal(worst_charge, 1e-13)],
        ["energy of particles and field, relative change at the end", abs(_energy(state) / energy - 1)],
    ]


def _energy(state: State) -> float:
    return kinetic_energy(state.rho.comm, state.particles) + potential_energy(state.rho, state.phi)


# ---- regridding ----


def _carried(comm: MPI.Comm, before: str, after: str) -> list[Cell]:
    first, second = (MESHES[name].hierarchy(comm, 32, "open") for name in (before, after))
    phi, _ = PoissonSolver(first).solve(fill(Field(first), BUNCH))
    solver = PoissonSolver(second)
    rho = fill(Field(second), BUNCH)
    _, warm = solver.solve(rho, guess=carry_over(phi, second))
    _, cold = solver.solve(rho)
    return [Goal(warm.cycles if warm.converged else math.nan, cold.cycles), cold.cycles]

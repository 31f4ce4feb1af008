"""The force of a particle on itself near coarse-fine faces, edges and corners, and what it does to a bunch that crosses one."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace

import numpy as np
from mpi4py import MPI

from amrpic.mesh.hierarchy import Hierarchy
from amrpic.particles.clouds import Clouds
from amrpic.particles.particles import Particles
from amrpic.particles.species import Species, SpeciesTable
from amrpic.pic.step import advance, begin
from amrpic.scene.scene import Scene
from amrpic.stages.deposit import deposit
from amrpic.stages.diagnostics import moments
from amrpic.stages.gather import compensate, gather
from amrpic.stages.migrate import migrate
from amrpic.stages.poisson import PoissonSolver
from amrpic.units import ELECTRON_MASS, ELEMENTARY_CHARGE
from amrpic.verify.table import Cell, Goal, Table
from exact.meshes import Mesh
from exact.sources import EPS0

from .curves import Curves

CELLS = 24
FINE = 1 / (2 * CELLS)  # m, width of a fine cell
DISTANCES = np.arange(-3, 5, 0.25)  # in fine cells; inside is positive
OFFSETS = np.array([[0.0, 0.0], [0.25, 0.5], [0.5, 0.25], [0.5, 0.5], [0.75, 0.1]])  # along the face, in fine cells
MODES: Mapping[str, Clouds] = {"own-level": Clouds(), "matched": Clouds(matched=True)}
COMPENSATED: Mapping[str, Clouds] = {mode: replace(clouds, compensation="clouds") for mode, clouds in MODES.items()}
NOT_WORSE = 1.1  # the largest force with compensation over that without
INSIDE = "distance inside, fine cells"
UNIT = Species(charge=1.0, mass=1.0)


@dataclass(frozen=True)
class Place:
    """A spot on the edge of a refined region: where it is, which way is inside, and the bound for matched clouds."""

    mesh: Mesh
    at: tuple[float, float, float]  # m
    inside: tuple[int, int, int]
    bound: float  # of the force, in q²/(4πε₀h²) of the fine cells


CUBE = Mesh(((((2, 2, 2), (6, 6, 6)),),))
ELL = Mesh(((((2, 2, 2), (6, 4, 6)), ((2, 4, 2), (4, 6, 6))),))
BITTEN = Mesh(((((2, 2, 2), (6, 6, 4)), ((2, 2, 4), (4, 6, 6)), ((4, 2, 4), (6, 4, 6))),))
PLACES: Mapping[str, Place] = {
    "face": Place(CUBE, (0.25, 0.5, 0.5), (1, 0, 0), 1.5e-2),
    "edge": Place(CUBE, (0.25, 0.25, 0.5), (1, 1, 0), 2.5e-2),
    "convex corner": Place(CUBE, (0.25, 0.25, 0.25), (1, 1, 1), 4e-2),
    "concave edge": Place(ELL, (0.5, 0.5, 0.5), (-1, -1, 0), 2.5e-2),
    "concave corner": Place(BITTEN, (0.5, 0.5, 0.5), (-1, -1, -1), 4e-2),
}


def tables(comm: MPI.Comm) -> Iterator[Table]:
    """The tables of this topic. Collective."""
    yield _map(comm)
    fine = _end_of_flight(comm, "own-level", levels=0)
    yield Table(
        "A bunch that drifts across a coarse-fine face",
        "40 000 electrons, quiet start, half a plasma period while the bunch crosses the face of a static box; against "
        "the same run on a mesh that is fine everywhere. Change of the rms emittance, and of the mean momentum over its rms.",
        ("clouds", "emittance x", "emittance y", "emittance z", "mean momentum"),
        [[interface, *_crossing(comm, interface, fine)] for interface in ("auto", "matched")],
    )


def _map(comm: MPI.Comm) -> Table:
    rows: list[list[Cell]] = []
    curves = {}
    for name, place in PLACES.items():
        found = {mode: _along(comm, place, clouds) for mode, clouds in MODES.items()}
        peak = {mode: float(force.max()) for mode, force in found.items()}
        worst = {mode: float(_along(comm, place, clouds).max()) for mode, clouds in COMPENSATED.items()}
        deep = float(found["own-level"][DISTANCES >= 4].max())
        rows.append(
            [
                name,
                peak["own-level"],
                Goal(worst["own-level"], NOT_WORSE * peak["own-level"]),
                Goal(peak["matched"], place.bound),
                Goal(worst["matched"], NOT_WORSE * peak["matched"]),
                deep,
            ]
        )
        for mode, force in found.items():
            curves[f"{name}, {mode}"] = (DISTANCES.tolist(), force.tolist())
    return Curves(
        "Force of a particle on itself",
        "One particle, cloud-in-cell, at distances from -3 to 4.75 fine cells inside a refined region and at five places "
        "along it: the largest force, in q²/(4πε₀h²) of the fine cells. Beside a concave edge or corner it is the particle "
        "outside, among coarse cells with finer ones on two or three sides, that feels itself most; it keeps the bounds of the "
        "convex ones. Compensated clouds must not make it worse by more than a tenth.",
        ("beside", "own-level", "compensated", "matched", "compensated", "own-level, from 4 cells inside"),
        rows,
        curves=curves,
        across=INSIDE,
        upwards="force on itself, q²/(4πε₀h²)",
        by_line=True,
    )


def _along(comm: MPI.Comm, place: Place, clouds: Clouds) -> np.ndarray:
    """The largest force over the offsets, per distance."""
    hierarchy = place.mesh.hierarchy(comm, CELLS, "open")
    solver = PoissonSolver(hierarchy, tolerance=1e-9)
    inside = np.array(place.inside)
    free = np.flatnonzero(inside == 0)
    largest = []
    for distance in DISTANCES:
        forces = []
        for offset in OFFSETS if len(free) else OFFSETS[:1]:
            at = np.array(place.at) + inside * distance * FINE
            at[free] += offset[: len(free)] * FINE
            forces.append(_force(solver, hierarchy, at, clouds))
        largest.append(max(forces))
    return np.array(largest)


def _force(solver: PoissonSolver, hierarchy: Hierarchy, at: np.ndarray, clouds: Clouds) -> float:
    """Force of a unit charge on itself, in q²/(4πε₀h²). Collective."""
    comm = hierarchy.comm
    count = 1 if comm.rank == 0 else 0
    made = Particles(
        np.tile(at, (count, 1)),
        np.zeros((count, 3)),
        np.ones(count),
        np.arange(count),
        SpeciesTable((UNIT,)),
    )
    particles, _ = migrate(made, hierarchy)
    rho = deposit(particles, hierarchy, clouds)
    efield = solver.electric_field(solver.solve(rho)[0], covered=clouds.covered)
    compensate(efield, rho, clouds)
    field = gather(efield, particles, clouds)
    strength = comm.allreduce(float(np.linalg.norm(field)), op=MPI.MAX)
    return strength * 4 * np.pi * EPS0 * FINE**2


def _crossing(comm: MPI.Comm, interface: str, fine: Flight) -> list[Cell]:
    refined = _end_of_flight(comm, interface, levels=1)
    emittance = np.abs(refined.emittance / fine.emittance - 1)
    momentum = float(np.abs(refined.momentum - fine.momentum).max() / fine.rms_momentum)
    return [*(Goal(float(e), 1e-2) for e in emittance), Goal(momentum, 1e-3)]


@dataclass(frozen=True)
class Flight:
    """A bunch at the end: rms emittance (m rad), mean momentum per axis and its rms (kg m/s)."""

    emittance: np.ndarray
    momentum: np.ndarray
    rms_momentum: float


def _end_of_flight(comm: MPI.Comm, interface: str, levels: int) -> Flight:
    sigma, electrons, number, steps = 1e-3, 1e7, 40_000, 40
    density = electrons / ((2 * np.pi) ** 1.5 * sigma**3)
    frequency = np.sqrt(density * ELEMENTARY_CHARGE**2 / (ELECTRON_MASS * EPS0))
    period = 2 * np.pi / frequency
    velocity = 6 * sigma / (period / 2)  # from 3 sigma before the face to 3 sigma behind it
    spread = 0.05 * sigma * frequency * ELECTRON_MASS
    bunch = {
        "distribution": "gaussian",
        "sampling": "sobol",
        "species": "electron",
        "sigma": sigma,
        "charge": -electrons * ELEMENTARY_CHARGE,
        "particles": number,
        "centre": [-3 * sigma, 0, 0],
        "velocity": [velocity, 0, 0],
        "momentum_spread": spread,
    }
    refinement = {
        "levels": 1,
        "rule": {
            "kind": "static",
            "boxes": [{"level": 1, "lower": [0, -4 * sigma, -4 * sigma], "upper": [7 * sigma, 4 * sigma, 4 * sigma]}],
        },
    }
    half = np.array([7, 5, 5])
    cells = half * (8 if levels else 16)  # four coarse cells per sigma
    scene = {
        "domain": {"lower": (-sigma * half).tolist(), "upper": (sigma * half).tolist(), "cells": cells.tolist()},
        "bunches": [bunch],
        "refinement": refinement if levels else {},
        "motion": {"kind": "leapfrog", "dt": period / 2 / steps},
        "particles": {"interface": interface},
        "solver": {"tolerance": 1e-8},
    }
    state, setup = begin(comm, Scene.from_dict(scene))
    for _ in range(steps):
        state = advance(state, setup)
    particles = state.synchronized
    found = moments(comm, particles)
    count = particles.global_count(comm)
    mean = comm.allreduce(particles.momentum.sum(axis=0)) / count
    square = comm.allreduce(np.sum((particles.momentum - mean) ** 2))
    return Flight(found.emittance, mean, float(np.sqrt(square / count)))

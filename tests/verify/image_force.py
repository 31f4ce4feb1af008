"""A bunch beside a plane: its energy, and its momentum against the pressure of the field on the plane."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from mpi4py import MPI

from amrpic.pic.state import State
from amrpic.stages.diagnostics import potential_energy
from amrpic.units import ELECTRON_MASS, ELEMENTARY_CHARGE
from amrpic.verify.table import Cell, Goal, Table
from exact.errors import observed_order
from exact.runs import states
from exact.sources import EPS0

SIGMA = 1e-3  # m
CHARGE = 1e7 * ELEMENTARY_CHARGE  # C, of electrons
TIME = math.sqrt(4 * math.pi * EPS0 * ELECTRON_MASS * SIGMA**3 / (CHARGE * ELEMENTARY_CHARGE))  # s, in which it expands
HALF = 6  # sigma, of the domain along x and y
STEPS = 5.0  # per TIME, for one cell to a sigma


@dataclass(frozen=True)
class Flight:
    """A spherical Gaussian bunch of electrons, cut off at three sigma, above a plane z = 0; lengths in sigma, times in TIME."""

    name: str
    wall: str  # what the plane is
    start: float  # of its centre
    velocity: float  # along z
    duration: float
    height: int  # of the domain
    cells: tuple[int, ...]  # to a sigma

    def scene(self, cells: int, particles: int) -> dict:
        """The scene with so many cells to a sigma."""
        half, dt = HALF * SIGMA, TIME / (STEPS * cells)
        return {
            "domain": {
                "lower": [-half, -half, 0.0],
                "upper": [half, half, self.height * SIGMA],
                "cells": [2 * HALF * cells, 2 * HALF * cells, self.height * cells],
                "boundary": {"x": "open", "y": "open", "z": [self.wall, "open"]},
            },
            "bunches": [
                {
                    "distribution": "gaussian",
                    "species": "electron",
                    "sigma": SIGMA,
                    "cutoff": 3,
                    "centre": [0, 0, self.start * SIGMA],
                    "velocity": [0, 0, self.velocity * SIGMA / TIME],
                    "charge": -CHARGE,
                    "particles": particles,
                    "sampling": "sobol",
                }
            ],
            "refinement": {"levels": 0},
            "solver": {"tolerance": 1e-7},
            "motion": {"kind": "leapfrog", "frame": "lab", "dt": dt},
            "schedule": {"steps": round(self.duration * TIME / dt)},
        }


FALLS = Flight("falls to a grounded plane", "dirichlet", 10, -6, 1, 14, (4, 6, 8))
TURNS = Flight("is turned back by a Neumann plane", "neumann", 4.5, -0.015, 2.5, 10, (6, 8, 12))
FREE = Flight("expands in free space", "open", 4.5, 0, 2.5, 10, (6, 8, 12))


def table(comm: MPI.Comm) -> Table:
    """Energy and momentum of flights. Collective."""
    return Table(
        "A bunch beside a plane",
        "A cold spherical Gaussian bunch of electrons, cut off at 3σ, with open faces on its other sides, in a box of 12σ "
        "across: it falls from 10σ to 4σ above a grounded plane, or is turned back 4.5σ above a Neumann plane while its own "
        "field expands it. Largest change of kinetic plus potential energy over the largest change of the kinetic one, on the "
        "finest mesh, and its order; what momentum it gains against the pressure of the field on the plane, ½ε₀E² over the "
        "mesh and in closed form beyond it, for the field of a point charge at the centre and its image; what part of the "
        "pressure that is at the start. The last row is for comparison.",
        ("bunch", "σ/h", "energy", "order", "momentum", "beyond the box"),
        [row(comm, flight) for flight in (FALLS, TURNS, FREE)],
    )


def row(comm: MPI.Comm, flight: Flight, particles: int = 2**16) -> list[Cell]:
    """What the table has of a flight. Collective."""
    found = [measured(comm, flight, cells, particles) for cells in flight.cells]
    energy, momentum, beyond = found[-1]
    order = observed_order(flight.cells, [of_mesh[0] for of_mesh in found])
    if flight.wall == "open":
        return [flight.name, flight.cells[-1], energy, order, "", ""]
    return [
        flight.name,
        flight.cells[-1],
        Goal(energy, 1e-3),
        Goal(order, 1.8, least=True),
        Goal(abs(momentum), 0.01),
        beyond,
    ]


def measured(comm: MPI.Comm, flight: Flight, cells: int, particles: int) -> tuple[float, float, float]:
    """The largest change of energy over the largest of the kinetic one, the impulse of the pressure over the momentum gained
    less one, and the part of the pressure beyond the box at the start. Collective."""
    scene = flight.scene(cells, particles)
    energies, momenta, forces = [], [], []
    for state in states(comm, scene):
        beam = state.moments()
        energies.append((beam.kinetic_energy, potential_energy(state.rho, state.phi)))
        momenta.append(beam.momentum[2])
        forces.append(_forces(state, flight.wall, beam.mean[2]) if flight.wall != "open" else (math.nan, math.nan))
    kinetic, total = np.array(energies)[:, 0], np.sum(energies, axis=1)
    impulse = np.trapezoid(np.sum(forces, axis=1), dx=scene["motion"]["dt"])
    return (
        float(np.abs(total - total[0]).max() / np.ptp(kinetic)),
        float(impulse / (momenta[-1] - momenta[0]) - 1),
        forces[0][1] / sum(forces[0]),
    )


def _forces(state: State, wall: str, height: float) -> tuple[float, float]:
    """The force of the plane on the charge above it along z, N: of the field on the mesh, and beyond it. Collective.

    A grounded plane is pulled by ½ε₀E_z², a Neumann plane pushed by ½ε₀(E_x² + E_y²).
    """
    domain, (dx, dy, dz) = state.hierarchy.domain, state.hierarchy.spacing(0)
    x, y = (domain.lower[axis] + (np.arange(domain.cells[axis]) + 0.5) * (dx, dy)[axis] for axis in (0, 1))
    first, second = (
        state.phi.sample(np.stack(np.broadcast_arrays(x[:, None], y, place), axis=-1).reshape(-1, 3)).reshape(
            len(x), -1
        )
        for place in (0.5 * dz, 1.5 * dz)
    )
    strength = 0.5 * EPS0 * (2 * CHARGE / (4 * math.pi * EPS0)) ** 2
    if wall == "dirichlet":
        square = ((9 * first - second) / (3 * dz)) ** 2  # of the slope of the parabola through zero on the plane
        return -0.5 * EPS0 * float(square.sum()) * dx * dy, -strength * height**2 * beyond(3, height)
    on_plane = (9 * first - second) / 8  # of the parabola without a slope there
    square = sum(np.square(np.gradient(on_plane, width, axis=axis)) for axis, width in enumerate((dx, dy)))
    return 0.5 * EPS0 * float(square.sum()) * dx * dy, strength * (beyond(2, height) - height**2 * beyond(3, height))


def beyond(power: int, height: float, half: float = HALF * SIGMA) -> float:
    """∬ dx dy / (x² + y² + height²)^power, power 2 or 3, outside the square |x|, |y| < half."""
    s = height**2
    w = math.sqrt(half**2 + s)
    angle, slope = math.atan(half / w), -half / (2 * w * (w**2 + half**2))  # and its derivative by s
    if power == 2:
        return math.pi / s - 4 * half * angle / (s * w)
    inside = 2 * half / (s * w) * (angle * (1 / s + 1 / (2 * w**2)) - slope)  # -½ of the derivative of the other by s
    return math.pi / (2 * s**2) - inside

"""Forces of beams on themselves against direct sums over charges in uniform motion."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any, NamedTuple

import numpy as np
from mpi4py import MPI

from amrpic.parallel import share
from amrpic.particles.species import SPECIES, Species
from amrpic.pic.simulation import Simulation
from amrpic.scene.scene import Scene
from amrpic.units import ELEMENTARY_CHARGE, SPEED_OF_LIGHT, VACUUM_PERMITTIVITY
from amrpic.verify.table import Cell, Goal, Table

COUNT = 1600  # macroparticles of a beam
ROWS = 100  # of a block of pairs
SIZE = 1e-3  # m, rms
GAMMA = 20.0
SMOOTHED = 0.01  # of the force: what clouds and mesh leave out, at 6 cells per rms size
KINDS = {**SPECIES, "xenon": Species("xenon", charge=ELEMENTARY_CHARGE, mass=2.18e-25)}


class Charges(NamedTuple):
    """Macroparticles in the laboratory, at one time."""

    position: np.ndarray  # (n, 3) m
    momenta: np.ndarray  # (n, 3) over m c
    charge: np.ndarray  # (n,) C, of a macroparticle
    species: np.ndarray  # (n,) names

    def __add__(self, other: Charges) -> Charges:  # type: ignore[override]
        return Charges(*(np.concatenate(both) for both in zip(self, other, strict=True)))


def tables(comm: MPI.Comm) -> Iterator[Table]:
    """One table. Collective."""
    rows = [_row(comm, *case) for case in _cases()]
    yield Table(
        "Forces on beams of moving charges",
        f"The self-force of clipped normal distributions of {COUNT} macroparticles a species, over a direct sum of the fields "
        "of charges in uniform motion (Heaviside): Σ F·x along each axis over all particles, less 1. The goal is 1 %, or the "
        f"error that the run estimates, and {SMOOTHED:.0%} for clouds of 1/6 of the rms size. Beams have γ = {GAMMA:g} where "
        "nothing else is said and are spheres in their own frame. Warm ones fly freely there from where momenta and places are "
        "independent. Sums along z that nearly cancel are left out.",
        ("beam", "frames", "estimate", "x", "z"),
        rows,
    )


def _cases() -> Iterator[tuple[str, Charges, bool]]:
    """Names, charges, and whether the sum along z says something."""
    for energy, name in ((1e4, "10 keV"), (5e6, "5 MeV"), (1e9, "1 GeV")):
        gamma = 1 + energy / 0.51099895e6
        for share_of, ion in ((1e-4, "proton"), (0.03, "xenon"), (0.3, "proton")):
            at_rest = still(ion, share_of, gamma)
            yield (
                f"electrons of {name}, {share_of:.2%} {ion}",
                spread("electron", 0.0, gamma) + at_rest,
                share_of < 1e-3,
            )
    for beta in (0.05, 0.4, 0.9, 0.99):
        gamma = 1 / np.sqrt(1 - beta**2)
        there, back = (spread(kind, 0.0, gamma) for kind in ("electron", "positron"))
        yield f"e⁻ and e⁺ of ±{beta} c", there + back._replace(momenta=-back.momenta), False
    for momentum in (0.1, 0.3, 1.0, 3.0):
        yield f"momenta across {momentum} m c", warm(momentum), True
    for width in (0.05, 0.2, 0.5, 1.0):
        yield f"rms of ln γ {width}", spread("electron", width), True


def _row(comm: MPI.Comm, name: str, of: Charges, along: bool) -> list[Cell]:
    ratios, simulation = compared(comm, of)
    frames = simulation.state.solution.frames
    allowed = SMOOTHED + max(0.01, frames.error)
    off = [Goal(abs(ratio - 1), allowed) for ratio in ratios]
    return [name, len(frames.members), frames.error, off[0], off[1] if along else "-"]


def compared(comm: MPI.Comm, of: Charges, cells: int = 32, **motion: Any) -> tuple[list[float], Simulation]:
    """Return Σ F·x and Σ F·z over those of a direct sum, and the run whose force it is. Collective."""
    simulation = Simulation(comm, _scene(of, cells, motion))
    beta = of.momenta / np.sqrt(1 + (of.momenta**2).sum(axis=1))[:, None]
    magnetic = np.cross(beta * SPEED_OF_LIGHT, simulation.bfield.sample(of.position))
    found = of.charge[:, None] * (simulation.efield.sample(of.position) + magnetic)
    exact = forces(comm, of)
    return [
        float((found[:, axis] @ of.position[:, axis]) / (exact[:, axis] @ of.position[:, axis])) for axis in (0, 2)
    ], simulation


def forces(comm: MPI.Comm, of: Charges) -> np.ndarray:
    """Return the force (n, 3) in N on each charge by all others, each in uniform motion. Collective."""
    square = (of.momenta**2).sum(axis=1)
    beta, slow = of.momenta / np.sqrt(1 + square)[:, None], 1 / (1 + square)  # slow: 1 - β²
    out = np.zeros_like(of.position)
    start, stop = share(comm, len(out))
    for first in range(start, stop, ROWS):
        rows = slice(first, min(first + ROWS, stop))
        r = of.position[rows, None] - of.position
        squashed = slow * (r**2).sum(axis=2) + np.einsum("ijd,jd->ij", r, beta) ** 2
        squashed[squashed == 0] = np.inf
        field = r * (of.charge * slow / squashed**1.5)[..., None]
        # E + β_i × (β_j × E), as β_j (β_i·E) - E (β_i·β_j)
        turned = np.einsum("id,ijd->ij", beta[rows], field) @ beta
        out[rows] = field.sum(axis=1) + turned - np.einsum("ijd,ij->id", field, beta[rows] @ beta.T)
    return np.asarray(comm.allreduce(out)) * of.charge[:, None] / (4 * np.pi * VACUUM_PERMITTIVITY)


def _scene(of: Charges, cells: int, motion: dict[str, Any]) -> Scene:
    half = (np.abs(of.position).max(axis=0) * 1.02).tolist()
    bunches = []
    for name in dict.fromkeys(of.species.tolist()):
        kind, own = KINDS[name], of.species == name
        bunches.append(
            {
                "distribution": "arrays",
                "species": {"name": name, "charge": kind.charge, "mass": kind.mass},
                "position": of.position[own],
                "momenta": of.momenta[own] * kind.mass * SPEED_OF_LIGHT,
                "weight": of.charge[own] / kind.charge,
            }
        )
    return Scene.from_dict(
        {
            "domain": {"lower": [-x for x in half], "upper": half, "cells": cells},
            "bunches": bunches,
            "motion": {"kind": "leapfrog", "dt": 1e-18, **motion},
            "output": {"write": []},
        }
    )


def _normal(seed: int, sizes: tuple[float, float, float]) -> np.ndarray:
    return np.clip(np.random.default_rng(seed).normal(size=(COUNT, 3)), -2.5, 2.5) * sizes


def _of(name: str, position: np.ndarray, momenta: np.ndarray, share_of: float = 1.0) -> Charges:
    charge = np.full(COUNT, 1e6 * share_of * KINDS[name].charge)
    return Charges(position, momenta, charge, np.full(COUNT, name))


def spread(name: str, width: float, gamma: float = GAMMA) -> Charges:
    """A beam along z, cold across, with this rms of ln γ."""
    factor = np.exp(width * _normal(2, (1, 1, 1))[:, 0])
    along = np.sqrt(np.maximum((gamma * factor) ** 2 - 1, 1e-6))
    return _of(name, _normal(1, (SIZE, SIZE, SIZE / gamma)), along[:, None] * (0, 0, 1))


def still(name: str, share_of: float, gamma: float) -> Charges:
    """Charge at rest among a beam."""
    return _of(name, _normal(3, (SIZE, SIZE, SIZE / gamma)), np.zeros((COUNT, 3)), share_of)


def warm(momentum: float, gamma: float = GAMMA) -> Charges:
    """Electrons with these rms momenta (m c) along x and y in the frame of the beam, all seen at one time of the laboratory."""
    at_rest, momenta = _normal(4, (SIZE, SIZE, SIZE)), _normal(5, (momentum, momentum, 0))
    energy, speed = np.sqrt(1 + (momenta**2).sum(axis=1)), np.sqrt(1 - gamma**-2)
    time = -speed * at_rest[:, 2]  # times c
    position = at_rest + momenta / energy[:, None] * time[:, None]
    position[:, 2] = gamma * (at_rest[:, 2] + speed * time)
    return _of("electron", position, np.stack([momenta[:, 0], momenta[:, 1], gamma * speed * energy], axis=1))

"""What clouds smooth, and what giving it back is worth: the field at the particles of a bunch, and runs of exact ends."""

from __future__ import annotations

import time
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path

import numpy as np
from mpi4py import MPI
from scipy.integrate import solve_ivp
from scipy.special import erf, ndtri

from amrpic.mesh.domain import Domain
from amrpic.mesh.field import Field
from amrpic.mesh.hierarchy import Hierarchy
from amrpic.parallel import global_sum
from amrpic.particles.clouds import Clouds, CompensationKind, Shape, compensation_pays
from amrpic.particles.particles import Particles
from amrpic.particles.species import Species, SpeciesTable
from amrpic.particles.uniform_numbers import Sampling
from amrpic.particles.uniform_numbers import draw as drawn
from amrpic.stages.deposit import deposit
from amrpic.stages.diagnostics import moments, potential_energy
from amrpic.stages.gather import compensate, gather
from amrpic.stages.migrate import migrate
from amrpic.stages.poisson import PoissonSolver
from amrpic.units import ELECTRON_MASS, ELEMENTARY_CHARGE
from amrpic.verify.table import Cell, Goal, Table, picture
from exact.runs import collected, states
from exact.sources import EPS0, Gaussian

from .curves import Curves
from .lengths import in_full
from .plasma import CELL, CELLS, fitted_wave, wave_of

KINDS: tuple[CompensationKind, ...] = ("none", "clouds", "clouds-and-mesh")
SHAPES: tuple[Shape, ...] = ("triangular-shaped-cloud", "cloud-in-cell")
WIDTHS = (2, 4, 8)  # σ/h
UNIT = SpeciesTable((Species(charge=1.0, mass=1.0),))
HALF = 5  # σ from the middle of the bunch to the walls
PLACES = 20_000  # where the field of so many particles is looked at that their number does not matter
AT_ONCE = 2**20  # particles


def tables(comm: MPI.Comm) -> Iterator[Table]:
    """The tables of this topic. Collective."""
    yield _without_noise(comm)
    yield _with_noise(comm)
    yield _over_seconds(comm)
    yield _explosions(comm)
    yield _oscillations(comm)


# ---- the field at particles ----


class Round:
    """A round Gaussian bunch of charge 1 C in the middle of free space, on uniform cubes; collective."""

    def __init__(self, comm: MPI.Comm, width: float) -> None:
        """`width`: σ/h."""
        self.comm, self.width = comm, width
        cells = 8 * int(np.ceil(2 * HALF * width / 8))
        self.sigma = width / cells  # m; the domain is 1 m wide
        self.hierarchy = Hierarchy(comm, Domain(lower=-0.5, upper=0.5, cells=cells), max_grid_size=32)
        self.solver = PoissonSolver(self.hierarchy, tolerance=1e-9)
        self.source = Gaussian((self.sigma,) * 3, charge=1.0)

    def number(self, per_cell: float) -> int:
        """Particles, of which there are so many in a cell where they are densest."""
        return round(per_cell * (2 * np.pi) ** 1.5 * self.width**3)

    def particles(self, start: int, stop: int, sampling: Sampling, seed: int = 0) -> Particles:
        """Those of the bunch with these numbers, each of weight 1; a rank makes its part of them."""
        first, last = (start + (stop - start) * (self.comm.rank + n) // self.comm.size for n in (0, 1))
        place = self.sigma * ndtri(drawn(sampling, seed, 0, first, last)[:3]).T
        ids = np.arange(first, last, dtype=np.int64)
        made = Particles(place, np.zeros_like(place), np.ones(len(place)), ids, UNIT)
        return migrate(made, self.hierarchy)[0]

    def errors(self, rho: Field, at: Particles, shape: Shape, kinds: Sequence[CompensationKind] = KINDS) -> list[float]:
        """The rms error of the field at particles over its rms, for each kind of compensation."""
        phi, _ = self.solver.solve(rho)
        x, y, z = np.array(at.position).T
        exact = np.stack(self.source.field(x, y, z), axis=1)
        out = []
        for kind in kinds:
            efield = self.solver.deferred_field(phi)
            compensate(efield, rho, Clouds(shape, compensation=kind))
            felt = gather(efield, at, Clouds(shape))
            wrong = global_sum(self.comm, float(((felt - exact) ** 2).sum()))
            out.append(float(np.sqrt(wrong / global_sum(self.comm, float((exact**2).sum())))))
        return out

    def of_particles(self, per_cell: float, shape: Shape, sampling: Sampling, seed: int = 0) -> list[float]:
        """The errors of so many particles per cell where they are densest."""
        number = self.number(per_cell)
        rho, at = Field(self.hierarchy, "C/m^3"), None
        for start in range(0, number, AT_ONCE):
            part = self.particles(start, min(start + AT_ONCE, number), sampling, seed)
            rho = rho + deposit(part, self.hierarchy, Clouds(shape)) * (1 / number)
            at = part if at is None else at
        assert at is not None
        return self.errors(rho, at, shape)

    def of_density(self, shape: Shape) -> list[float]:
        """The errors of a number of particles without end: of the density that clouds make of the normal one."""
        rho = Field(self.hierarchy, "C/m^3")
        h = float(self.hierarchy.spacing(0)[0])
        for patch in rho.patches:
            along = [
                self._in_cells(np.arange(a, b + 1), shape) / h for a, b in zip(patch.lower, patch.upper, strict=True)
            ]
            patch.data[:] = np.einsum("i,j,k->ijk", *along)
        return self.errors(rho, self.particles(0, PLACES, "random"), shape)

    def _in_cells(self, cells: np.ndarray, shape: Shape) -> np.ndarray:
        """The part of all clouds in each layer of cells, by quadrature over half cells, in which weights are polynomials."""
        nodes, weights = np.polynomial.legendre.leggauss(6)
        middle = (
            cells - round(1 / float(self.hierarchy.spacing(0)[0])) / 2 + 0.5
        )  # in cells, from the middle of the bunch
        out = np.zeros(len(cells))
        for piece in np.arange(-1.5, 1.5, 0.5):
            away = piece + 0.25 * (nodes + 1)
            x = middle[:, None] + away
            density = np.exp(-0.5 * (x / self.width) ** 2) / (np.sqrt(2 * np.pi) * self.width)
            out += density @ (0.25 * weights * spline(np.abs(away), shape))
        return out


def spline(away: np.ndarray, shape: Shape) -> np.ndarray:
    """The weight of a cell for particles so many widths away from its centre."""
    if shape == "cloud-in-cell":
        return np.maximum(1 - away, 0)
    return np.where(away < 0.5, 0.75 - away**2, 0.5 * np.maximum(1.5 - away, 0) ** 2)


def _without_noise(comm: MPI.Comm) -> Table:
    rows: list[list[Cell]] = []
    curves: dict[str, tuple[list[float], list[float]]] = {}
    for shape in SHAPES:
        triangular = shape == "triangular-shaped-cloud"
        found = {width: Round(comm, width).of_density(shape) for width in WIDTHS}
        for width, errors in found.items():
            bounds = LEFT[width] if triangular else (None, None)
            rows.append([shape, width, "∞", *_beside(errors, *bounds)])
            if triangular and (width < 4 or (width == 4 and in_full())):
                rows.append(
                    [
                        shape,
                        width,
                        "Sobol, 10⁴",
                        *_beside(Round(comm, width).of_particles(1e4, shape, "sobol"), *bounds),
                    ]
                )
        for n, kind in enumerate(KINDS):
            curves[f"{shape}, {kind}"] = list(WIDTHS), [errors[n] for errors in found.values()]
    return Curves(
        "Field at the particles of a smooth bunch",
        "Round Gaussian bunch in free space, uniform cubes: rms error of E at the particles over its rms, against the exact "
        "field. With particles without end ρ is the normal density spread by clouds, by quadrature; with 10⁴ Sobol particles "
        "per cell at the peak it is deposited. At σ/h = 2 the next term of the series, (h/σ)⁴, is what clouds leave.",
        ("cloud", "σ/h", "per cell", *KINDS, "clouds over none", "with mesh over none"),
        rows,
        curves=curves,
        across="σ/h",
        upwards="error of E at particles",
        by_line=True,
    )


LEFT: Mapping[int, tuple[float | None, float]] = {2: (0.25, 0.25), 4: (0.25, 0.12), 8: (0.25, 0.12)}  # the most, by σ/h


def _beside(errors: Sequence[float], *bounds: float | None) -> list[Cell]:
    """The errors, and those of compensated ones over the first, with their goals."""
    none, *compensated = errors
    left = [error / none for error in compensated]
    beside = [part if bound is None else Goal(part, bound) for part, bound in zip(left, bounds, strict=True)]
    return [*errors, *beside]


NOISY = {2: (3, 10, 30, 100, 300), 4: (3, 10, 30, 100, 300), 8: (3, 10, 30)}  # particles per cell, by σ/h
BOUNDS = {(4, 100): 0.55, (4, 3): 1.25}


def _with_noise(comm: MPI.Comm) -> Table:
    shape: Shape = "triangular-shaped-cloud"
    rows: list[list[Cell]] = []
    curves: dict[str, tuple[list[float], list[float]]] = {}
    for width, every in NOISY.items():
        bunch = Round(comm, width)
        found = []
        for per_cell in every:
            several = [
                bunch.of_particles(per_cell, shape, "random", seed) for seed in range(4 if per_cell < 100 else 1)
            ]
            errors = [float(error) for error in np.mean(several, axis=0)]
            ratio = errors[1] / errors[0]
            bound = BOUNDS.get((width, per_cell))
            auto = compensation_pays(bunch.number(per_cell), np.full(3, float(width)), shape)
            rows.append(
                [width, per_cell, *errors, ratio if bound is None else Goal(ratio, bound), "clouds" if auto else "none"]
            )
            found.append(errors)
        for n, kind in enumerate(KINDS):
            curves[f"σ/h {width}, {kind}"] = list(every), [errors[n] for errors in found]
    return Curves(
        "Field at the particles of a noisy bunch",
        "The same with random particles, triangular clouds, mean over up to four seeds; so many particles per cell where they "
        "are densest. What auto takes is the last column.",
        ("σ/h", "per cell", *KINDS, "clouds over none", "auto"),
        rows,
        curves=curves,
        across="particles per cell",
        upwards="error of E at particles",
        by_line=True,
    )


def _over_seconds(comm: MPI.Comm) -> Table:
    shape: Shape = "triangular-shaped-cloud"
    rows: list[list[Cell]] = []
    found: dict[CompensationKind, tuple[list[float], list[float]]] = {kind: ([], []) for kind in KINDS}
    for width in (2, 3, 4, 6, 8):
        bunch = Round(comm, width)
        at = bunch.particles(0, 200_000, "sobol")
        errors = bunch.of_density(shape)
        row: list[Cell] = [width]
        for kind, error in zip(KINDS, errors, strict=True):
            seconds = min(_seconds(bunch, at, Clouds(shape, compensation=kind)) for _ in range(3))
            found[kind][0].append(seconds)
            found[kind][1].append(error)
            row += [seconds, error]
        rows.append(row)

    def draw(path: Path) -> None:
        with picture(path, "Error of E at particles", "seconds for deposit, solve and gather", "error") as axes:
            for kind, (seconds, errors) in found.items():
                axes.loglog(seconds, errors, "o-", label=kind)

    return Table(
        "Error of the field at particles against time",
        "The bunch on meshes of σ/h 2 to 8, triangular clouds: seconds of a deposit of 2·10⁵ particles, a solve from zero to "
        "1e-4 and a gather, the best of three, and the error without noise.",
        ("σ/h", *(f"{kind}, {what}" for kind in KINDS for what in ("s", "error"))),
        rows,
        upwards="error of E against seconds",
        picture=draw,
    )


def _seconds(bunch: Round, at: Particles, clouds: Clouds) -> float:
    solver = PoissonSolver(bunch.hierarchy, tolerance=1e-4)
    begun = time.perf_counter()
    rho = deposit(at, bunch.hierarchy, clouds)
    efield = solver.deferred_field(solver.solve(rho)[0])
    compensate(efield, rho, clouds)
    gather(efield, at, clouds)
    return time.perf_counter() - begun


# ---- explosion ----

LONG = 4.0  # how long, in √(4πε₀mσ³/qQ); shells overtake each other after 6.9
STEPS = 32
SIGMA = 1e-3  # m
CHARGE = -10e-12  # C


def shells(radius: np.ndarray, until: float) -> np.ndarray:
    """Where particles of a cold Gaussian bunch are then that start at these radii, in σ: r" = Q(r₀) / r², no one overtaken."""
    start = np.geomspace(1e-3, 10, 1500)
    within = erf(start / np.sqrt(2)) - np.sqrt(2 / np.pi) * start * np.exp(-(start**2) / 2)

    def change(_: float, y: np.ndarray) -> np.ndarray:
        return np.concatenate([y[len(start) :], within / y[: len(start)] ** 2])

    end = solve_ivp(change, (0, until), np.concatenate([start, 0 * start]), rtol=1e-10, atol=1e-12).y[: len(start), -1]
    return np.interp(radius, start, end / start) * radius


def _explode(
    comm: MPI.Comm, width: float, per_cell: float, kind: str, shape: Shape, seed: int
) -> tuple[float, float, float]:
    """The errors of rms radius, of places (rms, over rms radius), and of energy over what became kinetic. Collective."""
    cells = 8 * int(np.ceil(2 * 8 * width / 8))
    h = SIGMA / width
    number = round(per_cell * (2 * np.pi) ** 1.5 * width**3)
    place = ndtri(drawn("random", seed, 0, 0, number)[:3]).T
    unit = np.sqrt(4 * np.pi * EPS0 * ELECTRON_MASS * SIGMA**3 / (ELEMENTARY_CHARGE * abs(CHARGE)))
    scene = {
        "domain": {"lower": -cells / 2 * h, "upper": cells / 2 * h, "cells": cells},
        "bunches": [
            {"distribution": "arrays", "species": "electron", "position": place * SIGMA, "charge": CHARGE},
        ],
        "particles": {"shape": shape, "compensation": kind},
        "motion": {"kind": "leapfrog", "dt": LONG / STEPS * unit},
        "schedule": {"steps": STEPS},
        "solver": {"tolerance": 1e-5},
    }
    energies = []
    for state in states(comm, scene):
        now = moments(comm, state.synchronized).kinetic_energy
        energies.append((now, potential_energy(state.rho, state.phi, state.efield.compensation)))
    (_, before), (kinetic, after) = energies[0], energies[-1]
    found = collected(comm, state.synchronized)[0] / SIGMA
    radius = np.linalg.norm(place, axis=1)
    exact = place * (shells(radius, LONG) / radius)[:, None]
    rms = np.sqrt((exact**2).sum() / number)
    return (
        abs(float(np.sqrt((found**2).sum() / number) / rms) - 1),
        float(np.sqrt(((found - exact) ** 2).sum() / number) / rms),
        abs(kinetic + after - before) / kinetic,
    )


RUNS = {2: (3, 10, 30, 100), 4: (3, 10, 30, 100)}  # particles per cell, by σ/h
IN_FULL = {2: (3, 10, 30, 100, 1000), 4: (3, 10, 30, 100, 1000), 8: (3, 10, 30, 100)}


def _explosions(comm: MPI.Comm) -> Table:
    shape: Shape = "triangular-shaped-cloud"
    rows: list[list[Cell]] = []
    for width, every in (IN_FULL if in_full() else RUNS).items():
        for per_cell in every:
            seeds = range(3 if per_cell < 100 else 1)
            found: dict[CompensationKind, np.ndarray] = {
                kind: np.mean([_explode(comm, width, per_cell, kind, shape, seed) for seed in seeds], axis=0)
                for kind in KINDS[:2]
            }
            number = per_cell * (2 * np.pi) ** 1.5 * width**3
            auto: CompensationKind = "clouds" if compensation_pays(number, np.full(3, float(width)), shape) else "none"
            none, clouds = found["none"], found["clouds"]
            best = np.minimum(none, clouds)[1]
            ratio = float(clouds[0] / none[0])
            rows.append(
                [
                    width,
                    per_cell,
                    *(f"{of[0]:.1e}, {of[1]:.1e}, {of[2]:.1e}" for of in (none, clouds)),
                    Goal(ratio, 0.5) if (width, per_cell) == (4, 100) else ratio,
                    auto,
                    Goal(float(found[auto][1] / best), 1.1),
                ]
            )
    return Table(
        "Explosion of a cold Gaussian bunch",
        f"Electrons at rest, random, triangular clouds, until t = {LONG:g} √(4πε₀mσ³/qQ), when the rms radius has grown by "
        "two thirds and no shell has overtaken another, so that each particle has an exact end, r'' = Q(r₀)/r². Errors of "
        "the rms radius, of places (rms, over the rms radius), and of the energy, over what became kinetic. What auto takes, "
        "and its error of places over that of the better choice.",
        ("σ/h", "per cell", "none", "clouds", "rms radius, clouds over none", "auto", "auto over better"),
        rows,
    )


# ---- oscillation ----


def _oscillations(comm: MPI.Comm) -> Table:
    rows: list[list[Cell]] = []
    for shape in SHAPES:
        for waves in (16, 8, 4):
            none, clouds, mesh = (abs(_frequency(comm, shape, waves, kind) - 1) for kind in KINDS)
            ratio = clouds / none
            wanted = Goal(ratio, 0.5) if waves <= 8 else ratio
            with_mesh = Goal(mesh / none, 0.5)
            rows.append([shape, CELLS[0] // waves, none, clouds, mesh, wanted, with_mesh])
    return Table(
        "Cold plasma oscillation, compensated",
        "As above in cold plasma oscillation, with 100 Sobol electrons per cell: the error of the frequency against that of "
        "the continuum, ω_p.",
        ("cloud", "cells per wave", *KINDS, "clouds over none", "with mesh over none"),
        rows,
    )


def _frequency(comm: MPI.Comm, shape: Shape, waves: int, kind: CompensationKind) -> float:
    """The measured one, over ω_p, of leapfrog's without the error of its step. Collective."""
    step = 0.1
    k = 2 * np.pi * waves / CELLS[0] / CELL
    places = drawn("sobol", 0, 0, 0, 100 * int(np.prod(CELLS)))[:3].T * np.array(CELLS) * CELL
    places[:, 0] += 1e-2 / k * np.sin(k * places[:, 0])
    rest = np.zeros_like(places)
    at, wave = wave_of(comm, places, rest, 1e8, step, round(6 * np.pi / step), shape, waves, kind)
    found = fitted_wave(at, wave.real / abs(wave[0]), (np.sign(wave[0].real), 0.0, 0.9, 0.0))[2]
    return float(2 / step * np.sin(found * step / 2))

"""Cases that break solvers: odd meshes, odd charge, odd scales. Each with what must come of it."""

from __future__ import annotations

import resource
from collections.abc import Callable, Iterator, Mapping

import numpy as np
from mpi4py import MPI

from amrpic.mesh.domain import Domain
from amrpic.mesh.field import Field
from amrpic.mesh.hierarchy import Hierarchy
from amrpic.pic.simulation import Simulation
from amrpic.pic.step import advance, begin
from amrpic.scene.scene import Scene
from amrpic.stages.poisson import PoissonSolver, SolveReport
from amrpic.verify.table import Cell, Goal, Table
from exact.errors import errors
from exact.meshes import MESHES, Mesh, around, blocks
from exact.sources import EPS0, Gaussian, Product, Source, Together, Wave, fill

from .lengths import in_brief

Outcome = list[tuple[str, Cell]]
SMOOTH = Product((Wave(4.0, 0.3), Wave(5.0, -0.4), Wave(4.0, 0.2)))
CYCLES = 12  # of a solve to 1e-10 that nothing disturbs


def tables(comm: MPI.Comm) -> Iterator[Table]:
    """The table of this topic. Collective."""
    chosen = [name for name in CASES if name not in LONG or not in_brief()]
    rows = [[name, what, value] for name in chosen for what, value in CASES[name](comm)]
    yield Table(
        "Hard cases",
        "Solves to 1e-10 unless said otherwise; not converged shows as nan cycles.",
        ("case", "quantity", "measured"),
        rows,
    )


# ---- meshes ----


def _checkerboard(comm: MPI.Comm) -> Outcome:
    # no face has a complete 3 x 3 block of coarse cells behind it
    return _as_uniform(comm, blocks(comm, lambda i, j, k: (i + j + k) % 2 == 0), spoilt=1.1)


def _tunnels(comm: MPI.Comm) -> Outcome:
    return _as_uniform(comm, blocks(comm, lambda i, j, k: [i, j, k].count(3) >= 2), spoilt=1.2)


def _as_uniform(comm: MPI.Comm, hierarchy: Hierarchy, spoilt: float) -> Outcome:
    """Refinement in odd places costs no cycles, and spoils the field by a bounded factor."""
    base = Hierarchy(comm, hierarchy.domain)
    (_, report, worst), (_, _, plain) = (_solved(mesh, SMOOTH) for mesh in (hierarchy, base))
    return [("cycles", _cycles(report)), ("φ error over that of the base", Goal(worst / plain, spoilt))]


def _fully_refined(comm: MPI.Comm) -> Outcome:
    full = Mesh(((((0, 0, 0), (8, 8, 8)),),)).hierarchy(comm, 16, "dirichlet")
    fine = Mesh().hierarchy(comm, 32, "dirichlet")
    (_, report, worst), (_, _, plain) = (_solved(mesh, SMOOTH) for mesh in (full, fine))
    return [("cycles", _cycles(report)), ("φ error over that of the fine mesh alone", Goal(worst / plain, 1 + 1e-6))]


def _ten_levels(comm: MPI.Comm) -> Outcome:
    hierarchy = Mesh(around(10)).hierarchy(comm, 16, "dirichlet")
    _, report, worst = _solved(hierarchy, SMOOTH)
    return [("cycles", _cycles(report)), ("φ error", Goal(worst, 5e-3))]


def _smallest_base(comm: MPI.Comm) -> Outcome:
    domain = Domain((0, 0, 0), (1, 1, 1), (8, 8, 8), boundary="open")
    _, report, worst = _solved(Hierarchy(comm, domain), Gaussian((0.15,) * 3, (0.5,) * 3))
    return [("cycles", _cycles(report)), ("φ error", Goal(worst, 5e-2))]


def _needle(comm: MPI.Comm) -> Outcome:
    domain = Domain((0, 0, 0), (1, 1, 64), (8, 8, 512), boundary="open")
    _, report, worst = _solved(Hierarchy(comm, domain), Gaussian((0.12, 0.12, 5.0), (0.5, 0.5, 32.0)))
    return [("cycles", _cycles(report)), ("φ error", Goal(worst, 5e-2))]


# ---- charge ----


def _empty_level(comm: MPI.Comm) -> Outcome:
    hierarchy = MESHES["patch at a corner"].hierarchy(comm, 32, "open")
    _, report, worst = _solved(hierarchy, Gaussian((0.05,) * 3, (0.7, 0.7, 0.6)))
    return [("cycles", Goal(report.cycles if report.converged else np.nan, 9)), ("φ error", Goal(worst, 3e-2))]


def _neutral(comm: MPI.Comm) -> Outcome:
    hierarchy = MESHES["nested cubes"].hierarchy(comm, 32, "open")
    pair = Together(tuple(Gaussian((0.05,) * 3, (x, 0.5, 0.5), q) for x, q in ((0.42, EPS0), (0.58, -EPS0))))
    _, report, worst = _solved(hierarchy, pair)
    return [("cycles", _cycles(report)), ("φ error", Goal(worst, 1e-2))]


def _contrast(comm: MPI.Comm) -> Outcome:
    """A bunch of a trillionth of the other's charge changes the potential by no more than its share and the tolerance."""
    hierarchy = Mesh(((((1, 1, 1), (7, 7, 7)),),)).hierarchy(comm, 24, "open")
    strong, weak = Gaussian((0.06,) * 3, (0.35, 0.5, 0.5)), Gaussian((0.06,) * 3, (0.65, 0.5, 0.5), 1e-12 * EPS0)
    solver = PoissonSolver(hierarchy)
    alone, _ = solver.solve(fill(Field(hierarchy), strong))
    both, again = solver.solve(fill(Field(hierarchy), Together((strong, weak))))
    change = max(
        float(np.abs(a.data - b.data).max(initial=0)) for a, b in zip(alone.patches, both.patches, strict=True)
    )
    change = comm.allreduce(change, op=MPI.MAX) / alone.max_abs()
    return [("cycles", _cycles(again)), ("change of φ over φ", Goal(change, 1e-10))]


def _one_particle(comm: MPI.Comm) -> Outcome:
    run = _particles(comm, particles=1, sigma=0)
    distance = 0.7
    at = np.array([[distance, 0.0, 0.0], [0.0, -distance, 0.0]])
    exact = 1e-9 / (4 * np.pi * EPS0 * distance**2)
    field = np.abs(run.efield.sample(at)).max(axis=1)
    return [
        ("cycles", _cycles(run.report)),
        ("E at 0.7 m over that of a point charge, less one", Goal(float(np.abs(field / exact - 1).max()), 0.02)),
    ]


def _one_cell(comm: MPI.Comm) -> Outcome:
    run = _particles(comm, particles=10_000, sigma=0)
    charge = run.rho.integral()
    return [("cycles", _cycles(run.report)), ("charge over 1 nC, less one", Goal(abs(charge / 1e-9 - 1), 1e-12))]


def _particles(comm: MPI.Comm, particles: int, sigma: float) -> Simulation:
    bunch = {"distribution": "gaussian", "sigma": sigma, "charge": 1e-9, "particles": particles}
    scene = {
        "domain": {"lower": -1, "upper": 1, "cells": 32},
        "bunches": [bunch],
        "refinement": {"levels": 3, "blocking_factor": 4},
    }
    return Simulation(comm, Scene.from_dict(scene))


# ---- scales ----


def _charges(comm: MPI.Comm) -> Outcome:
    return _scaled(comm, charges=(1e-30, 1e3), sizes=(1.0, 1.0))


def _sizes(comm: MPI.Comm) -> Outcome:
    return _scaled(comm, charges=(1.0, 1.0), sizes=(1e-9, 1e6))


def _scaled(comm: MPI.Comm, charges: tuple[float, float], sizes: tuple[float, float]) -> Outcome:
    """φ goes as charge over length, to rounding."""
    found = []
    for charge, size in [(1.0, 1.0), *zip(charges, sizes, strict=True)]:
        scaled = Mesh(MESHES["nested cubes"].levels, (size,) * 3)
        hierarchy = scaled.hierarchy(comm, 16, "open")
        phi, report, _ = _solved(hierarchy, Gaussian((0.07 * size,) * 3, (0.5 * size,) * 3, charge))
        found.append((phi.sample(POINTS * size) * size / charge, report))
    (reference, _), *others = found
    worst = max(float(np.abs(phi / reference - 1).max()) for phi, _ in others)
    return [("cycles", _cycles(others[0][1])), ("cycles", _cycles(others[1][1])), ("change of φ", Goal(worst, 1e-9))]


POINTS = np.random.default_rng(5).uniform(0.1, 0.9, (100, 3))


# ---- stopping ----


def _rounding(comm: MPI.Comm) -> Outcome:
    hierarchy = MESHES["nested cubes"].hierarchy(comm, 32, "open")
    source = Gaussian((0.06,) * 3, (0.5,) * 3)
    solver = PoissonSolver(hierarchy, tolerance=0)
    phi, report = solver.solve(fill(Field(hierarchy), source))
    named = "rounding floor" in report.reason
    return [
        ("cycles", Goal(report.cycles if report.converged else np.nan, 24)),
        ("floor", Goal(report.floor, 1e-11)),
        ("residual over the floor", Goal(report.residuals[-1] / max(report.floor, 1e-300), 10.0)),
        (f"reason: {report.reason}", Goal(float(named), 1, least=True)),
    ]


def _no_charge(comm: MPI.Comm) -> Outcome:
    solver = PoissonSolver(MESHES["nested cubes"].hierarchy(comm, 16, "dirichlet"))
    phi, _ = solver.solve(Field(solver.hierarchy))
    return [("largest φ, V", Goal(phi.max_abs(), 0.0))]


def _only_walls(comm: MPI.Comm) -> Outcome:
    solver = PoissonSolver(MESHES["nested cubes"].hierarchy(comm, 16, "dirichlet"))
    linear = lambda x, y, z: 3 * x - 2 * y + z  # noqa: E731
    phi, report = solver.solve(Field(solver.hierarchy), boundary_values=linear)
    return [("cycles", _cycles(report)), ("error of a linear φ", Goal(errors([phi], linear)[1], 1e-9))]


def _converged_guess(comm: MPI.Comm) -> Outcome:
    solver = PoissonSolver(MESHES["nested cubes"].hierarchy(comm, 24, "open"))
    rho = fill(Field(solver.hierarchy), Gaussian((0.06,) * 3, (0.5,) * 3))
    phi, _ = solver.solve(rho)
    again, report = solver.solve(rho, guess=phi)
    change = float(np.abs(again.sample(POINTS) / phi.sample(POINTS) - 1).max())
    return [("cycles", Goal(report.cycles if report.converged else np.nan, 0)), ("change of φ", Goal(change, 1e-14))]


CHARGE = 1e-26  # C, so little that the bunch keeps its shape


def _many_regrids(comm: MPI.Comm) -> Outcome:
    """A bunch goes around a periodic domain; the mesh is made anew 200 times: charge, memory and cycles stay."""
    bunch = {"distribution": "gaussian", "sigma": 0.1, "charge": CHARGE, "particles": 2000, "velocity": [0.13, 0.07, 0]}
    scene = {
        "domain": {"lower": -1, "upper": 1, "cells": 16, "boundary": "periodic"},
        "background": "neutralizing",
        "bunches": [bunch],
        "refinement": {"levels": 1, "blocking_factor": 4, "max_grid_size": 16, "regrid_every": 1},
        "motion": {"kind": "leapfrog", "dt": 1.0},
    }
    (state, setup), meshes = begin(comm, Scene.from_dict(scene)), 1
    drift, cycles, early = 0.0, 0, 0.0
    while meshes < 200 and state.step < 1000:
        before, state = state.hierarchy, advance(state, setup)
        meshes += state.hierarchy is not before
        drift = max(drift, abs(state.rho.integral() / CHARGE - 1))
        cycles = max(cycles, state.report.cycles)
        early = early if meshes > 50 else _peak()
    growth = comm.allreduce(_peak() - early, op=MPI.SUM)
    return [
        ("meshes", Goal(meshes, 200, least=True)),
        ("charge, relative drift", Goal(drift, 1e-12)),
        ("most cycles", Goal(cycles, CYCLES)),
        ("memory from mesh 50 to 200, MiB", Goal(growth, 20.0 * comm.size)),
    ]


def _peak() -> float:
    """Largest memory that this process has held, MiB."""
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 2**10


# ---- one solve ----


def _solved(hierarchy: Hierarchy, source: Source) -> tuple[Field, SolveReport, float]:
    """φ of a source, how the solve went, and the largest relative error."""
    solver = PoissonSolver(hierarchy)
    phi, report = solver.solve(fill(Field(hierarchy), source), boundary_values=source.potential)
    return phi, report, errors([phi], source.potential)[1]


def _cycles(report: SolveReport) -> Goal:
    return Goal(report.cycles if report.converged else np.nan, CYCLES)


CASES: Mapping[str, Callable[[MPI.Comm], Outcome]] = {
    "checkerboard of blocks of 4": _checkerboard,
    "tunnels one block wide": _tunnels,
    "fully refined level": _fully_refined,
    "ten levels": _ten_levels,
    "base of 8³": _smallest_base,
    "base of 8×8×512": _needle,
    "level without charge": _empty_level,
    "total charge zero": _neutral,
    "density contrast 10¹²": _contrast,
    "one particle": _one_particle,
    "all particles in one place": _one_cell,
    "charges of 1e-30 C and 1e3 C": _charges,
    "domains of 1e-9 m and 1e6 m": _sizes,
    "tolerance 0": _rounding,
    "no charge, no potential": _no_charge,
    "no charge, walls with potentials": _only_walls,
    "guess that is converged": _converged_guess,
    "200 regrids in a row": _many_regrids,
}
LONG = ("base of 8×8×512", "density contrast 10¹²", "total charge zero", "200 regrids in a row")  # seconds each

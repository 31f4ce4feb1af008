"""Stopping at the error of the mesh: the estimate against the true error, and what the answer loses."""

from __future__ import annotations

import itertools
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Literal

import numpy as np
from mpi4py import MPI

from amrpic.mesh.field import Field
from amrpic.stages.poisson import PoissonSolver, SolveReport
from amrpic.verify.table import Cell, Goal, Table
from exact import amrex
from exact.errors import errors
from exact.meshes import MESHES
from exact.sources import Gaussian, Source, fill

from .convergence import smooth

LOST = 1.05  # of the error, at most
OFF = 2.0  # factor by which the estimate may miss the largest true error of φ, at most


def tables(comm: MPI.Comm) -> Iterator[Table]:
    """The table of this topic. Collective."""
    yield Table(
        'tolerance = "discretization"',
        "Estimated over true largest error of φ; errors of φ and E (max) over those of a solve to 1e-10; cycles of both, of "
        "which the estimate takes one more. What the cells of φ stand for is what those of ρ stand for: their centres where ρ "
        "is given there, means where ρ is one, and so the true error is counted. A mean differs from the value at the centre "
        "by h²/24 Δφ, which for a round bunch all but cancels the error of the means: at centres it is up to eight times less, "
        "by luck of the shape. The estimate sees nothing of walls, whose potentials are those of face centres.",
        ("case", "ρ is", "estimate over true", "off by", "over true at centres", "φ", "E", "cycles", "to 1e-10"),
        [[name, *_row(case)] for name, case in _cases(comm)],
    )


@dataclass(frozen=True)
class Case:
    """A density, where it comes from, and whether its cells hold means or values at their centres."""

    rho: Field
    source: Source
    means: bool = True


def _cases(comm: MPI.Comm) -> Iterator[tuple[str, Case]]:
    static, bunch = amrex.static(comm, 64), amrex.bunch(comm, 64)
    for name, hierarchy, source in (
        ("static 64", static, amrex.static_source()),
        ("bunch 64", bunch, amrex.bunch_source()),
    ):
        yield name, Case(Field(hierarchy).fill(source.density), source, means=False)
        yield name, Case(fill(Field(hierarchy), source), source)
    for name in ("uniform", "nested cubes", "patch at a corner", "six levels off centre", "cells 1:1:10"):
        smooth_one = smooth(MESHES[name].size)
        rho = fill(Field(MESHES[name].hierarchy(comm, 32, "dirichlet")), smooth_one)
        yield f"smooth, {name}", Case(rho, smooth_one)
    gaussian = Gaussian((0.06,) * 3, (0.5,) * 3)
    rho = fill(Field(MESHES["nested cubes"].hierarchy(comm, 32, "open")), gaussian)
    yield "Gaussian, open faces", Case(rho, gaussian)


def _row(case: Case) -> list[Cell]:
    converged, full = _solved(case, 1e-10)
    stopped, short = _solved(case, "discretization")
    estimate = short.discretization_error / (converged.true * converged.largest)
    lost = [Goal(stopped.phi / converged.phi, LOST), Goal(stopped.field / converged.field, LOST)]
    cycles = Goal(short.cycles if short.converged else np.nan, full.cycles - 1)
    return [
        "mean" if case.means else "at centre",
        estimate,
        Goal(max(estimate, 1 / estimate), OFF),
        short.discretization_error / (converged.phi * converged.largest),
        *lost,
        cycles,
        full.cycles,
    ]


@dataclass(frozen=True)
class Found:
    """Largest errors, relative to the largest value."""

    phi: float  # at cell centres
    true: float  # of φ, as what its cells stand for
    field: float
    largest: float  # φ, V


def _solved(case: Case, tolerance: float | Literal["discretization"]) -> tuple[Found, SolveReport]:
    solver = PoissonSolver(case.rho.hierarchy, tolerance=tolerance)
    exact = case.source.potential
    phi, report = solver.solve(case.rho, boundary_values=exact)
    of_phi = errors([phi], exact)[1]
    of_field = errors(solver.electric_field(phi).components, case.source.field)[1]
    return Found(of_phi, _error_of_means(phi, exact) if case.means else of_phi, of_field, phi.max_abs()), report


def _error_of_means(phi: Field, exact: Callable[..., np.ndarray]) -> float:
    """The largest error of φ as the mean over each cell, over the largest φ; means by two Gauss points per axis. Collective."""
    wrong = Field(phi.hierarchy)
    for found, patch in zip(phi.patches, wrong.patches, strict=True):
        half = phi.hierarchy.spacing(patch.level) / (2 * np.sqrt(3))
        points = itertools.product(*((c - h, c + h) for c, h in zip(patch.centres(), half, strict=True)))
        patch.data[...] = found.data - sum(exact(*point) for point in points) / 8
    return wrong.max_abs() / phi.max_abs()

"""Solves that stop at the error of the mesh."""

from __future__ import annotations

import numpy as np
import pytest
from mpi4py import MPI

import amrpic
from amrpic.errors import SceneError, SolverError
from amrpic.scene.scene import Scene
from amrpic.stages.poisson import PoissonSolver
from static_case import STATIC, errors, solve_static, static_hierarchy


@pytest.mark.mpi(ranks=(1, 2, 3))
def test_estimate_is_the_true_error_and_little_is_lost(comm):
    """Measured: estimate 1.1 times the largest error of φ, 3 cycles for 7, E within 0.4 %."""
    solver, phi, full = solve_static(comm, 48)
    stopped_solver, stopped, short = solve_static(comm, 48, tolerance="discretization")
    assert short.converged and "of the mesh" in short.reason
    assert short.cycles <= full.cycles - 3
    true = max(worst for _, worst in errors([phi], STATIC.potential)) * phi.max_abs()
    assert 0.8 * true < short.discretization_error < 2 * true
    exact = [
        errors(s.electric_field(p).components, STATIC.field) for s, p in ((solver, phi), (stopped_solver, stopped))
    ]
    for (l2, largest), (l2_stopped, largest_stopped) in zip(*exact, strict=True):
        assert l2_stopped < 1.02 * l2 and largest_stopped < 1.02 * largest
    _, _, alone = solve_static(MPI.COMM_SELF, 48, tolerance="discretization")
    assert alone.cycles == short.cycles
    assert short.discretization_error == pytest.approx(alone.discretization_error, rel=1e-4)


def test_a_good_guess_costs_one_cycle(comm):
    hierarchy = static_hierarchy(comm, 32)
    rho = amrpic.Field(hierarchy).fill(STATIC.density)
    solver = PoissonSolver(hierarchy, tolerance="discretization")
    phi, _ = PoissonSolver(hierarchy).solve(rho, boundary_values=STATIC.potential)
    _, report = solver.solve(rho, guess=phi, boundary_values=STATIC.potential)
    assert report.converged and report.cycles == 1


def test_a_mesh_without_error_ends_at_the_smallest_tolerance(comm):
    hierarchy = amrpic.Hierarchy(comm, amrpic.Domain((0, 0, 0), (1, 1, 1), (16, 16, 16), boundary="dirichlet"))
    phi, report = PoissonSolver(hierarchy, tolerance="discretization").solve(
        amrpic.Field(hierarchy), boundary_values=lambda x, y, z: x - 2 * y + z
    )
    assert report.converged
    assert max(worst for _, worst in errors([phi], lambda x, y, z: x - 2 * y + z)) < 1e-9


def test_what_cannot_be_estimated_is_refused(comm):
    with pytest.raises(SolverError, match="how much error is left"):
        PoissonSolver(static_hierarchy(comm, 32), tolerance="discretization", krylov="fgmres")
    domain = {"lower": -1, "upper": 1, "cells": 16}
    assert Scene.from_dict({"domain": domain, "solver": {"tolerance": "discretization"}}).solver.tolerance
    with pytest.raises(SceneError, match="how much error is left"):
        Scene.from_dict({"domain": domain, "solver": {"tolerance": "discretization", "krylov": "bicgstab"}})
    for bad in (2, 0, "fine", True):
        with pytest.raises(SceneError, match=r"solver.tolerance .*is no tolerance; give a number"):
            Scene.from_dict({"domain": domain, "solver": {"tolerance": bad}})


def test_slow_cycles_do_not_stop_early(comm):
    hierarchy = static_hierarchy(comm, 32)
    rho = amrpic.Field(hierarchy).fill(STATIC.density)
    phi, _ = PoissonSolver(hierarchy).solve(rho, boundary_values=STATIC.potential)
    slow = PoissonSolver(hierarchy, tolerance="discretization", sweeps=(1, 0), relaxation=0.3, max_cycles=300)
    stopped, report = slow.solve(rho, boundary_values=STATIC.potential)
    assert report.converged
    left = max(float(np.abs(a.data - b.data).max()) for a, b in zip(phi.patches, stopped.patches, strict=True))
    assert left < 0.12 * report.discretization_error


@pytest.mark.mpi(ranks=(1, 2))
def test_solves_go_by_an_earlier_estimate_and_leave_as_little(comm):
    """Measured: one cycle in place of two and that of the estimate, which leave 0.05 of the error of the mesh."""
    hierarchy = static_hierarchy(comm, 32)
    rho, solver = amrpic.Field(hierarchy).fill(STATIC.density), PoissonSolver(hierarchy, tolerance="discretization")
    exact = PoissonSolver(hierarchy, tolerance=1e-11)
    phi, report = solver.solve(rho, boundary_values=STATIC.potential)
    ages, cycles = [], []
    for step in range(1, 12):
        changed = amrpic.Field(hierarchy)
        for to, of in zip(changed.patches, rho.patches, strict=True):
            to.data[...] = (1 + 1e-3 * step) * of.data
        phi, report = solver.solve(changed, guess=phi, boundary_values=STATIC.potential, last=report)
        whole, _ = exact.solve(changed, guess=phi, boundary_values=STATIC.potential)
        left = max(float(np.abs(a.data - b.data).max()) for a, b in zip(phi.patches, whole.patches, strict=True))
        assert report.converged and comm.allreduce(left, MPI.MAX) < 0.1 * report.discretization_error
        ages.append(report.solves_since)
        cycles.append(report.cycles)
    assert ages == [*range(1, 10), 0, 1]
    assert max(cycles[:9]) == 1 and cycles[9] == 2


def test_an_estimate_for_another_charge_is_made_anew(comm):
    hierarchy = static_hierarchy(comm, 32)
    solver = PoissonSolver(hierarchy, tolerance="discretization")
    rho = amrpic.Field(hierarchy).fill(STATIC.density)
    phi, report = solver.solve(rho)
    twice = amrpic.Field(hierarchy).fill(lambda x, y, z: 2 * STATIC.density(x, y, z))
    _, anew = solver.solve(twice, guess=phi, last=report)
    assert anew.solves_since == 0 and anew.discretization_error == pytest.approx(
        2 * report.discretization_error, rel=0.1
    )

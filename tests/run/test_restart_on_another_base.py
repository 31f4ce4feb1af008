"""A checkpoint goes on with other base cells, or boxes of other sizes."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from mpi4py import MPI

import amrpic
from amrpic.errors import InputError
from amrpic.parallel import global_sum


def scene(cells: int = 16, block: int = 4, **more) -> amrpic.Scene:
    bunch = amrpic.GaussianBunch(species="electron", sigma=0.012, charge="-10 pC", particles=4000)
    arguments = {"motion": amrpic.Leapfrog(dt="50 ps"), "schedule": {"steps": 4}} | more
    return amrpic.Scene(
        domain=amrpic.Domain(-0.1, 0.1, cells, boundary="dirichlet"),
        bunches=[bunch],
        refinement={
            "levels": 1,
            "blocking_factor": block,
            "rule": {"kind": "charge-density", "relative": 0.05},
            "regrid_every": 2,
        },
        solver={"tolerance": 1e-11},
        output={"write": []},
        **arguments,
    )


def checkpoint(comm: MPI.Comm, folder: Path, **more) -> tuple[amrpic.Simulation, Path]:
    run = amrpic.Simulation(comm, scene(**more))
    run.advance(2)
    run.checkpoint(folder / "checkpoint_00000002")
    return run, folder / "checkpoint_00000002"


def moments(run: amrpic.Simulation) -> np.ndarray:
    particles = run.particles
    values = [*(particles.position.T**2).sum(axis=1), *(particles.momentum.T**2).sum(axis=1), len(particles)]
    return np.array([global_sum(run.comm, float(value)) for value in values])


@pytest.mark.mpi(ranks=(1, 2), timeout=120)
@pytest.mark.parametrize("changed", [{"cells": 24}, {"cells": 12}, {"block": 8}])
def test_the_field_is_solved_anew_for_the_same_particles(comm, tmp_path, changed):
    before, path = checkpoint(comm, tmp_path)
    run = amrpic.Simulation.restart(comm, path, scene(**changed))
    cells = changed.get("cells", 16)
    assert run.step == 2 and run.hierarchy.domain.cells == (cells,) * 3 and run.hierarchy.levels == 2
    assert moments(run) == pytest.approx(moments(before), rel=1e-12)
    assert run.rho.integral() == pytest.approx(before.rho.integral(), rel=1e-12)
    assert (
        "the mesh is made anew, and the field solved on it: the base or the sizes of boxes are other ones"
        in run.remarks
    )
    # what is solved does not depend on the potential that was carried over
    phi, report = amrpic.PoissonSolver(run.hierarchy, tolerance=1e-11).solve(run.rho)
    assert (run.phi - phi).max_abs() < 1e-9 * phi.max_abs() and run.report.converged
    # the potential carried over belongs to the charge as the other mesh held it: what differs is the first residual
    other_charge = (run.rho - before.rho.remap(run.hierarchy)).max_abs() / run.rho.max_abs()
    assert run.report.residuals[0] < (1.1 * other_charge + 0.02) * report.residuals[0], (
        "the guess is no better than zero"
    )
    carried = before.phi.remap(run.hierarchy)
    assert (carried - run.phi).norm() < 0.1 * run.phi.norm()
    run.advance(2)
    alone = amrpic.Simulation(comm, scene(**changed))
    alone.advance(4)
    assert moments(run) == pytest.approx(moments(alone), rel=2e-3)


def test_a_random_walk_goes_on_too(comm, tmp_path):
    moving: dict[str, Any] = {"motion": amrpic.RandomWalk(amplitude=1e-3)}
    _, path = checkpoint(comm, tmp_path, **moving)
    run = amrpic.Simulation.restart(comm, path, scene(cells=20, **moving))
    run.advance(1)
    assert run.step == 3 and run.hierarchy.domain.cells == (20, 20, 20)


@pytest.mark.mpi(ranks=(2,))
def test_another_cuboid_or_boundary_is_refused(comm, tmp_path):
    _, path = checkpoint(comm, tmp_path)
    other = scene()
    for domain, message in (
        (
            amrpic.Domain((-0.1, -0.1, -0.1), (0.1, 0.1, 0.2), 16, boundary="dirichlet"),
            r"domain.upper is \[0.1, 0.1, 0.2\]",
        ),
        (
            amrpic.Domain(-0.1, 0.1, 16, boundary="open"),
            r"domain.boundary.x is \['open', 'open'\] instead of \['dirichlet'",
        ),
    ):
        with pytest.raises(
            InputError, match=rf"cannot go on from checkpoint .*: {message}.*; restore that, or start afresh"
        ):
            amrpic.Simulation.restart(comm, path, other.replace(domain=domain))


@pytest.mark.mpi(ranks=(2, 3), timeout=120)
def test_a_mesh_that_stays_stays_on_other_ranks(comm, tmp_path):
    """Boxes are halved for as many ranks as there are; the cells are the same, and `regridded` says so."""
    still: dict[str, Any] = {"motion": amrpic.NoMotion(), "schedule": {"steps": 4}}
    run, path = checkpoint(comm, tmp_path, **still)
    run.advance(2)
    assert not run.state.regridded
    for other in MPI.COMM_SELF, comm:
        again = amrpic.Simulation.restart(other, path)
        again.advance(2)
        assert not again.state.regridded and again.hierarchy.cells() == run.hierarchy.cells()
    alone = amrpic.Simulation(MPI.COMM_SELF, scene(**still))
    alone.advance(4)
    assert alone.hierarchy.same_cells(run.hierarchy) and run.hierarchy.same_cells(alone.hierarchy)
    finer = amrpic.Hierarchy(MPI.COMM_SELF, alone.hierarchy.domain, [[((0, 0, 0), (7, 7, 7))]], 8, 4)
    moved = amrpic.Hierarchy(MPI.COMM_SELF, alone.hierarchy.domain, [[((4, 0, 0), (11, 7, 7))]], 8, 4)
    assert not finer.same_cells(moved) and finer.same_cells(finer)

"""Every choice of the solver's menu finds the same potential, or is refused with the reason."""

from __future__ import annotations

import itertools
from typing import Any, get_args

import numpy as np
import pytest
from mpi4py import MPI

import amrpic
import backends
from amrpic import _native
from amrpic.errors import SceneError, SolverError
from amrpic.mesh.domain import BoundarySpec
from amrpic.scene import solver_options
from amrpic.scene.scene import Scene
from amrpic.scene.solver_options import SolverOptions
from amrpic.stages.poisson import PoissonSolver, native_options
from static_case import STATIC, solve_static, static_hierarchy

POINTS = np.random.default_rng(2).uniform(0.01, 0.99, (500, 3))
MIXED = {"x": ("neumann", "dirichlet"), "y": "periodic", "z": ("dirichlet", "neumann")}
AGGREGATION = [name for name in get_args(solver_options.BottomPreconditioner) if name.endswith("aggregation")]


def refined(comm: MPI.Comm, boundary: BoundarySpec, cells: int = 16, first: int | None = 8) -> amrpic.Hierarchy:
    """The unit cube with one refined level, if any, which touches a wall where `first` is 0."""
    domain = amrpic.Domain((0, 0, 0), (1, 1, 1), (cells,) * 3, boundary)
    levels = [] if first is None else [[((first,) * 3, (first + 15,) * 3)]]
    return amrpic.Hierarchy(comm, domain, levels, max_grid_size=8, blocking_factor=4)


def charge(hierarchy: amrpic.Hierarchy) -> amrpic.Field:
    """A density without symmetry and without a mean."""
    rho = amrpic.Field(hierarchy).fill(lambda x, y, z: 1e-9 * np.sin(3 * x + 1) * np.exp(-9 * ((y - 0.4) ** 2 + z**2)))
    mean = rho.integral()
    for level in range(hierarchy.levels):
        rho.array(level)[:] -= mean
    return rho


def solved(hierarchy: amrpic.Hierarchy, backend="crs", **options) -> tuple[amrpic.Field, amrpic.SolveReport]:
    solver = PoissonSolver(hierarchy, tolerance=1e-11, background=None, backend=backend, **options)
    phi, report = solver.solve(charge(hierarchy))
    assert report.converged, (options, report.reason)
    return phi, report


def difference(phi: amrpic.Field, other: amrpic.Field) -> float:
    """Largest difference over the largest value. Collective."""
    levels = range(phi.hierarchy.levels)
    apart = max((np.abs(phi.array(l) - other.array(l)).max(initial=0.0) for l in levels), default=0.0)
    return phi.comm.allreduce(float(apart), op=MPI.MAX) / other.max_abs()


@pytest.mark.mpi(ranks=(1, 2))
@pytest.mark.parametrize("boundary", ["dirichlet", "periodic", "open", MIXED], ids=str)
def test_every_smoother_and_acceleration_finds_the_same_potential(boundary, comm):
    hierarchy = refined(comm, boundary)
    wanted, plain = solved(hierarchy)
    for smoother in get_args(solver_options.Smoother)[1:]:
        phi, report = solved(hierarchy, smoother=smoother)
        assert difference(phi, wanted) < 1e-9, smoother
        assert report.cycles <= 25, smoother
    for krylov, more in (("fgmres", 0), ("bicgstab", 2)):  # an iteration of the latter takes two cycles
        phi, report = solved(hierarchy, krylov=krylov)
        assert difference(phi, wanted) < 1e-9, krylov
        assert report.cycles <= plain.cycles + more, krylov


@pytest.mark.mpi(ranks=(1, 2))
def test_every_bottom_with_every_preconditioner_finds_the_same_potential(comm):
    hierarchy = refined(
        comm, "dirichlet", cells=24
    )  # 12^3 cells on the coarsest level: more than MueLu solves directly
    wanted, _ = solved(hierarchy)
    krylov = itertools.product(("gmres", "cg", "bicgstab"), get_args(solver_options.BottomPreconditioner))
    for bottom, preconditioner in [*krylov, *(("multigrid", name) for name in AGGREGATION), ("direct", None)]:
        phi, report = solved(hierarchy, coarse_levels=1, bottom=bottom, bottom_preconditioner=preconditioner)
        assert difference(phi, wanted) < 1e-9, (bottom, preconditioner)
        assert report.cycles <= 9, (bottom, preconditioner)


@pytest.mark.mpi(ranks=(1, 2))
@pytest.mark.parametrize("bottom", ["gmres", "cg", "bicgstab", "multigrid", "direct"])
def test_every_bottom_solves_a_singular_base(bottom, comm):
    hierarchy = refined(comm, "periodic")
    phi, _ = solved(hierarchy, coarse_levels=0, bottom=bottom)
    assert difference(phi, solved(hierarchy)[0]) < 1e-9


def test_cg_is_accepted_where_the_base_is_symmetric_and_refused_where_its_ghosts_are_quadratic():
    solved(refined(MPI.COMM_SELF, "open"), coarse_levels=0, bottom="cg")
    with pytest.raises(SolverError, match='bottom is "cg", but the coarsest level\'s matrix is not symmetric'):
        PoissonSolver(refined(MPI.COMM_SELF, "dirichlet"), coarse_levels=0, bottom="cg", backend="crs")


@pytest.mark.parametrize("bottom", ["gmres", "direct"])
def test_a_bottom_beyond_its_method_is_refused(bottom):
    cells = 24 if bottom == "direct" else 162
    domain = amrpic.Domain((0, 0, 0), (1, 1, 1), (cells,) * 3, "dirichlet")
    hierarchy = amrpic.Hierarchy(MPI.COMM_SELF, domain, max_grid_size=cells, blocking_factor=2)
    with pytest.raises(SolverError, match=rf"the coarsest level (would have|has) {cells**3} cells"):
        PoissonSolver(hierarchy, coarse_levels=0, bottom=bottom, backend="crs")


@pytest.mark.mpi(ranks=(1, 2))
@pytest.mark.parametrize("krylov", ["fgmres", "bicgstab"])
def test_accelerated_residuals_are_those_of_the_potential(krylov, comm):
    """A solve that starts from the result finds the residual that was reported last."""
    hierarchy = static_hierarchy(comm, 16, 8)
    rho = amrpic.Field(hierarchy).fill(STATIC.density)
    solver = PoissonSolver(hierarchy, tolerance=1e-6, krylov=krylov, backend="crs")
    phi, report = solver.solve(rho, boundary_values=STATIC.potential)
    again = PoissonSolver(hierarchy, max_cycles=1, backend="crs")
    _, checked = again.solve(rho, guess=phi, boundary_values=STATIC.potential)
    assert checked.residuals[0] == pytest.approx(report.residuals[-1], rel=1e-6)
    assert len(report.residuals) == report.cycles + 1


@pytest.mark.parametrize("krylov", ["none", "fgmres", "bicgstab"])
def test_rounding_floor_is_recognised_with_every_acceleration(krylov):
    _, _, report = solve_static(MPI.COMM_SELF, 16, tolerance=0.0, krylov=krylov, backend="crs")
    assert report.converged and "rounding" in report.reason
    assert report.residuals[-1] <= 10 * report.floor


def test_absolute_tolerance_is_in_volts_per_square_metre():
    hierarchy = static_hierarchy(MPI.COMM_SELF, 16, 8)
    rho = amrpic.Field(hierarchy).fill(STATIC.density)
    largest = max(np.abs(rho.array(level)).max() for level in range(3)) / 8.8541878188e-12  # V/m²
    _, report = PoissonSolver(hierarchy, absolute_tolerance=1e-3 * largest).solve(rho)
    assert report.converged and report.reason == "absolute tolerance reached"
    assert report.residuals[-1] <= 1e-3 < report.residuals[-2]


def test_sweeps_are_one_number_or_two():
    one, two, none_before = (solve_static(MPI.COMM_SELF, 16, sweeps=sweeps)[2] for sweeps in (2, (2, 2), (0, 4)))
    assert one.residuals == two.residuals
    assert none_before.converged and none_before.residuals != one.residuals
    assert [SolverOptions(order=order).both_sweeps for order in (2, 4)] == [(2, 2), (2, 1)]


@pytest.mark.mpi(ranks=(1, 2))
def test_the_base_set_up_lasts_while_refined_levels_change(comm):
    """The bottom is set up anew only where its matrix changes, as it does for levels that come to touch an open wall."""
    places = {8: 0, 4: 0, 0: 1}  # where the refined level begins, and the set-ups that it needs
    kept = PoissonSolver(refined(comm, "open", first=12), backend="crs").base_setup
    for first, setups in places.items():
        hierarchy = refined(comm, "open", first=first)
        solver = PoissonSolver(hierarchy, tolerance=1e-11, reuse=kept, backend="crs")
        kept = solver.base_setup
        assert solver.native.bottom_setups == setups, first
        phi, report = solver.solve(charge(hierarchy))
        assert difference(phi, solved(hierarchy)[0]) < 1e-9
    with pytest.raises(
        SolverError,
        match="reuse comes from a solver of another domain, order, stretch, screening, bottom or axis of a mirror",
    ):
        PoissonSolver(refined(comm, "periodic"), reuse=kept)


@pytest.mark.parametrize(
    ("options", "complaint"),
    [
        ({"smoother": "sor"}, "smoother is 'sor', which is not one of the choices; use one of red-black, jacobi"),
        ({"smoother": "chebyshev", "relaxation": 0.8}, "relaxation is 0.8, which has no meaning for chebyshev"),
        ({"smoother": "jacobi", "relaxation": 1.2}, "relaxation is 1.2, which makes jacobi diverge"),
        ({"sweeps": (0, 0)}, r"sweeps is \[0, 0\], which leaves nothing to smooth with"),
        ({"sweeps": (1, 2, 3)}, r"sweeps is \(1, 2, 3\), which is neither one number nor two; give one number, or two"),
        ({"bottom": "magic"}, "bottom is 'magic'"),
        ({"bottom": "direct", "bottom_preconditioner": "ilu"}, "'ilu', which has nothing to do in a direct solve"),
        ({"bottom": "multigrid", "bottom_preconditioner": "jacobi"}, "'jacobi', which is no multigrid"),
        ({"bottom_preconditioner": "magic"}, "bottom_preconditioner is 'magic'"),
        ({"krylov": "cg"}, "krylov is 'cg'"),
        ({"coarse_levels": -1}, "coarse_levels is -1"),
        ({"smother": "jacobi"}, "smother is 'jacobi', which is an unknown key; did you mean \"smoother\""),
        ({"options": SolverOptions(), "sweeps": 1}, "options are given as well as sweeps; keep one of the two"),
        ({"absolute_tolerance": -1}, "absolute_tolerance is -1, which is not greater than or equal to 0"),
    ],
)
def test_choices_that_mean_nothing_are_refused(options, complaint):
    with pytest.raises(SolverError, match=complaint):
        PoissonSolver(refined(MPI.COMM_SELF, "dirichlet"), **options)


@pytest.mark.parametrize(
    ("solver", "complaint"),
    [
        ({"smoother": "chebyshev", "relaxation": 0.8}, r"solver.relaxation \(0.8\) has no meaning for chebyshev"),
        (
            {"bottom": "direct", "bottom_preconditioner": "ilu"},
            r"solver.bottom_preconditioner \('ilu'\) has nothing to do",
        ),
        ({"sweeps": [0, 0]}, r"solver.sweeps \(\[0, 0\]\) leaves nothing to smooth with"),
        ({"smoother": "chebishev"}, 'did you mean "chebyshev"'),
    ],
)
def test_scenes_refuse_them_in_the_same_words(solver, complaint):
    domain = {"lower": 0, "upper": 1, "cells": 16}
    with pytest.raises(SceneError, match=complaint):
        amrpic.Scene.from_dict({"domain": domain, "solver": solver})


@pytest.mark.skipif(backends.DEFAULT != "matrix-free", reason="the default backend is one that was chosen for tests")
def test_defaults_are_the_same_in_scenes_in_python_and_in_the_native_struct():
    scene = Scene.from_dict({"domain": {"lower": 0, "upper": 1, "cells": 16}})
    assert dict(scene.solver) == {**dict(SolverOptions()), "reuse": True}
    ours, its_own = native_options(SolverOptions()), _native.SolverOptions()
    for name in (name for name in dir(its_own) if not name.startswith("_")):
        np.testing.assert_equal(getattr(ours, name), getattr(its_own, name), name)


def test_options_may_be_numbers_of_numpy():
    given: dict[str, Any] = {
        "sweeps": np.array([1, 3]),
        "max_cycles": np.int64(7),
        "relaxation": np.float32(1.5),
        "stretch": np.ones(3),
    }
    solver = PoissonSolver(refined(MPI.COMM_SELF, "dirichlet"), **given)
    assert solver.options == SolverOptions(sweeps=(1, 3), max_cycles=7, relaxation=1.5)


def test_a_scene_hands_every_choice_to_the_solver():
    from amrpic.pic.setup import set_up

    chosen: dict[str, Any] = {
        "backend": "crs",
        "smoother": "chebyshev",
        "sweeps": [1, 3],
        "prolongation": "constant",
        "coarse_levels": 1,
        "bottom": "bicgstab",
        "bottom_preconditioner": "ilu",
        "krylov": "fgmres",
        "norm": "l2",
        "tolerance": 1e-7,
        "absolute_tolerance": 1e-9,
    }
    hierarchy = refined(MPI.COMM_SELF, "dirichlet")
    scene = amrpic.Scene.from_dict(
        {"domain": {"lower": 0, "upper": 1, "cells": 16, "boundary": "dirichlet"}, "solver": chosen}
    )
    _, by_scene = set_up(MPI.COMM_SELF, scene).solvers.solve(charge(hierarchy), None)
    _, by_hand = PoissonSolver(hierarchy, max_cycles=50, **chosen).solve(charge(hierarchy))
    assert by_scene.residuals == by_hand.residuals


@pytest.mark.mpi(ranks=(1, 2, 3))
@pytest.mark.parametrize("backend", get_args(solver_options.Backend))
@pytest.mark.parametrize("boundary", ["dirichlet", "periodic", "neumann", "open", MIXED], ids=str)
def test_long_and_flat_cells_converge_like_cubes_on_any_decomposition(boundary, backend, comm):
    """Cells of 1:1:10 took 100 cycles in a refined level, and 27 in a base, by a point smoother and linear ghosts alone."""
    for first, stretch in ((None, (1, 1, 10)), (None, (1, 2.5, 10)), (8, (1, 1, 10)), (0, (1, 5, 1)), (8, (8, 8, 1))):
        hierarchies = [refined(on, boundary, first=first) for on in (comm, MPI.COMM_SELF)]
        (phi, report), (alone, single) = (solved(h, backend, stretch=stretch) for h in hierarchies)
        assert report.cycles <= (10 if first is None else 15), (stretch, report.cycles)
        assert report.cycles == single.cycles
        assert phi.sample(POINTS) == pytest.approx(alone.sample(POINTS), rel=1e-8, abs=1e-9 * alone.max_abs())


@pytest.mark.parametrize("smoother", get_args(solver_options.Smoother))
def test_every_smoother_serves_long_cells(smoother):
    hierarchy = refined(MPI.COMM_SELF, "dirichlet")
    phi, report = solved(hierarchy, smoother=smoother, stretch=(1, 1, 10))
    assert report.cycles <= 30
    assert difference(phi, solved(hierarchy, stretch=(1, 1, 10))[0]) < 1e-9


@pytest.mark.parametrize("backend", get_args(solver_options.Backend))
@pytest.mark.parametrize("sweeps", [(0, 2), (2, 0)])
def test_long_cells_converge_with_sweeps_on_one_side_alone(comm, sweeps, backend):
    """Their own cycles need sweeps on both: 57 and 50 cycles without."""
    domain = amrpic.Domain((0, 0, 0), (1, 1, 10), (16, 16, 16), boundary="dirichlet")
    hierarchy = amrpic.Hierarchy(comm, domain, [[((8, 8, 8), (23, 23, 23))]], blocking_factor=8)
    rho = amrpic.Field(hierarchy).fill(lambda x, y, z: 1e-9 * np.exp(-((x - 0.4) ** 2) * 40) + 0 * (y + z))
    _, report = PoissonSolver(hierarchy, sweeps=sweeps, backend=backend).solve(rho)
    assert report.converged and report.cycles <= 22

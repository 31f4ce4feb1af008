"""The benchmarks measure what they say, on tiny cases; a peer solves our problem; the comparison finds what became slower."""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
import pytest
from mpi4py import MPI

sys.path.insert(0, str(Path(__file__).parents[1] / "benchmarks"))
import cases
import goals
import measuring
import peers
import pic_step
import solving
from measuring import Record

from amrpic.poisson import PoissonSolver
from amrpic.verify.errors import errors

BENCHMARKS = Path(measuring.__file__).parent
WORLD = MPI.COMM_SELF


# ---- the work unit ----


def test_work_unit_grows_with_its_cells_and_is_bounded_by_memory():
    small, large = (measuring.work_unit(WORLD, cells) for cells in (10**5, 4 * 10**6))
    assert 20 * small.seconds < large.seconds
    for unit in small, large:
        assert 0.3 < unit.share_of_triad < 3  # other work on the machine moves it, but bytes are counted alike
        assert 1e8 < unit.triad < 1e13


def test_work_unit_of_few_cells_is_a_time():
    assert measuring.work_unit(WORLD, 1).seconds > 0


def test_a_void_unit_gives_no_figure():
    record = Record("a", [2.0], unit=1.0, share_of_triad=0.5)
    assert np.isnan(goals.Found([record]).units("a"))
    record.share_of_triad = 0.9
    assert goals.Found([record]).units("a") == 2.0


# ---- the cases and what is timed ----


@pytest.mark.parametrize("case, levels", [("static 16", 3), ("uniform 16", 1), ("1:1:10 16", 3)])
def test_solves_are_told_with_their_cycles(case, levels):
    given = cases.problem(WORLD, case, 8)
    setup, full, loose = solving.solves(given, case, measuring.BACKEND, 2, (solving.FULL, 1e-3))
    assert setup.name == f"solve, {case}, boxes 8, 1 rank, set-up"
    assert full.name == f"solve, {case}, boxes 8, 1 rank, 1e-10"
    assert len(full.seconds) == 2 and full.median > 0 and full.unit > 0
    assert full.facts["converged"] and full.facts["residual"] <= 1e-10
    assert full.facts["levels"] == levels and full.facts["cycles"] > loose.facts["cycles"]
    assert sum(full.facts["stages"].values()) <= 2 * max(full.seconds)


def test_discretization_error_is_measured_against_the_exact_potential():
    given = cases.problem(WORLD, "static 16", 16)
    *_, record = solving.solves(given, "static 16", measuring.BACKEND, 1, (solving.FULL, "discretization"))
    phi, _ = PoissonSolver(given.hierarchy).solve(given.rho, boundary_values=given.walls)
    assert given.exact is not None and errors([phi], given.exact)[1] > 0
    assert 0.5 < record.facts["error over the converged one"] < 1.5


def test_walls_are_remembered_by_place():
    calls = []
    remembered = cases.Remembered(lambda x, y, z: calls.append(1) or x + y + z)  # type: ignore[func-returns-value]
    one, other = np.arange(3.0), np.arange(1.0, 4.0)
    for x in one, other, one:
        assert np.array_equal(remembered(x, one, one), x + 2 * one)
    assert len(calls) == 2


def test_regrid_is_timed_beside_a_solve():
    names = [record.name for record in solving.following(WORLD, "static 16", 8, measuring.BACKEND, 1)]
    assert names[0] == "regrid, static 16, boxes 8, 1e-06 from zero φ" and names[-1].endswith("regrid")


def test_memory_of_the_solver_is_measured_in_a_process_of_its_own():
    (record,) = measuring.launch(BENCHMARKS / "solving.py", 1, ["--memory", "static 32"])
    taken = record.facts["bytes per cell, peak"]
    assert 8 < taken < 2000  # it has at least a residual


def test_a_step_is_told_by_stages():
    record = pic_step.ours(WORLD, 16, 1000, "dirichlet", measuring.BACKEND, 2)
    assert {"deposit", "solve", "gather", "push", "migrate"} <= set(record.facts["stages"])
    assert sum(record.facts["stages"].values()) <= 1.5 * max(record.seconds)


# ---- peers ----


def test_sine_transform_solves_the_equations_that_pyamg_gets():
    f = peers.right_hand_side(16)
    of_x, of_y, of_z = np.meshgrid(*[peers.eigenvalues(16)] * 3, indexing="ij", sparse=True)
    phi = peers.by_sine_transform(f, 1 / (of_x + of_y + of_z))
    assert np.abs(peers.matrix(16) @ phi.ravel() - f.ravel()).max() < 1e-13 * np.abs(f).max()


def test_peers_solve_our_problem_or_tell_how_to_install_them():
    found = list(peers.measure([16], measuring.BACKEND, 16, 1))
    names = [record.name for record in found if isinstance(record, Record)]
    assert names[:2] == ["peer, uniform 16, amrpic", "peer, uniform 16, scipy DST"]
    hints = [line for line in found if isinstance(line, str)]
    assert "peer, uniform 16, hypre PFMG-CG, 2 ranks" in names or any(peers.HYPRE in line for line in hints)


def test_a_peer_that_solves_something_else_is_refused():
    beside = peers.Beside(8, 1)
    beside.require_same("it", beside.wanted * (1 + 1e-10))
    with pytest.raises(SystemExit, match=r"it on uniform 8 differs by 1\.0e-02"):
        beside.require_same("it", beside.wanted * 1.01)


# ---- goals ----


def test_goals_are_met_or_missed_by_their_records():
    name = solving.name("bunch 64", 24, 1)
    of = [Record(name, [3.0, 1.0, 2.0], unit=0.02, share_of_triad=1.0, facts={"cycles": 9})]
    told = {goal.what: goal for goal in goals.goals(of)}
    units, cycles = told["bunch 64, boxes 24, to 1e-10"], told["its cycles"]
    assert units.measured == 100 and units.verdict == "met"
    assert cycles.measured == 9 and cycles.verdict == "missed"
    assert told["uniform 128 to 1e-10 against scipy's DST"].verdict == "not measured"
    rows = goals.table(list(told.values()))
    assert ("bunch 64, boxes 24, to 1e-10", "≤ 100 WU", "≤ 57 WU", "100 WU", "met") in rows


def test_cycles_that_differ_between_ranks_are_told():
    of = [
        Record(solving.name("static 64", boxes, ranks), [1.0], facts={"cycles": cycles})
        for boxes, ranks, cycles in ((24, 1, 7), (32, 2, 7), (24, 4, 8))
    ]
    (goal,) = (g for g in goals.goals(of) if g.what.startswith("static 64: spread"))
    assert goal.measured == 1 and goal.verdict == "missed" and goal.note == "cycles: 7, 8"


def test_records_survive_their_file(tmp_path):
    records = [Record("a", [1.0, 2.0], 0.5, 0.9, 8, 3, {"cycles": 7, "stages": {"x": 0.1}})]
    measuring.write(tmp_path / "b.json", records, quick=True)
    assert measuring.read(tmp_path / "b.json") == records

"""The benchmarks measure what they say, on tiny cases; a peer solves our problem; the comparison finds what became slower."""

from __future__ import annotations

import contextlib
import io
import json
import subprocess
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from mpi4py import MPI

import bases
import bench
import builds
import cases
import charts
import compare
import compare_records
import compensation
import gamma
import goals
import growth
import measuring
import orders
import particles
import peers
import performance
import pic_step
import sine
import solving
from amrpic.stages.poisson import PoissonSolver
from exact.errors import errors
from measuring import Record

BENCHMARKS = Path(measuring.__file__).parent
WORLD = MPI.COMM_SELF


# ---- all of it ----


@pytest.mark.parametrize("quick", [False, True])
def test_every_part_runs_a_script_that_there_is(quick):
    scripts = [part.script for part in bench.parts("matrix-free", quick, 1)]
    assert len(scripts) > 10 and all((BENCHMARKS / f"{script}.py").is_file() for script in scripts)


# ---- the work unit ----


def test_work_unit_grows_with_its_cells_and_is_bounded_by_memory():
    small, large = (measuring.work_unit(WORLD, cells) for cells in (10**5, 4 * 10**6))
    assert 10 * small.seconds < large.seconds
    for unit, cells in (small, 10**5), (large, 4 * 10**6):
        assert 1e8 < unit.triad < 1e13
        assert unit.seconds == pytest.approx(min(unit.apply, performance.APPLY_BYTES * cells / unit.triad))


def test_work_unit_of_one_cell_is_a_time_below_that_of_many():
    assert 0 < measuring.work_unit(WORLD, 1).seconds < measuring.work_unit(WORLD, 10**6).seconds


def test_order_4_is_timed_beside_order_2():
    records = {record.name: record for record in orders.beside(16, "open", 2)}
    second, means, points = (records[orders.name(16, "open", density)] for density in orders.DENSITIES)
    assert all(len(record.seconds) == 2 and record.median > 0 for record in records.values())
    assert second.facts["cycles"] < means.facts["cycles"] <= 13
    assert points.facts["cycles"] == means.facts["cycles"]


def test_steps_are_timed_with_each_compensation():
    records = list(compensation.steps("triangular-shaped-cloud", 1000, 2, cells=24))
    assert [record.name.split()[-1] for record in records] == ["none", "clouds", "clouds-and-mesh"]
    assert all(len(record.seconds) == 2 and record.facts["stages"]["push"] > 0 for record in records)


def test_goals_in_work_units_take_the_least():
    records = [Record("a", [2.0], unit=1.0), Record("b", [4.0], unit=1.0)]
    goal = goals.Found(records).in_units("a solve", ["a", "b"], 3, 1)
    assert goal.measured == 2.0 and goal.verdict == "met"
    assert goals.Found([]).in_units("a solve", ["a", "b"], 3, 1).verdict == "not measured"


# ---- the cases and what is timed ----


@pytest.mark.parametrize("case, levels", [("static 16", 3), ("uniform 16", 1), ("1:1:10 16", 3)])
def test_solves_are_reported_with_their_cycles(case, levels):
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
    (record,) = measuring.launch("solving", 1, ["--memory", "static 32"])
    taken = record.facts["bytes per cell, peak"]
    assert 8 < taken < 2000  # it has at least a residual


def test_a_step_is_reported_by_stages():
    record = pic_step.ours(WORLD, 16, 1000, "dirichlet", measuring.BACKEND, 1)
    assert {"deposit", "solve", "push", "migrate"} <= set(record.facts["stages"])
    assert sum(record.facts["stages"].values()) <= record.median


# ---- peers ----


def test_sine_transform_solves_the_equations_that_pyamg_gets():
    f = peers.right_hand_side(16)
    phi = sine.by_sine_transform(f, sine.inverse_eigenvalues(16))
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
    of = [Record(name, [3.0, 1.0, 2.0], unit=0.02, facts={"cycles": 9})]
    reported = {goal.what: goal for goal in goals.goals(of)}
    units, cycles = reported["bunch 64, boxes 24, to 1e-10"], reported["bunch 64, boxes 24: cycles"]
    assert units.measured == 100 and units.verdict == "met"
    assert cycles.measured == 9 and cycles.verdict == "missed"
    assert reported["uniform 128, boxes 64, to 1e-10: time per cell over the DST's"].verdict == "not measured"
    rows = goals.table(list(reported.values()))
    assert ("bunch 64, boxes 24, to 1e-10", "≤ 100 WU", "≤ 57 WU", "100 WU", "met") in rows


def test_cycles_that_differ_between_ranks_are_reported():
    of = [
        Record(solving.name("static 64", boxes, ranks), [1.0], facts={"cycles": cycles})
        for boxes, ranks, cycles in ((24, 1, 7), (32, 2, 7), (24, 4, 8))
    ]
    (goal,) = (g for g in goals.goals(of) if g.what.startswith("static 64: spread"))
    assert goal.measured == 1 and goal.verdict == "missed" and goal.note == "cycles: 7, 8"


def test_records_survive_their_file(tmp_path):
    records = [Record("a", [1.0, 2.0], 0.5, 8, 3, {"cycles": 7, "stages": {"x": 0.1}})]
    measuring.write(tmp_path / "b.json", records, quick=True)
    assert measuring.read(tmp_path / "b.json") == records


# ---- two runs compared ----


def runs_of(tmp_path: Path, name: str, **changed: Record) -> Path:
    """A made-up run: a solve and a stage, with what is changed."""
    records = {
        "solve": Record("solve", [1.0, 1.02, 0.98, 1.01, 0.99], 0.01, 8, 0, {"cycles": 7, "stages": {"a": 1.0}}),
        "stage": Record("stage", [2.0, 2.02, 1.98, 2.0, 2.01]),
        "noisy": Record("noisy", [1.0, 2.0, 0.5, 1.5, 0.7]),
        "memory": Record("memory", [1.0], facts={"bytes per cell, peak": 30.0}),
        **changed,
    }
    path = tmp_path / f"{name}.json"
    measuring.write(path, list(records.values()))
    return path


def compared(before: Path, after: Path, **options: Any) -> tuple[int, str]:
    with contextlib.redirect_stdout(io.StringIO()) as text:
        status = compare_records.run(before, after, **options)
    return status, text.getvalue()


def test_a_run_is_as_fast_as_itself(tmp_path):
    one = runs_of(tmp_path, "one")
    command = [*measuring.RUNNER, "compare_records", str(one), str(one)]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 0 and "0 slower, 0 faster, 5 as before; 0 in one run only" in done.stdout


def test_a_stage_that_became_slower_is_found(tmp_path):
    slow = Record("stage", [2.4, 2.42, 2.38, 2.4, 2.41])
    status, text = compared(runs_of(tmp_path, "one"), runs_of(tmp_path, "two", stage=slow))
    assert status == 1 and "slower  2 s     2.4 s  1.20   stage" in text
    status, text = compared(runs_of(tmp_path, "one"), runs_of(tmp_path, "two", stage=slow), threshold=0.25)
    assert status == 0


def test_a_stage_that_became_faster_is_no_failure(tmp_path):
    fast = Record("stage", [1.0, 1.02, 0.98, 1.0, 1.01])
    status, text = compared(runs_of(tmp_path, "one"), runs_of(tmp_path, "two", stage=fast))
    assert status == 0 and "0 slower, 1 faster" in text


def test_a_slower_machine_is_not_slower_code(tmp_path):
    there = Record("solve", [2.0, 2.04, 1.96, 2.02, 1.98], 0.02, 8, 0, {"cycles": 7})
    status, _ = compared(runs_of(tmp_path, "one"), runs_of(tmp_path, "two", solve=there))
    assert status == 0
    there.unit = 0.0  # without a unit seconds decide
    status, _ = compared(runs_of(tmp_path, "one"), runs_of(tmp_path, "two", solve=there))
    assert status == 1


def test_noise_is_no_change(tmp_path):
    other = Record("noisy", [1.3, 0.6, 2.1, 1.4, 0.9])
    status, text = compared(runs_of(tmp_path, "one"), runs_of(tmp_path, "two", noisy=other))
    assert status == 0 and "0 slower, 0 faster" in text


def test_a_cycle_more_and_memory_more_are_slower(tmp_path):
    more = Record("solve", [1.0, 1.02, 0.98, 1.01, 0.99], 0.01, 8, 0, {"cycles": 8})
    status, text = compared(runs_of(tmp_path, "one"), runs_of(tmp_path, "two", solve=more))
    assert status == 1 and "solve: cycles" in text
    more = Record("memory", [1.0], facts={"bytes per cell, peak": 36.0})
    status, text = compared(runs_of(tmp_path, "one"), runs_of(tmp_path, "two", memory=more))
    assert status == 1 and "memory: bytes per cell, peak" in text


def test_standard_error_of_a_median_is_that_of_draws():
    rng = np.random.default_rng(3)
    draws = rng.normal(10, 1, size=(4000, 101))
    found = np.mean([compare_records.error(list(row)) for row in draws[:200]])
    assert found == pytest.approx(np.median(draws, axis=1).std() / 10, rel=0.1)


# ---- two builds in turns ----


def made_up_turns(rng: np.random.Generator, change: float, noise: float, most: int) -> compare.Difference:
    """The difference of two builds whose ratio scatters by `noise`, with some outliers, after as many turns as decide."""
    old: list[float] = []
    new: list[float] = []
    while True:
        for side, speed in ((old, 1.0), (new, 1.0 + change)):
            disturbed = rng.exponential(5 * noise) if rng.random() < 0.05 else 0.0
            side.append(speed * float(np.exp(rng.normal(0, noise / np.sqrt(2)) + disturbed)))
        if len(old) >= most or (len(old) >= compare.TURNS and len(old) % 10 == 1):
            found = compare.difference(old, new)
            if len(old) >= most or found.decided():
                return found


def test_a_difference_of_three_percent_is_found_in_noise_of_ten():
    rng = np.random.default_rng(2)
    found = [made_up_turns(rng, 0.03, 0.1, 900) for _ in range(40)]
    assert sum(one.verdict().startswith("slower by") for one in found) >= 36
    assert all(one.error < compare.LARGEST_ERROR for one in found)
    assert np.median([one.change for one in found]) == pytest.approx(0.03, abs=0.003)


@pytest.mark.parametrize("noise, most", [(0.02, 60), (0.1, 11), (0.1, 100)])
def test_equal_builds_are_hardly_ever_called_different(noise, most):
    rng = np.random.default_rng(3)
    verdicts = [made_up_turns(rng, 0.0, noise, most).verdict() for _ in range(300)]
    assert sum("er by" in verdict for verdict in verdicts) <= 0.05 * len(verdicts)
    if noise == 0.02:
        assert verdicts.count("no difference above 3%") > 0.95 * len(verdicts)


def test_a_verdict_says_how_many_turns_it_needs():
    rng = np.random.default_rng(4)
    wanted = np.median([made_up_turns(rng, 0.03, 0.1, 900).turns for _ in range(10)])
    reported = [made_up_turns(rng, 0.03, 0.1, 60).verdict() for _ in range(30)]
    needs = [int(one.split()[-2]) for one in reported if one.startswith("too noisy to tell: needs about")]
    assert len(needs) > 10 and 0.6 * wanted < np.median(needs) < 1.6 * wanted


def test_standard_error_of_the_median_is_that_of_draws():
    draws = np.random.default_rng(3).normal(0, 1, size=(4000, 31))
    found = np.mean([compare.median_error(list(row)) for row in draws[:400]])
    assert found == pytest.approx(np.median(draws, axis=1).std(), rel=0.1)
    assert compare.median_error([1.0] * 4) == np.inf


def test_figures_are_reported_over_the_sine_transform_and_particles_in_nanoseconds():
    solver, stages = compare.Case("uniform 128"), compare.Case("particles 1e6")
    for factor in (1.0, 1.1, 0.9, 1.05, 0.95, 1.0):  # the machine, in both
        solver.add({"DST": 3e-8 * factor, "solve": 3e-8 * factor}, {"DST": 3e-8, "solve": 3.6e-8})
        stages.add({"DST": 3e-8, "deposit": 8e-9}, {"DST": 3e-8, "deposit": 8e-9})
    rows = compare.table([solver, stages])
    assert rows[1] == ("uniform 128: solve", "1 DST", "1.2 DST", "1.200", "0.000", "6", "slower by 20.0% ± 0.0%")
    assert rows[2][:3] == ("particles 1e6: deposit", "8 ns", "8 ns") and rows[2][-1] == "no difference above 3%"


def test_a_case_is_measured_in_a_process_of_a_build(tmp_path):
    package, own = tmp_path / "package", tmp_path / "benchmarks"
    for folder in (package / "amrpic", own):
        folder.mkdir(parents=True)
    (package / "amrpic" / "__init__.py").touch()
    build = builds.Build("here", package, {"AMRPIC_TEST": "1"})
    (own / "turn.py").write_text("import amrpic, os; print(amrpic.__file__, os.environ['AMRPIC_TEST'])")
    assert build.run("turn").split() == [str(package / "amrpic" / "__init__.py"), "1"]
    with pytest.raises(SystemExit, match="no-such-revision is no git revision"):
        builds.build("no-such-revision@A=1")


# ---- bases, and long cells ----


def test_bases_are_timed_beside_the_nearest_smooth_one():
    assert [bases.nearest(n) for n in (72, 81, 96, 125, 127, 250)] == [64, 96, 128, 128, 128, 256]
    one, other = bases.measure(24, 2, 1000.0)
    assert one.name == "base, 24" and len(one.seconds) == len(other.seconds) == 2
    skipped = Record("base, 81", [float("nan")], facts={"skipped": "not done within 60 s"})
    reported = bases.rows({record.name: record for record in (one, other, skipped)})
    assert reported[1][0] == "24³" and reported[1][-1] == "2" and reported[2][-2] == "not done within 60 s"
    (goal, *_) = goals.any_base(goals.Found([skipped]))
    assert goal.verdict == "missed" and goal.note == "1 of 1 not done"


def test_long_cells_are_timed_beside_cubes():
    one, cubes = gamma.measure(10, "one level", "dirichlet", 32, 1, 1000.0)
    assert cubes.name == one.name + gamma.CUBES and one.facts["bytes beyond"] > 0
    records = {record.name: record for record in (one, cubes)}
    assert 0 < gamma.gamma_ratio(records, one) < 100 and 0 < gamma.memory_ratio(one) < 100
    assert gamma.rows(records)[1][:4] == ("10", "one level", "dirichlet", "32")


def test_a_part_that_takes_too_long_is_skipped():
    (record,) = measuring.launch_or_skip("bases", ["--bases", "251"], "it", 0.5)
    assert record.skipped.startswith("not done within")


# ---- growth, charts and the document ----


def test_power_law_is_found():
    sizes = np.array([10, 20, 50, 100])
    found = growth.law("solve", "cells", list(zip(sizes, 3 * (sizes / 10) ** 1.25, strict=True)))
    assert found.exponent == pytest.approx(1.25) and found.scale == pytest.approx(3) and found.off < 1e-12
    bent = growth.law("solve", "cells", list(zip(sizes, 3 + (sizes / 10) ** 2.0, strict=True)))
    assert bent.off > 0.1


def made_up() -> list[Record]:
    """Records of every kind that charts and the document show."""
    stages = {"residual": 0.2, "pre_smooth_and_restrict": 0.5}
    out = [
        Record(
            solving.name(case, boxes, ranks, what),
            [1.0 / ranks],
            0.01,
            10**6,
            facts={"cycles": 7, "stages": stages},
            dst=[5e-8],
        )
        for case in ("static 64", "bunch 64", "uniform 64")
        for boxes in (24, 32)
        for ranks in (1, 2)
        for what in ("1e-10", "1e-06", "discretization")
    ]
    for at, who in enumerate(("amrpic", "scipy DST", "hypre PFMG-CG", "hypre PFMG-CG, set-up")):
        out.append(Record(peers.peer_name(64, who), [0.1 * (at + 1)], 0.01, 64**3, facts={"iterations": 9}))
    for stage in particles.STAGES:
        for count in (10**5, 10**6):
            out.append(Record(particles.record_name(stage, count, "cloud-in-cell"), [1e-8 * count], particles=count))
    for levels in (1, 2, 4):
        name = f"growth, levels {levels}, boxes 32, 1 rank, 1e-10"
        out.append(Record(name, [0.1 * levels], 0.01, 8 * levels, facts={"levels": levels, "boxes": levels}))
    step = Record(pic_step.step_name("amrpic", 64, 10**6, "dirichlet"), [0.2], facts={"stages": {"deposit": 0.1}})
    return [*out, step, Record("memory, static 128, boxes 32", [1.0], cells=8, facts={"bytes per cell, peak": 30.0})]


def test_every_chart_is_drawn(tmp_path):
    files = charts.draw(made_up(), tmp_path)
    assert [path.stem for path in files] == list(charts.CHARTS)
    assert charts.draw([], tmp_path / "none") == []


def test_document_tells_what_was_measured(tmp_path):
    about = {
        "machine": {"processor": "P", "instructions": "AVX2", "cores": 2, "load": 0.5, "time": "now", "commit": "abc"},
        "backend": "crs",
        "runs": 5,
    }
    measuring.write(tmp_path / "bench.json", made_up(), **about)
    text = performance.write(tmp_path / "bench.json", tmp_path).read_text()
    assert "| bunch 64, boxes 24, to 1e-10 | ≤ 100 WU | ≤ 57 WU | 100 WU | met |" in text
    assert "| static 64 | 24 | 1.00 M | 1 s | 100 | 20× | 7 | 14.3 | 100 | 100 | 592 |" in text
    assert "| static 64 | 32 | 1 s | 0.5 s | 2.00× |" in text
    assert "| 64³ | hypre PFMG-CG | 0.4 s | 0.3 s | 30 | 9 |" in text
    assert "| deposit | particles | 100000 | 1000000 | 1.00 | 0% |" in text
    for picture in (line.split("(")[1].rstrip(")") for line in text.splitlines() if line.startswith("![")):
        assert (tmp_path / picture).exists()
    assert json.loads((tmp_path / "bench.json").read_text())["backend"] == "crs"


def test_memory_of_particles_is_measured_in_a_process_of_its_own():
    arguments = ["--memory", "--particles", "2e5", "--cells", "16", "--box", "8"]
    (record,) = measuring.launch("particles", 1, arguments)
    held, peak = (record.facts[f"bytes per particle, {what}"] for what in ("held", "peak"))
    assert 56 * 0.9 < held < 1.5 * 56 and peak > 1.5 * held  # three positions, three momenta and id; old and new

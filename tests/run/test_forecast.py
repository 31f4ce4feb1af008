"""How long a run will take follows from trials that keep to their time."""

from __future__ import annotations

import math
import time as real_time
from pathlib import Path
from types import SimpleNamespace

import pytest

import amrpic
from amrpic.pic import forecast as module
from amrpic.pic.forecast import Forecast, Trial, _coarser, _extrapolated, forecast

EXAMPLES = Path(__file__).parents[2] / "examples"


def scene(folder: Path, cells: int = 16, steps: int = 4, **more) -> amrpic.Scene:
    return amrpic.Scene(
        domain=amrpic.Domain(-0.1, 0.1, cells, boundary="dirichlet"),
        bunches=[amrpic.GaussianBunch(species="electron", sigma=0.01, charge="-10 pC", particles=8000)],
        refinement={"levels": 1, "blocking_factor": 4, "regrid_every": 2},
        motion=amrpic.Leapfrog(dt="50 ps"),
        schedule={"steps": steps},
        output={"directory": str(folder), "write": ["series", "checkpoint"], "checkpoint_every": 10},
        **more,
    )


@pytest.mark.mpi(ranks=(1, 2), timeout=120)
def test_a_small_run_is_tried_itself_and_leaves_nothing(comm, tmp_path, monkeypatch):
    advance = amrpic.Simulation.advance

    def slow(self, steps=1):
        real_time.sleep(0.1)
        return advance(self, steps)

    monkeypatch.setattr(amrpic.Simulation, "advance", slow)
    if comm.rank == 0:
        (tmp_path / "series.csv").write_text("of an earlier run\n")
    comm.Barrier()
    found = forecast(comm, scene(tmp_path), 20_000, 3.0, 100.0)
    assert found is not None and found.source == "4 steps of it" and found.step > 0.1 and found.start > 3.0
    comm.Barrier()
    assert [path.name for path in tmp_path.iterdir()] == ["series.csv"]
    assert (tmp_path / "series.csv").read_text() == "of an earlier run\n"


def test_there_is_no_time_in_no_seconds(comm, tmp_path):
    assert forecast(comm, scene(tmp_path), 20_000, 0.0, 0.0) is None
    assert not list(tmp_path.iterdir())


def test_at_least_two_steps_and_one_with_regrid_are_taken(comm, tmp_path):
    _, cells, steps = module._tried(
        comm, scene(tmp_path, steps=50).replace(refinement={"levels": 1, "regrid_every": 40}), 0.0
    )
    assert steps == 3 and cells > 16**3


def test_the_first_step_counts_once():
    """It finds new memory and cold caches; as the mean of all steps it would make a forecast twice too long."""
    assert module._parts([(False, 0.4), (False, 0.2), (False, 0.2), (True, 0.5)]) == pytest.approx(
        {"step": 0.2, "regrid": 0.3, "first": 0.2}
    )
    assert module._parts([(True, 0.9), (True, 0.5)]) == pytest.approx({"step": 0.5, "regrid": 0.0, "first": 0.4})
    assert module._parts([(False, 0.4)]) == pytest.approx({"step": 0.4, "regrid": 0.0, "first": 0.0})
    assert module._parts([]) == {"step": 0.0, "regrid": 0.0, "first": 0.0}
    assert Trial(0.0, 0.0, 0.2, 0.0, 0.0, first=0.2).per_step(
        amrpic.Scene.from_toml(EXAMPLES / "ten_bunches.toml")
    ) == (pytest.approx(0.2 + 0.2 / 9))


class Clock:
    """Time that passes only as runs take it: so much for each cell, and something for each run."""

    def __init__(self, per_cell: float, fixed: float) -> None:
        self.now, self.per_cell, self.fixed = 0.0, per_cell, fixed
        self.cells: list[int] = []

    def perf_counter(self) -> float:
        return self.now

    def trial(self, cells: float) -> Trial:
        return Trial(*(weight * (self.fixed + self.per_cell * cells) for weight in (3.0, 2.0, 1.0, 0.5, 0.25)))

    def tried(self, comm, given, end):
        held = 3 * math.prod(given.domain.cells)
        self.cells.append(held)
        self.now += self.trial(held).total
        return self.trial(held), held, 5


@pytest.mark.parametrize("cells", [64, 256, 1024])
@pytest.mark.parametrize("fixed", [0.0, 0.02])
@pytest.mark.parametrize("per_cell", [1e-8, 1e-6, 1e-5])
def test_trials_keep_to_their_time_and_larger_runs_follow_from_them(
    comm, tmp_path, monkeypatch, cells, fixed, per_cell
):
    clock = Clock(per_cell, fixed)
    monkeypatch.setattr(module, "time", clock)
    monkeypatch.setattr(module, "_tried", clock.tried)
    given, held = scene(tmp_path, cells), 3 * cells**3
    found = forecast(comm, given, held, 7.0, 5.0)
    assert clock.now <= 5.0 and clock.cells == sorted(set(clock.cells))
    assert isinstance(found, Forecast)
    expected = clock.trial(held)
    if len(clock.cells) == 1 and clock.cells[0] < held:  # all that there was time for: in proportion
        expected = _extrapolated([(clock.cells[0], clock.trial(clock.cells[0]))], held)
    assert found.start == pytest.approx(7.0 + expected.start) and found.step == pytest.approx(expected.per_step(given))
    assert (found.source == "5 steps of it") == (clock.cells[-1] == held)
    next_one = clock.trial(8 * clock.cells[-1]).total  # there was no time for it, or it was the last
    assert clock.cells[-1] == held or clock.now + 1.5 * next_one > 5.0


def test_regrids_and_dumps_are_shared_out_over_their_steps(comm, tmp_path):
    trial, given = Trial(1.0, 3.0, 0.5, 0.25, 1.0), scene(tmp_path, steps=40)
    assert trial.per_step(given) == pytest.approx(0.5 + 0.25 / 2 + 1.0 / 10)
    assert trial.per_step(given.replace(output={"write": ["series"]})) == pytest.approx(0.5 + 0.25 / 2)
    short = scene(tmp_path, steps=9).replace(
        refinement={"levels": 1, "regrid_every": 5}
    )  # one regrid in nine steps, no dump
    assert trial.per_step(short) == pytest.approx(0.5 + 0.25 / 9)
    still = given.replace(refinement={"regrid_every": 0}, output={"write": ["fields", "checkpoint"], "fields_every": 4})
    assert trial.per_step(still) == pytest.approx(0.5 + 1.0 / 4 + 1.0 / 10)


def test_what_is_tried_has_coarser_cells_and_fewer_particles_in_proportion(comm, tmp_path):
    flat = scene(tmp_path).replace(domain=amrpic.Domain(-1, 1, (64, 32, 2)))
    for factor, cells in ((1, (64, 32, 2)), (2, (32, 16, 2)), (8, (8, 8, 2))):
        made = _coarser(flat, factor)
        assert made.domain.cells == cells
        assert made.particle_count() == math.ceil(8000 * math.prod(cells) / (64 * 32 * 2))
    lattice = amrpic.LatticeBunch(per_axis=(12, 6, 2), charge="1 nC")
    assert _coarser(flat.replace(bunches=[lattice]), 4).bunches[0].number == 3


def test_times_grow_linearly_from_two_trials_and_in_proportion_from_one():
    one, two = Trial(0.5, 1.0, 0.2, 0.0, 0.1), Trial(0.5, 2.0, 0.3, 0.0, 0.1)

    def found(tried: list[tuple[float, Trial]], cells: float) -> list[float]:
        return [getattr(_extrapolated(tried, cells), part) for part in ("start", "step", "regrid", "dump")]

    assert found([(100, one)], 300) == pytest.approx([3.0, 0.6, 0.0, 0.3])
    assert found([(100, one), (200, two)], 400) == pytest.approx([4.0, 0.5, 0.0, 0.1])
    assert _extrapolated([(100, two), (200, one)], 400) == one  # noise: a larger run is no shorter


def test_a_run_of_one_solve_is_started_a_few_times_and_its_median_counts(comm, tmp_path, monkeypatch):
    clock, took = Clock(0.0, 0.0), iter([1.0, 7.0, 2.0])

    class Slow:
        def __init__(self, comm, scene):
            clock.now += next(took) + 0.5
            self.state = SimpleNamespace(seconds={"beam": 0.5})

    monkeypatch.setattr(module, "time", clock)
    monkeypatch.setattr(module, "Simulation", Slow)
    once = scene(tmp_path).replace(schedule={"steps": 0})
    assert module._started(comm, once, 100.0)[1:] == (0.5, 2.0)
    took = iter([1.0])
    assert module._started(comm, scene(tmp_path), 100.0)[1:] == (0.5, 1.0)  # a run with steps once
    took = iter([1.0])
    assert module._started(comm, once, clock.now + 3.0)[1:] == (0.5, 1.0)  # there is no time for more

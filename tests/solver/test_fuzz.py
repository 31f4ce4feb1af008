"""Random problems give the same answer at the same cost on any ranks, boxes, backend and instruction set; see `fuzz`.

An ordinary run takes 60 small ones, always the same; `pytest -m long` 2,000 fresh ones, as far as 20 minutes go, and those
that failed once.
"""

from __future__ import annotations

import secrets
import subprocess
import sys
from pathlib import Path

import pytest

import fuzz
import mpi_batch
from fuzz_case import Case
from fuzz_draw import LARGE, SMALL, plainer
from fuzz_pool import Broken, Pool

# Seeds and numbers of large cases that failed: unconverged after the residual grew, over cycles, over memory.
FOUND = ((864211, 32), (864211, 420), (864211, 1030), (864211, 310))


def check(results: list[fuzz.Result], seed: int) -> None:
    print(fuzz.summary(seed, results))
    failed = [fuzz.line(seed, result) for result in results if result.failures]
    assert not failed, f"{len(failed)} of {len(results)} cases failed; shrunk ones are printed above"


def test_sixty_small_problems_do_not_depend_on_how_they_are_solved():
    results, _ = fuzz.run_all(1, range(60), SMALL, shrink=1, seconds=240)
    check(results, 1)


@pytest.mark.long
def test_two_thousand_problems_do_not_depend_on_how_they_are_solved():
    seed = secrets.randbelow(10**6)
    print(f"seed {seed}")
    results, _ = fuzz.run_all(seed, range(2000), LARGE, shrink=1, seconds=1200)
    check(results, seed)


@pytest.mark.long
@pytest.mark.parametrize(("seed", "number"), FOUND)
def test_problems_that_once_failed_pass(seed, number):
    check(fuzz.run_all(seed, [number], LARGE, shrink=0)[0], seed)


# --- what finds the failures ---


def test_calls_run_on_as_many_ranks_as_asked_for_and_processes_live_on():
    with Pool(3) as pool:
        assert [pool.call("pool_calls:ranks_and_sum", n, 2) for n in (3, 1, 2)] == [(3, 6), (1, 2), (2, 4)]
        first = list(pool.pids)
        pool.call("pool_calls:ranks_and_sum", 3, 2)
        assert pool.pids == first and len(first) == 3


@pytest.mark.parametrize(
    ("function", "kind", "said", "timeout"),
    [("sleep_on_the_last_rank", "hang", "sleep_on_the_last_rank", 1), ("end_on_the_last_rank", "crash", "no more", 60)],
)
def test_a_pool_survives_what_hangs_and_crashes(function, kind, said, timeout):
    with Pool(2) as pool:
        with pytest.raises(Broken, match=said) as broken:
            pool.call(f"pool_calls:{function}", 2, timeout=timeout)
        assert broken.value.kind == kind
        assert pool.call("pool_calls:ranks_and_sum", 2, 1) == (2, 2)


def test_a_case_is_drawn_from_its_seed_and_number_alone():
    assert [fuzz.draw(3, n, SMALL) for n in range(20)] == [fuzz.draw(3, n, SMALL) for n in range(20)]
    assert len({fuzz.draw(3, n, SMALL) for n in range(20)}) == 20


def test_extents_may_be_any_and_the_last_block_then_shorter():
    drawn = [fuzz.draw(3, n, SMALL) for n in range(100)]
    assert any(n % 2 for case in drawn for n in case.cells)
    for case in drawn:
        for level, boxes in enumerate(case.levels, start=1):
            for lower, upper in boxes:
                for a, b, n in zip(lower, upper, case.cells, strict=True):
                    assert a % case.blocking_factor == 0 and a <= b < n * 2**level
                    assert (b + 1) % case.blocking_factor == 0 or b + 1 == n * 2**level


def test_shrinking_ends_at_the_plainest_case_that_still_fails():
    """Fails: anything with a level along which there are more than 8 cells."""

    def fails(case: Case) -> bool:
        return bool(case.levels) and case.cells[0] > 8

    case = next(c for n in range(1000) if fails(c := fuzz.draw(5, n, SMALL)) and len(c.levels) > 1 and c.ranks > 1)
    again = True
    while again:
        again = False
        for other in plainer(case):
            if fails(other):
                case, again = other, True
                break
    assert len(case.levels) == 1 and len(case.levels[0]) == 1
    assert case.ranks == 1 and case.aspect_ratio == 1 and case.cells[0] <= 16 and case.backend == "matrix-free"


@pytest.mark.parametrize("name", ["fuzz", "metal_fuzz"])
def test_the_command_runs_by_itself(name):
    """As the page on contributing and `make sanitize` have it: without pytest's paths."""
    script = Path(__file__).parents[1] / "support" / f"{name}.py"
    done = subprocess.run(
        [sys.executable, str(script), "--cases", "1", "--seed", "1"],
        env=mpi_batch.ENVIRONMENT,
        capture_output=True,
        text=True,
    )
    assert done.returncode == 0 and "seed 1: 1 cases, 0" in done.stdout, done.stdout + done.stderr


def test_the_snippet_of_a_case_runs(tmp_path):
    path = tmp_path / "case.py"
    path.write_text(Case((8, 8, 8), ranks=2, max_grid_size=4, blocking_factor=4, guess="previous").snippet())
    done = subprocess.run(
        ["mpiexec", "-n", "2", sys.executable, str(path)], env=mpi_batch.ENVIRONMENT, capture_output=True, text=True
    )
    assert done.stdout.count("cycles") == 2, done.stderr

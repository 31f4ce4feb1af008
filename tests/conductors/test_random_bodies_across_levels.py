"""Solutions with electrodes on several levels equal those of an independent assembly, solved by a sparse direct method.

An ordinary run takes a few of a fixed seed; `pytest -m long` 2,000 fresh ones, as far as 20 minutes go. See `metal_fuzz`.
"""

from __future__ import annotations

import secrets
from collections.abc import Sequence

import pytest

import metal_fuzz

# Of seed 1: metal behind a wall, and in narrow gaps whose cells are relaxed; covered cells at walls and in gaps, which hold
# means of children in metal.
FOUND = (7, 9, 1022, 1026)


def check(seed: int, numbers: Sequence[int], seconds: float = 1200.0) -> None:
    results = list(metal_fuzz.run_all(seed, numbers, seconds))
    print(f"seed {seed}: {len(results)} of {len(numbers)} cases")
    failed = [metal_fuzz.line(seed, result) for result in results if result.failure]
    assert not failed, "\n".join(failed)


def test_a_few_random_bodies_on_random_hierarchies():
    check(1, (*range(4), *FOUND))


@pytest.mark.long
def test_two_thousand_random_bodies_on_random_hierarchies():
    check(secrets.randbelow(10**6), range(2000))


def test_a_case_is_drawn_from_its_seed_and_number_alone():
    assert metal_fuzz.draw(3, 5) == metal_fuzz.draw(3, 5)

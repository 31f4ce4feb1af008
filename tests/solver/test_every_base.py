"""Every base n³ is solved to 1e-10 in as few cycles as a power of two, on any ranks and for any boxes.

One level, Gaussian charge off the centre, its mean taken away where walls fix no potential. Up to n = 64 all of 1 to 4 ranks
are combined with boxes of 24, 32 and 64; up to 127 six of these twelve, each number of ranks and size at least once; beyond,
three for Dirichlet walls and two for the others, since a solve takes seconds there. It takes 20 minutes:
`pytest -m long`.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from itertools import product

import pytest

from fuzz_case import Case
from fuzz_pool import Broken, Pool

BASES = (*range(16, 65), 72, 81, 88, 96, 100, 120, 125, 127, 144, 160, 176, 192, 200, 250, 251, 256)

pytestmark = pytest.mark.long


@pytest.fixture(scope="module")
def pool() -> Iterator[Pool]:
    with Pool(4) as several:
        yield several


def limit(kind: str, n: int) -> int:
    """Cycles that walls of a kind allow."""
    return {"dirichlet": 7, "open": 7, "neumann": 8, "periodic": 9 if n % 2 else 7}[kind]


def decompositions(kind: str, n: int) -> list[tuple[int, int]]:
    """Ranks and size of boxes."""
    if n <= 64:
        return list(product((1, 2, 3, 4), (24, 32, 64)))
    if n <= 127:
        return [(1, 24), (2, 24), (3, 24), (4, 24), (3, 32), (2, 64)]
    return [(1, 24), (3, 24), (4, 64)] if kind == "dirichlet" else [(1, 32), (4, 24)]


@pytest.mark.parametrize("n", BASES)
def test_a_base_takes_few_cycles_on_any_ranks_and_boxes(pool, n):
    complaints = []
    for kind in ("dirichlet", "open", "neumann", "periodic"):
        plain = Case((n,) * 3, boundary=((kind, kind),) * 3)
        found = {}
        for ranks, size in decompositions(kind, n):
            try:
                case = replace(plain, ranks=ranks, max_grid_size=size)
                outcome = pool.call("fuzz_case:solve", ranks, case, False, timeout=60)
            except Broken as broken:  # such as a bottom that takes minutes
                complaints.append(f"{kind}, {ranks} ranks, boxes of {size}: {broken.kind}")
                continue
            if outcome.error or not outcome.converged:
                complaints.append(f"{kind}, {ranks} ranks, boxes of {size}: {outcome.error or outcome.reason}")
            found[ranks, size] = outcome.cycles
        cycles = found.values()
        if cycles and (max(cycles) > limit(kind, n) or max(cycles) > min(cycles) + 1):
            complaints.append(f"{kind}: {found}, at most {limit(kind, n)} and equal within one")
    assert not complaints, "\n".join(complaints)

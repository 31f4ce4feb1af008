"""The benchmark of the particle stages runs with every shape."""

from __future__ import annotations

import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parents[2] / "benchmarks"))
import particles as benchmark

from amrpic.particles.clouds import SHAPES


def test_every_stage_takes_time():
    for shape in SHAPES:
        found = benchmark.measure(500, 16, 8, shape, repeats=1)
        assert list(found) == list(benchmark.STAGES)
        assert all(value > 0 for value in found.values())

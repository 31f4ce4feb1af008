"""The benchmark of forecasts runs a scene and says by which factor its forecast was off."""

from __future__ import annotations

import sys
from pathlib import Path

import pytest

sys.path.insert(0, str(Path(__file__).parents[2] / "benchmarks"))
import forecasts


def test_a_short_run_is_foreseen_and_taken(comm, tmp_path):
    text = (forecasts.ROOT / "examples" / "waist.toml").read_text().replace("steps = 20", "steps = 2")
    assert "steps = 2 " in text or "steps = 2\n" in text
    (tmp_path / "short.toml").write_text(text)
    found = forecasts.compare(comm, tmp_path / "short.toml")
    assert found.scene == "short" and found.steps == 2 and found.source == "2 steps of it"
    assert min(*found.foreseen, *found.taken, found.end) > 1e-4
    assert len(forecasts.rows([found])) == 2


@pytest.mark.parametrize("foreseen", [0.5, 2.0])
def test_too_long_is_as_wrong_as_too_short(foreseen):
    one = forecasts.Compared("one", 10, "", (1.0, foreseen), (1.0, 1.0), 0.0)
    assert one.factor == 2.0

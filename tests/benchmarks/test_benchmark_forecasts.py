"""The benchmark of forecasts runs a scene and says by which factor its forecast was off."""

from __future__ import annotations

import pytest

import forecasts

pytestmark = pytest.mark.long  # what is tested is a tool, which users do not meet: for `make verify`


def test_a_short_run_is_foreseen_and_taken():
    found = forecasts.compare(forecasts.ROOT / "examples" / "waist.toml", 2, steps=3)
    assert (found.scene, found.ranks, found.steps) == ("waist", 2, 3)
    assert (
        "steps of it" in found.source or "of its cells" in found.source
    )  # on a busy machine the scene itself takes too long
    assert min(*found.foreseen, *found.taken) > 1e-4
    header, row = forecasts.rows([found])
    assert dict(zip(header[:2], row[:2], strict=True)) == {"scene": "waist", "ranks": "2"}


@pytest.mark.parametrize("foreseen", [0.5, 2.0])
@pytest.mark.parametrize("steps", [0, 10])
def test_too_long_is_as_wrong_as_too_short(foreseen, steps):
    """Of a run of one solve the start is judged, of others the steps."""
    other = 1.2
    pair = (other, foreseen) if steps else (foreseen, other)
    one = forecasts.Compared("one", 1, steps, "", pair, (1.0, 1.0))
    assert one.factor == 2.0
    assert [goal.verdict for goal in forecasts.verdicts([one])] == ["missed"]

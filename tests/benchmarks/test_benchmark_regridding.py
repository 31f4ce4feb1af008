"""The benchmark of regrid and set-up measures a mesh that changes, and its times do not grow like the square of the boxes."""

from __future__ import annotations

import pytest

import regridding
from growth import law

pytestmark = pytest.mark.long  # what is tested is a tool, which users do not meet: for `make verify`


def test_regrid_and_set_up_grow_with_the_boxes():
    found = [regridding.measure(base, runs=2) for base in (8, 16, 32)]
    assert [one.boxes for one in found] == sorted(one.boxes for one in found) and found[-1].boxes > 40_000
    for goal in regridding.goals(found):
        if goal.what == "bytes per box":
            assert goal.verdict == "met"
    for stage in regridding.STAGES:  # processor time, so bounds are loose: comparing all with all gives 2
        exponent = law(stage, "boxes", [(one.boxes, one.seconds[stage]) for one in found]).exponent
        assert 0.5 < exponent < 1.4, stage

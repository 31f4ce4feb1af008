"""The benchmark of regrid and set-up measures a mesh that changes; its times are judged by the benchmark alone."""

from __future__ import annotations

import pytest

import regridding

pytestmark = pytest.mark.long  # what is tested is a tool, which users do not meet: for `make verify`


def test_every_stage_is_measured_on_meshes_that_grow():
    measured = [regridding.measure(base, runs=1) for base in (8, 16)]
    assert measured[1].boxes > 6 * measured[0].boxes and measured[1].refined > 6 * measured[0].refined > 0
    for one in measured:
        assert all(one.seconds[stage] > 0 for stage in regridding.STAGES)
    goals = {goal.what: goal for goal in regridding.goals(measured)}
    assert goals["bytes per box"].verdict == "met"
    assert {f"exponent of {stage}" for stage in regridding.STAGES} < set(goals)


def test_times_like_the_square_of_the_boxes_miss_their_goal():
    times = dict.fromkeys(regridding.STAGES, 1e-09)
    grown = [
        regridding.Timed(n, 1, 100.0, {stage: n**2 * value for stage, value in times.items()})
        for n in (500, 4000, 32000)
    ]
    goals = {goal.what: goal for goal in regridding.goals(grown)}
    assert all(goals[f"exponent of {stage}"].verdict == "missed" for stage in regridding.STAGES)

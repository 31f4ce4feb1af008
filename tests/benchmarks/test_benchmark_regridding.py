"""The benchmark of regrid and set-up measures a mesh that changes; its times are judged by the benchmark alone."""

from __future__ import annotations

import pytest

import goals
import regridding
from measuring import Record

pytestmark = pytest.mark.long  # what is tested is a tool, which users do not meet: for `make verify`


def judged(records: list[Record]) -> dict[str, goals.Goal]:
    return {goal.what.removeprefix("boxes: "): goal for goal in goals.boxes(goals.Found(records))}


def test_every_stage_is_measured_on_meshes_that_grow():
    small, large = (list(regridding.measure(base, runs=1)) for base in (8, 16))
    for one, other in zip(small, large, strict=True):
        assert all(other.facts[what] > 6 * one.facts[what] > 0 for what in ("boxes", "refined"))
        assert one.median > 0 and other.median > 0
    found = judged(small + large)
    assert found["metadata of each"].verdict == "met"
    assert all(found[f"exponent of {stage}"].verdict != "not measured" for stage in regridding.STAGES)


def test_times_like_the_square_of_the_boxes_miss_their_goal():
    grown = [
        Record(regridding.name(n, stage), [1e-9 * n**2], facts={"boxes": n, "bytes per box": 100.0})
        for n in (500, 4000, 32000)
        for stage in regridding.STAGES
    ]
    found = judged(grown)
    assert all(found[f"exponent of {stage}"].measured == pytest.approx(2) for stage in regridding.STAGES)
    assert all(found[f"exponent of {stage}"].verdict == "missed" for stage in regridding.STAGES)
    assert found["a regrid of 16000"].measured == pytest.approx(2e3 * 1e-9 * 16000**2)
    assert {goal.verdict for goal in judged([]).values()} == {"not measured"}

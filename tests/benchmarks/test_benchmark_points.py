"""The benchmark of operators at points: its records, its peer's product, and the goals made of them."""

from __future__ import annotations

import numpy as np
import pytest
from mpi4py import MPI

import ceed_peer
import goals
import points
from amrpic import _native, fem
from measuring import Record

pytestmark = pytest.mark.long  # what is tested is a tool, which users do not meet: for `make verify`


def test_nominal_flops_are_those_of_sums_axis_by_axis():
    assert [points.nominal_flops(fem.Poisson, p) for p in (1, 2, 3, 4)] == [136, 360, 752, 1360]
    assert points.nominal_flops(fem.Mass, 2) == 4 * (27 + 9 + 3)


def test_the_peak_is_one_of_a_core():
    assert 1e9 < _native.measure_fma_peak() < 1e12


def test_products_are_timed_with_what_they_amount_to(monkeypatch):
    monkeypatch.setattr(points, "CELLS", {2: 2})
    (record,) = points.at_points("BP4", 2, 3, 2, peer=False)
    assert record.name == "elements, BP4, p = 2, 27 points, amrpic"
    assert len(record.seconds) == 2 and record.median > 0
    assert record.facts["unknowns"] == 3 * 5**3 and record.facts["points"] == 8 * 27
    assert record.facts["nominal flops"] == 8 * 27 * 3 * 360 and record.facts["peak"] > 1e9
    assert "MDoF/s" in points.printed(record)


@pytest.mark.parametrize("problem", points.PROBLEMS)
def test_libceed_has_the_same_product(problem):
    pytest.importorskip("libceed")
    kind, components = points.PROBLEMS[problem]
    mesh = fem.Mesh(MPI.COMM_SELF, 0, (1, 2, 1), (3, 2, 4), degree=2, max_grid_size=2)
    theirs, u = ceed_peer.AtGauss(mesh, kind, components), points.vector(mesh, components)
    theirs.set(u)
    theirs.apply()
    ours = (kind(fem.gauss(mesh), components=components) @ u).ravel()
    assert np.abs(theirs.result() - ours).max() < 1e-13 * np.abs(ours).max()


def test_goals_compare_unknowns_per_second():
    facts = {"unknowns": 100, "points": 10, "nominal flops": 6e8, "peak": 1e9}
    records = [
        Record(points.record_name("BP3", 2, "64 points"), [1.0], facts=facts),
        Record(points.record_name("BP1", 3, "Gauss"), [1.0], facts=facts),
        Record(points.record_name("BP1", 3, "Gauss", "libCEED"), [3.0], facts=facts),
    ]
    found = {goal.what: goal for goal in goals.elements(goals.Found(records))}
    share = found["BP3 at points, degree 2, 64 points: nominal flops over the peak"]
    assert share.measured == pytest.approx(60) and share.verdict == "met"
    faster = found["BP1 at Gauss points, degree 3, against libCEED"]
    assert faster.measured == pytest.approx(3) and faster.verdict == "met"
    assert found["BP4 at points, degree 3, 64 points: nominal flops over the peak"].verdict == "not measured"


def test_solids_are_timed_in_turns_with_what_they_are_compared_with(monkeypatch):
    monkeypatch.setattr(points, "CELLS", {2: 2})
    monkeypatch.setattr(points, "STEP_CELLS", {1: 2})
    records = [*points.tangents(2), *points.load_step(1, 2), *points.solves(4), points.run_memory()]
    assert all("points/s" in points.printed(one) for one in records[:5])
    assert all("iterations" in points.printed(one) for one in records[5:7])
    assert "B a point" in points.printed(records[7]) and records[7].facts["points"] == 20**3 * 64
    found = {goal.what: goal for goal in goals.elements(goals.Found(records))}
    assert found["neo-Hookean tangent against BP4, points/s"].measured > 0
    assert found["locate, migrate, sort and weigh, degree 1, over a Newton iteration"].measured > 0
    assert found["memory of a run, degree 2, 64 points an element"].measured > 0
    assert found["p-multigrid over the diagonal, degree 2, contrast 800, 32³ elements"].verdict == "not measured"

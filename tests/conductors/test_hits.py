"""Particles meet the electrode that comes first on their way, at its surface, under the angle there."""

from itertools import pairwise

import numpy as np
import pytest

from amrpic import Electrode, shapes
from amrpic.conductors.hits import first_hits

BALL = Electrode("ball", shapes.Sphere((0, 0, 0), 0.5), voltage=1)
FOIL = Electrode("foil", shapes.Disk((0, 0, 0.7), (0, 0, 1), 0.4), voltage=2)
ROD = Electrode("rod", shapes.Cylinder((-1, 0, -0.8), (1, 0, -0.8), 0.1), charge=0)
ALL = [BALL, FOIL, ROD]


def test_the_electrode_that_comes_first_is_met():
    start, end = np.array([(0.1, 0.0, 2.0)] * 3), np.array([(0.1, 0.0, -2.0)] * 3)
    start[1, 0] = end[1, 0] = 0.45  # beside the foil
    start[2], end[2] = (0.6, 0, 2), (0.6, 0, 1)
    hits = first_hits(ALL, start, end)
    assert hits.segment.tolist() == [0, 1] and hits.electrode.tolist() == [1, 0]
    assert hits.place == pytest.approx(np.array([(0.1, 0, 0.7), (0.45, 0, np.sqrt(0.25 - 0.45**2))]))
    assert hits.normal == pytest.approx(np.array([(0, 0, 1), (0.9, 0, np.sqrt(1 - 0.81))]))
    assert hits.cosine == pytest.approx([1, np.sqrt(1 - 0.81)])


def test_hits_do_not_depend_on_the_cuts_of_a_way():
    """A way in many parts meets the same place as in one."""
    rng = np.random.default_rng(1)
    start, way = rng.uniform(-1.5, 1.5, (400, 3)), 2 * rng.normal(size=(400, 3))
    whole = first_hits(ALL, start, start + way)
    shares = np.linspace(0, 1, 21)
    met: dict[int, tuple[int, np.ndarray]] = {}
    for one, other in pairwise(shares):
        part = first_hits(ALL, start + one * way, start + other * way)
        for segment, electrode, place in zip(part.segment.tolist(), part.electrode, part.place, strict=True):
            met.setdefault(segment, (int(electrode), place))
    assert sorted(met) == whole.segment.tolist() and len(met) > 30
    assert [met[segment][0] for segment in sorted(met)] == whole.electrode.tolist()
    assert np.array([met[segment][1] for segment in sorted(met)]) == pytest.approx(whole.place, abs=1e-12)


def test_what_starts_in_metal_is_met_at_once_and_what_rests_outside_is_not():
    hits = first_hits(ALL, [(0, 0, 0.1), (0.9, 0.9, 0)], [(0, 0, 0.1), (0.9, 0.9, 0)])
    assert hits.segment.tolist() == [0] and hits.share.tolist() == [0]


def test_nothing_is_met_without_electrodes():
    hits = first_hits([], [(0, 0, 0)], [(1, 0, 0)])
    assert len(hits.segment) == 0 and hits.normal.shape == (0, 3)

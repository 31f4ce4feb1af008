"""Fields with fields and numbers: cell by cell, with units that are kept; norms against NumPy."""

from __future__ import annotations

import numpy as np
import pytest

import amrpic

BOXES = [[((4, 4, 4), (11, 11, 11))]]


def field(unit: str = "V", boxes: list = BOXES, seed: int = 1) -> amrpic.Field:
    hierarchy = amrpic.Hierarchy(amrpic.Domain(-1, 1, 8), boxes, blocking_factor=4)
    return filled(hierarchy, unit, seed)


def filled(hierarchy: amrpic.Hierarchy, unit: str, seed: int) -> amrpic.Field:
    out = amrpic.Field(hierarchy, unit)
    return out.fill(lambda x, y, z: np.cos(3 * x + seed) + y * z).average_down()


def all_of(one: amrpic.Field) -> np.ndarray:
    return np.concatenate([one.array(level) for level in range(one.hierarchy.levels)])


def test_arithmetic_is_that_of_the_cells():
    a = field()
    b = filled(a.hierarchy, "V", 2)
    for made, expected in (
        (a + b, all_of(a) + all_of(b)),
        (a - b, all_of(a) - all_of(b)),
        (a * b, all_of(a) * all_of(b)),
        (a / b, all_of(a) / all_of(b)),
        (2 * a + 1, 2 * all_of(a) + 1),
        (1 - a / 2, 1 - all_of(a) / 2),
        (-abs(a), -np.abs(all_of(a))),
    ):
        np.testing.assert_array_equal(all_of(made), expected)
        assert made.hierarchy is a.hierarchy


def test_units_follow():
    phi = field("V")
    rho = filled(phi.hierarchy, "C/m^3", 2)
    assert [f.unit for f in (phi + phi, 2 * phi, phi * rho, phi / phi, phi / rho)] == [
        "V",
        "V",
        "V C/m^3",
        "",
        "V/(C/m^3)",
    ]
    with pytest.raises(amrpic.InputError, match=r"a field in V and one in C/m\^3 cannot be added"):
        phi + rho
    with pytest.raises(amrpic.HierarchyError, match="two hierarchies"):
        phi + field("V")
    with pytest.raises(TypeError):
        phi + "1"  # type: ignore[operator]


@pytest.mark.mpi(ranks=(1, 2))
def test_norms_and_sums_are_over_uncovered_cells(comm):
    one = field()
    volumes = [np.full(p.data.shape, np.prod(one.hierarchy.spacing(p.level)))[~p.covered] for p in one.patches]
    values = [p.data[~p.covered] for p in one.patches]
    v, w = (np.concatenate(comm.allgather(np.concatenate([*parts, []]))) for parts in (values, volumes))
    assert one.sum() == pytest.approx(v.sum(), rel=1e-13)
    assert (one.min(), one.max()) == (v.min(), v.max())
    assert one.norm("max") == np.abs(v).max()
    assert one.norm("l1") == pytest.approx((np.abs(v) * w).sum(), rel=1e-13)
    assert one.norm() == pytest.approx(np.sqrt((v**2 * w).sum()), rel=1e-13)
    with pytest.raises(amrpic.InputError, match="'l3' is no norm; use l1, l2 or max"):
        one.norm("l3")


def test_a_field_is_filled_with_a_number_and_says_what_it_is():
    one = field("V").fill(3.0)
    assert one.integral() == pytest.approx(24.0)
    assert repr(one) == "Field(3 to 3 V; 512 + 512 cells on 2 levels)"

"""Laws of solids against differences of their energies, against each other, and against closed forms."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from amrpic import _native

YOUNG, NU = 300e6, 0.25
MU, LAMBDA = YOUNG / (2 * (1 + NU)), YOUNG * NU / ((1 + NU) * (1 - 2 * NU))
UNIT = np.eye(3)
NEO = _native.NeoHookean(MU, LAMBDA)
SAME = _native.Ogden([(MU, 2.0)], LAMBDA)
OGDEN = _native.Ogden([(0.6 * MU, 1.3), (0.5 * MU, 5.0), (-0.1 * MU, -2.0)], LAMBDA)
DAMAGED = _native.DamagedNeoHookean(MU, LAMBDA, 0.01)


class Law:
    """A law as functions of arrays: `energy(F)`, `stress(F)`, and `change(F, h)`, dP F' for dF = h F."""

    def __init__(self, law: Any, *damage: float) -> None:
        self.energy: Callable[[np.ndarray], float] = lambda f: law.energy(f.tolist(), *damage)
        self.stress = lambda f: np.array(law.stress(f.tolist(), *damage))
        self.change = lambda f, h: np.array(law.change(f.tolist(), h.tolist(), *damage))

    def first(self, f: np.ndarray) -> np.ndarray:
        """The first stress of Piola and Kirchhoff, by differences of the energy."""
        step = 1e-5
        out = np.empty((3, 3))
        for i in range(3):
            for j in range(3):
                d = np.zeros((3, 3))
                d[i, j] = step
                near, far = (self.energy(f + n * d) - self.energy(f - n * d) for n in (1, 2))
                out[i, j] = (8 * near - far) / (12 * step)
        return out


LAWS = {
    "neo-hookean": Law(NEO),
    "ogden, one term": Law(SAME),
    "ogden, three terms": Law(OGDEN),
    "damaged, whole": Law(DAMAGED, 0.0),
    "damaged, half": Law(DAMAGED, 0.5),
}


def deformations() -> list[np.ndarray]:
    """Small and large ones, stretched and pressed, with two and three equal stretches, turned."""
    rng = np.random.default_rng(2)
    turned = Rotation.from_rotvec([0.3, -2.0, 1.1]).as_matrix()
    large = [UNIT + 0.3 * rng.uniform(-1, 1, (3, 3)) for _ in range(4)]
    equal = [turned @ np.diag(s) @ turned.T for s in ([1.2, 1.2, 0.9], [0.8, 0.8, 0.8], [1.3, 1.3 + 1e-9, 1.1])]
    pressed = [np.diag([1, 1, 0.6]), np.diag([1, 1, 1.4]) @ turned]
    return [*large, *equal, *pressed, UNIT + 1e-3 * rng.uniform(-1, 1, (3, 3))]


@pytest.mark.parametrize("law", LAWS.values(), ids=LAWS)
@pytest.mark.parametrize("f", deformations())
def test_stress_is_the_slope_of_the_energy(law, f):
    kirchhoff = law.first(f) @ f.T
    assert np.abs(law.stress(f) - kirchhoff).max() < 1e-7 * YOUNG
    assert np.abs(law.stress(f) - law.stress(f).T).max() < 1e-12 * YOUNG


@pytest.mark.parametrize("law", LAWS.values(), ids=LAWS)
@pytest.mark.parametrize("f", deformations())
def test_tangent_is_the_slope_of_the_stress(law, f):
    rng = np.random.default_rng(3)
    for _ in range(3):
        h, step = rng.uniform(-1, 1, (3, 3)), 1e-4

        def first(by, h=h):
            moved = f + by * h @ f
            return law.stress(moved) @ np.linalg.inv(moved).T

        near, far = (first(n * step) - first(-n * step) for n in (1, 2))
        expected = (8 * near - far) / (12 * step) @ f.T
        assert np.abs(law.change(f, h) - expected).max() < 1e-7 * YOUNG


@pytest.mark.parametrize("law", LAWS.values(), ids=LAWS)
@pytest.mark.parametrize("f", deformations())
def test_tangent_is_symmetric(law, f):
    rng = np.random.default_rng(4)
    g, h = rng.uniform(-1, 1, (2, 3, 3))
    assert (g * law.change(f, h)).sum() == pytest.approx((h * law.change(f, g)).sum(), abs=1e-12 * YOUNG)


@pytest.mark.parametrize("law", [NEO, SAME, OGDEN], ids=["neo-hookean", "ogden, one term", "ogden, three terms"])
@pytest.mark.parametrize("f", deformations())
def test_the_tangent_is_the_same_in_the_initial_and_in_the_present_configuration(law, f):
    change = np.random.default_rng(5).uniform(-1, 1, (3, 3))
    initial = np.array(law.change_initially(f.tolist(), change.tolist())) @ f.T
    present = np.array(law.change(f.tolist(), (change @ np.linalg.inv(f)).tolist()))
    assert np.abs(initial - present).max() < 1e-12 * YOUNG


@pytest.mark.parametrize("f", deformations())
def test_ogden_with_one_term_is_neo_hookean(f):
    one, other = LAWS["ogden, one term"], LAWS["neo-hookean"]
    h = np.random.default_rng(6).uniform(-1, 1, (3, 3))
    assert one.energy(f) == pytest.approx(other.energy(f), abs=1e-12 * YOUNG)
    assert np.abs(one.stress(f) - other.stress(f)).max() < 1e-12 * YOUNG
    assert np.abs(one.change(f, h) - other.change(f, h)).max() < 1e-12 * YOUNG


@pytest.mark.parametrize("law", LAWS.values(), ids=LAWS)
def test_a_rotation_makes_no_stress_and_turns_stress_with_the_body(law):
    for angle in np.linspace(0, np.pi, 7):
        turn = Rotation.from_rotvec(angle * np.array([2, -1, 2]) / 3).as_matrix()
        assert np.abs(law.stress(turn)).max() < 1e-12 * YOUNG
        for f in deformations():
            assert np.abs(law.stress(turn @ f) - turn @ law.stress(f) @ turn.T).max() < 1e-12 * YOUNG


@pytest.mark.parametrize("law", [LAWS["neo-hookean"], LAWS["ogden, one term"]])
def test_confined_compression_has_the_closed_form(law):
    s = 0.6
    cauchy = law.stress(np.diag([1, 1, s])) / s
    assert cauchy[2, 2] == pytest.approx(-230.165e6, abs=500)
    assert cauchy[0, 0] == cauchy[1, 1] == pytest.approx(-102.165e6, abs=500)
    assert cauchy[2, 2] == pytest.approx(MU * (s - 1 / s) + LAMBDA * np.log(s) / s, rel=1e-12)


def test_small_strains_have_hookes_law():
    e = 1e-6 * np.array([[1, 0.5, 0], [0.5, -2, 0.3], [0, 0.3, 0.7]])
    hooke = LAMBDA * np.trace(e) * UNIT + 2 * MU * e
    for name in ("neo-hookean", "ogden, one term", "damaged, whole"):
        assert np.abs(LAWS[name].stress(UNIT + e) - hooke).max() < 1e-5 * np.abs(hooke).max(), name


def test_damage_degrades_what_drives_it():
    residual = 0.01
    for f in deformations():
        pressed = np.linalg.det(f) < 1
        by = (1 - residual) * 0.3**2 + residual
        whole, damaged = (DAMAGED.energy(f.tolist(), d) for d in (0.0, 0.7))
        driving = DAMAGED.driving_energy(f.tolist())
        assert driving >= -1e-15 * YOUNG
        assert whole - damaged == pytest.approx((1 - by) * driving, abs=1e-12 * YOUNG)
        if not pressed:
            assert damaged == pytest.approx(by * whole, abs=1e-12 * YOUNG)
    volume_alone = 0.9 * UNIT  # pressure is borne by what is broken
    assert DAMAGED.energy(volume_alone.tolist(), 1.0) == pytest.approx(DAMAGED.energy(volume_alone.tolist(), 0.0))
    assert DAMAGED.energy((1.1 * UNIT).tolist(), 1.0) == pytest.approx(
        0.01 * DAMAGED.energy((1.1 * UNIT).tolist(), 0.0)
    )


def test_damage_of_one_point_is_where_its_energy_is_least():
    """2 (1 - k) (1 - d) H = G/ℓ d, which is the slope of g(d) H + G/(2ℓ) d²."""
    toughness, length, k = 60.0, 0.25e-3, 0.01
    assert DAMAGED.damage_of(0.0, toughness, length) == 0
    before = 0.0
    for driving in (1e3, 1e5, 1e7):
        d = DAMAGED.damage_of(driving, toughness, length)
        assert before < d < 1
        assert 2 * (1 - k) * (1 - d) * driving == pytest.approx(toughness / length * d, rel=1e-10)
        before = d

"""Fields of elements against independent formulas, Maxwell's equations, and quadrature along flights."""

from __future__ import annotations

import math
from collections.abc import Callable
from itertools import pairwise
from typing import Any

import numpy as np
import pytest
from scipy.integrate import quad, quad_vec, solve_ivp
from scipy.spatial.transform import Rotation
from scipy.special import ellipe, ellipk, j0, j1, jn_zeros

from amrpic.external import ExternalFields
from amrpic.mesh.window import axes
from amrpic.scene.elements import (
    ENGE_OF_DIPOLES,
    ENGE_OF_QUADRUPOLES,
    CavityElement,
    ConstantFocusingElement,
    DipoleElement,
    Element,
    GapElement,
    MultipoleElement,
    QuadrupoleElement,
    SolenoidElement,
    UniformElement,
)
from amrpic.units import SPEED_OF_LIGHT

C = SPEED_OF_LIGHT
RNG = np.random.default_rng
TIME = 0.37e-9  # s

ENGE: dict[str, Any] = {"fringe": "enge", "gap": 0.04}
SMOOTH: dict[str, Element] = {
    "quadrupole": QuadrupoleElement(kind="quadrupole", length=0.2, gradient=12.0, **ENGE),
    "dipole": DipoleElement(kind="dipole", length=0.3, field=0.8, **ENGE),
    "turned dipole": DipoleElement(kind="dipole", length=0.3, field=0.8, entrance_angle=0.5, exit_angle=-0.3, **ENGE),
    "solenoid": SolenoidElement(kind="solenoid", length=0.3, field=0.5, fringe="sheet", radius=0.1),
    "rf-gap": GapElement(kind="rf-gap", length=0.2, voltage=1e6, frequency=500e6, phase=0.4),
    "static gap": GapElement(kind="rf-gap", length=0.2, voltage=1e6),
}
HARD: dict[str, Element] = {
    "uniform": UniformElement(
        kind="uniform", length=0.2, electric_field=(1e5, -2e5, 3e5), magnetic_field=(0.1, 0.2, -0.3)
    ),
    "focusing": ConstantFocusingElement(kind="constant-focusing", length=0.2, gradient=(1e6, -2e6, 3e6)),
    "quadrupole": QuadrupoleElement(kind="quadrupole", length=0.2, gradient=12.0),
    "dipole": DipoleElement(kind="dipole", length=0.2, field=0.8),
    "solenoid": SolenoidElement(kind="solenoid", length=0.2, field=0.5),
    "multipole": MultipoleElement(kind="multipole", length=0.2, normal=[0.1, -2.0], skew=[-0.05, 3.0]),
}
TURNED = DipoleElement(kind="dipole", length=0.2, field=0.8, entrance_angle=0.6, exit_angle=-0.4)
CAVITY = CavityElement(kind="cavity", length=0.2, field=2e6, frequency=1.3e9, phase=0.3)
EVERY = {
    **SMOOTH,
    **{f"hard {key}": element for key, element in HARD.items()},
    "cavity": CAVITY,
    "hard turned dipole": TURNED,
}


def moved(element: Element, **changes: Any) -> Any:
    """An element of other values, checked."""
    return type(element).model_validate({**element.model_dump(exclude_unset=True), **changes})


def fields_of(*elements: Element) -> Callable[..., tuple[np.ndarray, np.ndarray]]:
    return ExternalFields(elements).fields


def derivatives(f: Callable[[np.ndarray], np.ndarray], x: float, order: int, radius: float) -> np.ndarray:
    """Value and derivatives of an analytic function, by Cauchy's integral on a circle."""
    n = 64
    around = radius * np.exp(2j * np.pi * np.arange(n) / n)
    series = np.fft.fft(f(x + around)).real / n
    return np.array([math.factorial(k) * series[k] / radius**k for k in range(order + 1)])


def enge_profile(z: np.ndarray, length: float, gap: float, coefficients: tuple[float, ...]) -> np.ndarray:
    def fall(s: np.ndarray) -> np.ndarray:
        return 1 / (1 + np.exp(sum(c * (s / gap) ** n for n, c in enumerate(coefficients))))

    return fall(z - length / 2) + fall(-z - length / 2) - 1


# ---- each against an independent formula ----


@pytest.mark.parametrize("seed", range(20))
def test_quadrupole_with_fringes_is_its_series(seed):
    x, y, z = RNG(seed).uniform(-1, 1, 3) * (0.01, 0.01, 0.2)
    f = derivatives(lambda z: enge_profile(z, 0.2, 0.04, ENGE_OF_QUADRUPOLES), z, 3, 0.008)
    expected = [
        f[0] * y - f[2] * (3 * x * x * y + y**3) / 12,
        f[0] * x - f[2] * (x**3 + 3 * x * y * y) / 12,
        f[1] * x * y - f[3] * (x**3 * y + x * y**3) / 12,
    ]
    E, B = fields_of(SMOOTH["quadrupole"])([[x, y, z]])
    assert np.allclose(B[0], 12 * np.array(expected), rtol=1e-9, atol=1e-12)
    assert not E.any()


@pytest.mark.parametrize("seed", range(20))
def test_dipole_with_fringes_is_its_series(seed):
    x, y, z = RNG(seed).uniform(-1, 1, 3) * (0.01, 0.01, 0.25)
    f = derivatives(lambda z: enge_profile(z, 0.3, 0.04, ENGE_OF_DIPOLES), z, 3, 0.008)
    expected = [0, f[0] - f[2] * y * y / 2, f[1] * y - f[3] * y**3 / 6]
    assert np.allclose(fields_of(SMOOTH["dipole"])([[x, y, z]])[1][0], 0.8 * np.array(expected), rtol=1e-9, atol=1e-11)


def test_magnet_of_own_fringe_and_its_middle():
    own = moved(SMOOTH["quadrupole"], enge=[0.0, 4.0])
    z = np.linspace(-0.3, 0.3, 61)
    places = np.stack([0 * z, 0 * z + 1e-9, z], axis=1)
    expected = 12e-9 * enge_profile(z, 0.2, 0.04, (0.0, 4.0))
    assert np.allclose(fields_of(own)(places)[1][:, 0], expected, rtol=1e-12, atol=1e-21)
    assert fields_of(moved(own, length=2))([[0, 1e-3, 0]])[1][0, 0] == 12e-3


def coil(x: float, z: float, field: float, length: float, radius: float) -> tuple[float, float]:
    """B_x and B_z of a thin coil, by the field of its turns (J. D. Jackson, Classical Electrodynamics, 5.5)."""

    def turn(d: float) -> np.ndarray:
        a, r = radius, x
        q = (a + r) ** 2 + d * d
        m = 4 * a * r / q
        K, E = ellipk(m), ellipe(m)
        gap = (a - r) ** 2 + d * d
        radial = d / r * (-K + (a * a + r * r + d * d) / gap * E)
        axial = K + (a * a - r * r - d * d) / gap * E
        return np.array([radial, axial]) / (2 * np.pi * np.sqrt(q))

    total = quad_vec(lambda s: turn(z - s), -length / 2, length / 2, epsabs=1e-14, epsrel=1e-12)[0]
    return field * total[0], field * total[1]


@pytest.mark.parametrize("seed", range(5))
def test_coil_approaches_the_exact_one_with_fourth_and_fifth_order(seed):
    z = RNG(seed).uniform(-0.25, 0.25)
    radii = np.array([0.02, 0.01])
    B = fields_of(SMOOTH["solenoid"])([[x, 0, z] for x in radii])[1]
    exact = np.array([coil(x, z, 0.5, 0.3, 0.1) for x in radii])
    error = np.abs(B[:, [0, 2]] - exact)
    assert np.all(error[0] < 0.5 * np.array([0.2**5, 0.2**4]))
    orders = np.log2(error[0] / np.maximum(error[1], 1e-300))
    assert np.all((orders > np.array([4.7, 3.7])) | (error[1] < 1e-9)), orders


def test_coil_is_exact_on_its_axis():
    z = np.linspace(-0.6, 0.6, 21)
    turns = [quad(lambda d, s=s: 0.01 / (2 * ((s - d) ** 2 + 0.01) ** 1.5), -0.15, 0.15)[0] for s in z]
    B = fields_of(SMOOTH["solenoid"])(np.stack([0 * z, 0 * z, z], axis=1))[1]
    assert np.allclose(B[:, 2], 0.5 * np.array(turns), rtol=1e-10)
    assert not B[:, :2].any()


def test_gap_gives_its_voltage_and_a_width_of_two_fifths():
    fields = fields_of(SMOOTH["static gap"])
    assert quad(lambda z: fields([[0, 0, z]])[0][0, 2], -0.1, 0.1)[0] == pytest.approx(1e6, rel=1e-12)
    peak, half = fields([[0, 0, 0], [0, 0, 0.04]])[0][:, 2]
    assert half / peak == pytest.approx(0.5, abs=0.01)
    assert not fields(RNG(1).uniform(-0.01, 0.01, (9, 3)))[1].any()


def test_gap_oscillates_with_its_frequency_and_phase():
    fields, static = fields_of(SMOOTH["rf-gap"]), fields_of(SMOOTH["static gap"])
    for t in (0.0, TIME, 3e-9):
        expected = static([[0, 0, 0.03]])[0][0, 2] * math.cos(2 * math.pi * 500e6 * t + 0.4)
        assert fields([[0, 0, 0.03]], t)[0][0, 2] == pytest.approx(expected, rel=1e-12)


@pytest.mark.parametrize("seed", range(10))
def test_cavity_is_bessel_up_to_its_radius(seed):
    omega = 2 * math.pi * 1.3e9
    radius = jn_zeros(0, 1)[0] * C / omega
    r = RNG(seed).uniform(0, radius, 8)
    angle = RNG(seed).uniform(0, 2 * np.pi, 8)
    places = np.stack([r * np.cos(angle), r * np.sin(angle), 0 * r + 0.05], axis=1)
    E, B = fields_of(CAVITY)(places, TIME)
    scale = 1e-15 * 2e6
    assert np.allclose(E[:, 2], 2e6 * j0(omega * r / C) * math.cos(omega * TIME + 0.3), rtol=1e-13, atol=scale)
    azimuthal = B[:, 1] * np.cos(angle) - B[:, 0] * np.sin(angle)
    assert np.allclose(azimuthal, -2e6 / C * j1(omega * r / C) * math.sin(omega * TIME + 0.3), rtol=1e-13)
    outside = fields_of(CAVITY)([[1.001 * radius, 0, 0], [0, 0, 0.1001]], TIME)
    assert not outside[0].any() and not outside[1].any()


# ---- Maxwell ----


def jacobian(fields: Callable[..., Any], place: np.ndarray, h: float) -> tuple[np.ndarray, np.ndarray]:
    """Derivatives [component, axis] of E and B, by central differences of sixth order."""
    weights = np.array([-1, 9, -45, 45, -9, 1]) / 60
    steps = h * np.array([-3, -2, -1, 1, 2, 3])
    E, B = [], []
    for axis in np.eye(3):
        around = fields(place + steps[:, None] * axis, TIME)
        E.append(weights @ around[0] / h)
        B.append(weights @ around[1] / h)
    return np.array(E).T, np.array(B).T


def curl(J: np.ndarray) -> np.ndarray:
    return np.array([J[2, 1] - J[1, 2], J[0, 2] - J[2, 0], J[1, 0] - J[0, 1]])


def maxwell_residuals(element: Element, place: np.ndarray) -> dict[str, float]:
    """What is left of Maxwell's equations in vacuum, in V/m², with B times c."""
    fields = fields_of(element)
    E, B = jacobian(fields, place, 1e-4)
    dt = 1e-4 / C
    weights, steps = np.array([-1, 9, -45, 45, -9, 1]) / 60, dt * np.array([-3, -2, -1, 1, 2, 3])
    later = [fields([place], TIME + step) for step in steps]
    E_t = sum(w * e[0] for w, (e, _) in zip(weights, later, strict=True)) / dt
    B_t = sum(w * b[0] for w, (_, b) in zip(weights, later, strict=True)) / dt
    return {
        "div E": abs(np.trace(E)),
        "div B": C * abs(np.trace(B)),
        "curl E": float(np.linalg.norm(curl(E) + B_t)),
        "curl B": C * float(np.linalg.norm(curl(B) - E_t / C**2)),
    }


# In which power of the distance from the axis an equation fails; the others hold exactly.
ORDERS = {
    "quadrupole": {"div B": 4},
    "dipole": {"div B": 3},
    "turned dipole": {"div B": 3},
    "solenoid": {"curl B": 3},
    "rf-gap": {"curl E": 3},
    "static gap": {"curl E": 3},
}


@pytest.mark.parametrize("name", SMOOTH)
@pytest.mark.parametrize("seed", range(4))
def test_smooth_fields_obey_maxwell_to_their_order(name, seed):
    rng = RNG(seed)
    z = rng.uniform(0.05, 0.085) if "gap" in name else rng.uniform(0.08, 0.12)
    angle = rng.uniform(0.3, 1.2)
    far, near = (
        maxwell_residuals(SMOOTH[name], np.array([x * math.cos(angle), y * math.sin(angle), z]))
        for x, y in ((8e-3, 8e-3), (8e-3 if name == "turned dipole" else 4e-3, 4e-3))  # as far from a face as before
    )
    E, B = fields_of(SMOOTH[name])([[8e-3 * math.cos(angle), 8e-3 * math.sin(angle), z]], TIME)
    scale = (np.linalg.norm(E) + C * np.linalg.norm(B)) / 0.01
    for equation, residual in far.items():
        if (order := ORDERS[name].get(equation)) is None:
            assert residual < 1e-8 * scale, equation
        else:
            assert math.log2(residual / near[equation]) > order - 0.1 or residual < 1e-8 * scale, equation
            assert residual < 0.05 * scale


def test_cavity_obeys_maxwell():
    for place in RNG(3).uniform(-0.05, 0.05, (5, 3)):
        residuals = maxwell_residuals(CAVITY, place)
        assert max(residuals.values()) < 1e-8 * 2e6 / 0.01, residuals


# ---- means along flights ----


def flights(seed: int, count: int = 200) -> tuple[np.ndarray, np.ndarray, float, float]:
    """Places and velocities that enter, leave, cross, stay in or miss a slab of ±0.1 m, either way, some without v_z."""
    rng = RNG(seed)
    dt = 1e-10
    position = rng.uniform(-1, 1, (count, 3)) * (0.01, 0.01, 0.25)
    velocity = rng.normal(0, 1, (count, 3)) * (1e7, 1e7, 1.0)
    velocity[:, 2] = rng.choice([0.0, 1e-3, 0.1, 1.0, 4.0], count) * rng.choice([-1, 1], count) * 1e9
    start, stop = ((-dt, 0.0), (0.0, dt))[seed % 2]
    return position, velocity, start, stop


def sampled_mean(fields: Callable[..., Any], x: np.ndarray, v: np.ndarray, start: float, stop: float) -> np.ndarray:
    """The mean of E and B, cut at the ends of the slab, by Gauss's quadrature between the cuts."""
    cuts = [(end - x[2]) / v[2] for end in (-0.1, 0.1)] if v[2] else []
    times = np.array([start, *sorted(t for t in cuts if start < t < stop), stop])
    nodes, weights = np.polynomial.legendre.leggauss(8)
    total = np.zeros(6)
    for a, b in pairwise(times):
        tau = (a + b) / 2 + (b - a) / 2 * nodes
        E, B = fields(x + tau[:, None] * v, TIME)
        total += (b - a) / 2 * (weights @ np.hstack([E, B]))
    return total / (stop - start)


def edge_mean(name: str, x: np.ndarray, v: np.ndarray, start: float, stop: float) -> np.ndarray:
    """What a flight gets where the field rises and falls over 3 nm, in place of the planes."""
    width = 3e-9
    total = np.zeros(6)
    for end, sign in ((-0.1, 1), (0.1, -1)):
        if v[2] == 0 or not start < (crossing := (end - x[2]) / v[2]) < stop:
            continue
        tau = crossing + np.linspace(-8, 8, 401) * width / abs(v[2])
        place = x + tau[:, None] * v
        rise = sign * np.exp(-(((place[:, 2] - end) / width) ** 2) / 2) / (width * math.sqrt(2 * math.pi))
        B = np.zeros((len(tau), 3))
        if name == "solenoid":
            B[:, :2] = -0.25 * place[:, :2] * rise[:, None]
        if name == "dipole":
            B[:, 2] = 0.8 * place[:, 1] * rise
        total[3:] += np.trapezoid(B, tau, axis=0)
    return total / (stop - start)


@pytest.mark.parametrize("name", HARD)
@pytest.mark.parametrize("seed", range(4))
def test_mean_between_hard_edges_is_that_of_quadrature(name, seed):
    position, velocity, start, stop = flights(seed)
    means = np.hstack(ExternalFields([HARD[name]]).means(position, velocity, TIME, start, stop))
    fields, kinds = fields_of(HARD[name]), set()
    for mean, x, v in zip(means, position, velocity, strict=True):
        expected = sampled_mean(fields, x, v, start, stop) + edge_mean(name, x, v, start, stop)
        scale = np.abs(expected).max()
        assert np.allclose(mean, expected, rtol=0, atol=1e-6 * scale)
        ends = np.abs(x[2] + v[2] * np.array([start, stop])) < 0.1
        crosses = v[2] != 0 and np.prod(x[2] + v[2] * np.array([start, stop])) < 0
        kinds.add((bool(ends[0]), bool(ends[1]), bool(crosses), bool(v[2] == 0)))
    assert len(kinds) >= 8  # in, out, through both, beside, at rest along z


def test_solenoid_edge_keeps_the_canonical_angular_momentum():
    x, v = np.array([0.003, -0.007, -0.1001]), np.array([0.0, 0.0, 2e7])
    dt = 1e-11
    B = ExternalFields([HARD["solenoid"]]).means([x], [v], 0.0, 0.0, dt)[1][0]
    kick = np.cross(v, B) * dt  # Δp / q
    gained = x[0] * kick[1] - x[1] * kick[0]
    assert gained == pytest.approx(-0.5 / 2 * (x[0] ** 2 + x[1] ** 2), rel=1e-12)


@pytest.mark.parametrize("name", [*HARD, "cavity"])
def test_flights_that_follow_each_other_add_up(name):
    slow = moved(CAVITY, frequency=1.0, phase=0.3)  # a faster field changes on the way
    fields = ExternalFields([HARD.get(name, slow)])
    position, velocity, start, stop = flights(7)
    stop, start = 1e-10, 0.0
    whole = np.hstack(fields.means(position, velocity, TIME, start, stop))
    if name == "cavity":  # its field is not linear: only the share of the flight inside is exact
        position, velocity = position * (0, 0, 1), velocity * (0, 0, 1)
        whole = np.hstack(fields.means(position, velocity, TIME, start, stop))
    cuts = np.sort(RNG(5).uniform(start, stop, 6))
    parts = [
        (b - a) * np.hstack(fields.means(position, velocity, TIME, a, b))
        for a, b in zip([start, *cuts], [*cuts, stop], strict=True)
    ]
    assert np.allclose(sum(parts) / (stop - start), whole, rtol=1e-9, atol=1e-9 * np.abs(whole).max())


@pytest.mark.parametrize("start, stop", [(-3e-10, 0.0), (0.0, 4e-10)])
def test_a_cavity_acts_at_the_time_in_the_middle_of_the_part_inside(start, stop):
    """Along its axis, in to both sides and across; by eights and one by one."""
    x = np.zeros((9, 3))
    x[:, 2] = -0.115, -0.11, -0.09, -0.085, 0, 0.09, 0.095, 0.105, -0.15
    v = np.array([0.0, 0.0, 1e8]) * np.array([1, -1, 1, -1, 1, -1, 1, -1, 1])[:, None]
    v[-1, 2] = 7.5e8  # across, if forwards
    ends = np.sort((np.array([[-0.1], [0.1]]) - x[:, 2]) / v[:, 2], axis=0)
    enters, leaves = np.clip(ends, start, stop)
    middle, share = (enters + leaves) / 2, (leaves - enters) / (stop - start)
    strength = CAVITY.field * share * np.cos(2 * np.pi * CAVITY.frequency * (TIME + middle) + CAVITY.phase)
    native = ExternalFields([CAVITY]).native
    for by_eights in (True, False):
        E, B = native.means(x, v, TIME, start, stop, by_eights)
        assert E[:, 2] == pytest.approx(strength, rel=1e-9, abs=1e-3)
        assert not B.any()
    assert np.count_nonzero((share > 0) & (share < 1)) >= 3


def test_an_end_exactly_on_an_edge_counts_once():
    fields = ExternalFields([HARD["solenoid"]])
    x = np.array([[0.004, 0.002, 0.1]])
    for sign in (1, -1):
        v = sign * np.array([[0.0, 0.0, 1e7]])
        before, after = fields.means(x, v, 0, -1e-10, 0)[1], fields.means(x, v, 0, 0, 1e-10)[1]
        radial = (before + after)[0, 0] * 1e-3  # times the way
        assert radial == pytest.approx(0.5 * 0.004 / 2, rel=1e-9)


@pytest.mark.parametrize("name", HARD)
def test_flights_that_pass_an_end_are_known(name):
    fields = ExternalFields([HARD[name]])
    position, velocity, _, _ = flights(3, 1000)
    dt = 5e-11
    ends = fields.native.edges(position, velocity, -dt, dt)[4]
    z = position[:, 2:] + velocity[:, 2:] * np.array([-dt, dt])
    inside = np.abs(z) < 0.1
    assert np.array_equal(ends == 1, (inside[:, 0] != inside[:, 1]) | (~inside.any(axis=1) & (z[:, 0] * z[:, 1] < 0)))
    # the others may take the field at their place for both halves
    whole = np.hstack(fields.means(position, velocity, TIME, -dt, dt))
    at_place = np.hstack(fields.fields(position, TIME))
    assert np.allclose(whole[ends == 0], at_place[ends == 0], rtol=1e-9, atol=1e-9 * np.abs(at_place).max())


def test_smooth_fields_are_those_at_the_place():
    position, velocity, start, stop = flights(2)
    for element in SMOOTH.values():
        fields = ExternalFields([element])
        assert np.array_equal(
            np.hstack(fields.means(position, velocity, TIME, start, stop)), np.hstack(fields.fields(position, TIME))
        )


# ---- turned pole faces ----


def crossings(x: np.ndarray, v: np.ndarray, start: float, stop: float) -> list[float]:
    """When a flight passes a face of `TURNED`, between start and stop."""
    e1, e2 = TURNED.entrance_angle, TURNED.exit_angle
    times = []
    for place, slope in ((-0.1, math.tan(e1)), (0.1, -math.tan(e2))):
        speed = v[2] - slope * v[0]
        times += [(place - x[2] + slope * x[0]) / speed] if speed else []
    return [t for t in times if start < t < stop]


@pytest.mark.parametrize("seed", range(4))
def test_mean_between_turned_faces_is_that_of_a_narrow_fringe(seed):
    """The field in the planes of hard faces is what a fringe has in the limit of no gap, per angle of crossing."""
    position, velocity, start, stop = flights(seed, 60)
    position *= (10, 1e-4, 1)  # in x up to where the faces meet; in y within the gap, where the series holds
    velocity *= (10, 0, 1)
    hard = ExternalFields([TURNED]).means(position, velocity, TIME, start, stop)[1]
    narrow = fields_of(moved(TURNED, fringe="enge", gap=1e-6, enge=[0.0, 4.0]))
    for mean, x, v in zip(hard, position, velocity, strict=True):
        points = [t + s * 3e-5 / np.linalg.norm(v) for t in crossings(x, v, start, stop) for s in (-1, 0, 1)]
        nodes = np.unique(np.clip([start, *points, stop], start, stop))
        expected = np.zeros(3)
        for a, b in pairwise(nodes):
            tau = np.linspace(a, b, 4001)
            expected += np.trapezoid(narrow(x + tau[:, None] * v)[1], tau, axis=0)
        off = np.abs(mean - expected / (stop - start))
        assert off[1] < 1e-4 * 0.8
        assert (off[[0, 2]] < 1e-3 * max(0.8 * 1e-6 / np.linalg.norm(v * (stop - start)), *np.abs(mean[[0, 2]]))).all()


def test_positive_face_shortens_the_magnet_at_positive_x():
    inside = fields_of(moved(TURNED, exit_angle=0.6))([[0.05, 0, z] for z in (-0.08, 0.0, 0.08)])[1][:, 1]
    assert np.array_equal(inside, [0, 0.8, 0])
    inside = fields_of(moved(TURNED, exit_angle=0.6))([[-0.05, 0, z] for z in (-0.12, 0.0, 0.12)])[1][:, 1]
    assert np.array_equal(inside, [0.8, 0.8, 0.8])


def test_no_field_behind_the_edge_where_turned_faces_meet():
    wedge = moved(TURNED, exit_angle=0.6)  # faces meet at x = 0.1 m / tan 0.6
    x = 0.1 / math.tan(0.6) + np.array([0.2, 0.5, 3.0])
    places = np.stack([x, 0 * x, 0 * x], axis=1)
    assert not fields_of(wedge)(places)[1].any()
    assert np.abs(fields_of(moved(wedge, **ENGE))(places)[1]).max() < 1e-12


# ---- eight at a time, turned, many ----


def drawn_elements(seed: int, count: int) -> list[Element]:
    """Elements of all kinds somewhere along z, half of them tilted."""
    rng = RNG(seed)
    out: list[Element] = []
    for number in range(count):
        element = list(EVERY.values())[rng.integers(len(EVERY))]
        direction = rng.normal(0, 0.2, 3) * (number % 2) + [0, 0, rng.choice([-1, 1])]
        out.append(
            moved(
                element,
                centre=(rng.uniform(-1, 1, 3) * (0.01, 0.01, 2)).tolist(),
                direction=direction.tolist(),
                roll=rng.uniform(-4, 4),
            )
        )
    return out


@pytest.mark.parametrize("seed", range(6))
def test_eight_at_a_time_give_the_same_bits(seed):
    position, velocity, start, stop = flights(seed, 203)
    position[:, 2] *= 8
    native = ExternalFields(drawn_elements(seed, 30)).native
    eights = native.means(position, velocity, TIME, start, stop)
    singles = native.means(position, velocity, TIME, start, stop, by_eights=False)
    assert np.array_equal(eights[0], singles[0]) and np.array_equal(eights[1], singles[1])
    assert np.abs(eights[0]).max() > 0 and np.abs(eights[1]).max() > 0


def test_what_a_flight_gets_does_not_depend_on_those_beside_it():
    position, velocity, start, stop = flights(5, 400)
    position[:, 2] *= 8
    fields = ExternalFields(drawn_elements(5, 30))
    order = RNG(5).permutation(400)
    for together, shuffled in zip(
        fields.means(position, velocity, TIME, start, stop),
        fields.means(position[order], velocity[order], TIME, start, stop),
        strict=True,
    ):
        assert np.array_equal(together[order], shuffled)


@pytest.mark.parametrize("seed", range(3))
def test_fields_of_many_elements_add_up(seed):
    elements = drawn_elements(seed, 40)
    position, velocity, start, stop = flights(seed)
    position[:, 2] *= 8
    alone = [np.hstack(ExternalFields([one]).means(position, velocity, TIME, start, stop)) for one in elements]
    together = np.hstack(ExternalFields(elements).means(position, velocity, TIME, start, stop))
    assert np.allclose(together, sum(alone), rtol=1e-12, atol=1e-9 * np.abs(together).max(axis=0))


@pytest.mark.parametrize("name", EVERY)
@pytest.mark.parametrize("seed", range(3))
def test_turned_element_has_the_turned_field(name, seed):
    rng = RNG(seed)
    direction, roll = rng.normal(0, 1, 3), rng.uniform(-3, 3)
    z = direction / np.linalg.norm(direction)
    turn_axis = np.cross([0, 0, 1], z)
    angle = math.atan2(np.linalg.norm(turn_axis), z[2])
    tilt = Rotation.from_rotvec(angle * turn_axis / np.linalg.norm(turn_axis))
    turn = tilt * Rotation.from_rotvec([0, 0, roll])
    centre = rng.uniform(-1, 1, 3)
    position, velocity, start, stop = flights(seed)
    element = moved(EVERY[name], centre=centre.tolist(), direction=direction.tolist(), roll=roll)
    straight = ExternalFields([EVERY[name]]).means(position, velocity, TIME, start, stop)
    turned = ExternalFields([element]).means(turn.apply(position) + centre, turn.apply(velocity), TIME, start, stop)
    for expected, found in zip(straight, turned, strict=True):
        assert np.allclose(turn.apply(expected), found, rtol=1e-7, atol=1e-8 * np.abs(expected).max())


def test_element_that_looks_back_is_turned_about_y():
    quadrupole, dipole = (fields_of(moved(HARD[k], direction=[0, 0, -1])) for k in ("quadrupole", "dipole"))
    assert np.allclose(quadrupole([[1e-3, 2e-3, 0]])[1], [[-24e-3, -12e-3, 0]], atol=1e-15)
    assert np.allclose(dipole([[1e-3, 2e-3, 0]])[1], [[0, 0.8, 0]])


def test_positive_quadrupole_focuses_positive_particles_in_x():
    B = fields_of(HARD["quadrupole"])([[1e-3, 0, 0], [0, 1e-3, 0]])[1]
    force = np.cross([0, 0, 1.0], B)
    assert force[0, 0] < 0 and force[1, 1] > 0


def test_field_without_ends_is_everywhere_and_taken_at_the_place():
    element = moved(HARD["focusing"], length=None)
    far = [[1e3, -1e3, 1e6]]
    E = ExternalFields([element]).means(far, [[1e8, 1e8, 1e8]], 0.0, -1e-9, 0.0)[0]
    assert np.array_equal(E, [[-1e9, -2e9, -3e12]])


def test_no_elements_give_no_field():
    fields = ExternalFields()
    assert not fields.native.electric and not fields.native.magnetic
    assert not np.hstack(fields.fields(np.zeros((3, 3)))).any()


def test_elements_say_which_fields_they_have():
    natives = {name: ExternalFields([one]).native for name, one in EVERY.items()}
    has = {name: (native.electric, native.magnetic) for name, native in natives.items()}
    assert has["quadrupole"] == (False, True) and has["hard focusing"] == (True, False)
    assert has["rf-gap"] == (True, True) and has["static gap"] == (True, False)


# ---- a leapfrog through hard edges ----


def rotated(v: np.ndarray, B: np.ndarray, duration: float) -> np.ndarray:
    """Boris's rotation for q/(γm) = 1 C/kg."""
    t = B * duration / 2
    s = 2 * t / (1 + (t * t).sum(axis=1, keepdims=True))
    return v + np.cross(v + np.cross(v, t), s)


def half_kick(fields: ExternalFields, x: np.ndarray, v: np.ndarray, start: float, stop: float) -> tuple[Any, Any]:
    """What a half step does to places and velocities: planes where the flight enters, inside, planes where it leaves."""
    first, last, when, normal, _ = fields.native.edges(x, v, start, stop)
    inside = fields.means(x, v, 0.0, start, stop)[1] - first - last
    duration = stop - start
    entered = rotated(v, first, duration)
    now = rotated(entered, inside, duration)
    slower = np.abs((v * normal).sum(axis=1) / (now * normal).sum(axis=1))[:, None]
    left = rotated(now, slower * last, duration)
    return x - (entered - v) * when[:, :1] - (left - now) * when[:, 1:2], left


def leapfrog(fields: ExternalFields, x: np.ndarray, v: np.ndarray, steps: int) -> tuple[np.ndarray, np.ndarray]:
    dt = 0.4 / steps
    for _ in range(steps):
        x, v = half_kick(fields, x, v, 0.0, dt / 2)
        x, v = half_kick(fields, x + v * dt, v, -dt / 2, 0.0)
    return x, v


def exact_passage(name: str, x: np.ndarray, v: np.ndarray) -> np.ndarray:
    """Place and velocity after 0.4 s, through the planes at ±0.1 m of a field of strength 2, or those of turned faces."""
    slopes = (math.tan(0.6), math.tan(0.4)) if name == "turned dipole" else (0.0, 0.0)
    normals = [np.array([-slope, 0, 1]) for slope in slopes]

    def inside(_: float, y: np.ndarray) -> np.ndarray:
        dipole = [0, 2, 0]
        B = {"quadrupole": [2 * y[1], 2 * y[0], 0], "solenoid": [0, 0, 2]}.get(name, dipole)
        return np.concatenate([y[3:], np.cross(y[3:], B)])

    def edge(y: np.ndarray, sign: float, normal: np.ndarray) -> np.ndarray:
        dipole = 2 * y[1] * normal
        B = {"quadrupole": [0, 0, 0], "solenoid": [-y[0], -y[1], 0]}.get(name, dipole)
        return np.concatenate([y[:3], Rotation.from_rotvec(-sign * np.array(B) / abs(normal @ y[3:])).apply(y[3:])])

    def leaves(_: float, y: np.ndarray) -> float:
        return float(normals[1] @ y[:3] - 0.1)

    leaves.terminal = True  # type: ignore[attr-defined]
    arrival = (-0.1 - normals[0] @ x) / (normals[0] @ v)
    entered = edge(np.concatenate([x + v * arrival, v]), 1, normals[0])
    passage = solve_ivp(inside, (0, 1), entered, events=leaves, rtol=1e-11, atol=1e-14, method="DOP853")
    left = edge(passage.y[:, -1], -1, normals[1])
    left[:3] += left[3:] * (0.4 - arrival - passage.t[-1])
    return left


@pytest.mark.parametrize("name", ["quadrupole", "solenoid", "dipole", "turned dipole"])
@pytest.mark.parametrize("tilted", [False, True])
def test_leapfrog_through_hard_edges_is_of_second_order(name, tilted):
    strength = "gradient" if name == "quadrupole" else "field"
    element = moved(TURNED if name == "turned dipole" else HARD[name], **{strength: 2.0})
    rng = RNG(11)
    x, v = rng.normal(0, 1e-3, (24, 3)), rng.normal((0, 0, 1.5), 1e-2, (24, 3))
    x[:, 2] = rng.uniform(-0.3, -0.28, 24)
    exact = np.array([exact_passage(name, *one) for one in zip(x, v, strict=True)])
    turn = Rotation.from_rotvec([0.3, 0.4, 0]) if tilted else Rotation.identity()
    fields = ExternalFields([moved(element, direction=turn.apply([0, 0, 1]).tolist())])
    turned = np.array(axes(tuple(turn.apply([0, 0, 1])), 0.0))
    errors = []
    coarse = 50 if name == "turned dipole" else 25  # steps from which on the order shows
    for steps in (coarse * 2**k for k in range(5)):
        places, velocities = leapfrog(fields, x @ turned, v @ turned, steps)
        errors.append(np.linalg.norm(np.hstack([places @ turned.T, velocities @ turned.T]) - exact, axis=1).mean())
    order = -np.polyfit(np.log(2.0) * np.arange(5), np.log(errors), 1)[0]
    assert order > 1.85


# ---- multipoles and reach ----
def test_a_multipole_is_a_power_of_the_place():
    """B_y + i B_x = Σ (b_n + i a_n) (x + i y)^n / n!"""
    element = MultipoleElement(
        kind="multipole", length=0.2, normal=[0.1, -2.0, 30.0, 0.0, 2e4, 5e5], skew=[-0.05, 3.0, 20.0, 400.0]
    )
    x, y = RNG(5).uniform(-0.02, 0.02, (2, 50))
    expected = sum(
        (b + 1j * a) * (x + 1j * y) ** n / math.factorial(n)
        for n, (b, a) in enumerate(zip(element.normal, [*element.skew, 0.0, 0.0], strict=True))
    )
    _, found = ExternalFields([element]).fields(np.stack([x, y, 0 * x], axis=1))
    assert found[:, 1] + 1j * found[:, 0] == pytest.approx(expected, rel=1e-12)
    assert (found[:, 2] == 0).all()


@pytest.mark.parametrize("name", HARD)
def test_elements_act_within_their_reach_alone(name):
    direction, centre = (0.6, -0.2, 0.7), np.array([0.1, 0.2, -0.3])
    wide = HARD[name].model_copy(update={"direction": direction, "centre": tuple(centre)})
    narrow = wide.model_copy(update={"reach": 0.02})
    frame = np.array(axes(direction, 0.0))
    own = RNG(6).uniform(-0.04, 0.04, (400, 3))
    v = RNG(7).normal(size=(400, 3)) * 0.1 * C + 0.3 * C * frame[2]
    flights = own @ frame + centre, v, TIME, -2e-10, 0.0
    near = np.hypot(own[:, 0], own[:, 1]) <= 0.02
    for all_, within in zip(
        ExternalFields([wide]).means(*flights), ExternalFields([narrow]).means(*flights), strict=True
    ):
        assert within[near] == pytest.approx(all_[near], rel=1e-12, abs=1e-12)
        assert (within[~near] == 0).all()
    assert 50 < near.sum() < 350


def test_a_reach_leaves_the_other_side_of_a_ring_alone():
    """Two magnets that look past each other at the same z, one of them a turned one."""
    magnets = [
        QuadrupoleElement(kind="quadrupole", length=0.2, gradient=12.0, centre=(x, 0, 0), direction=way, reach=0.1)
        for x, way in ((-2.0, (0, 0, 1)), (2.0, (0.1, 0, -1)))
    ]
    places = np.array([[-2.0, 0.01, 0.05], [2.0, 0.01, 0.05], [0.0, 0.01, 0.05]])
    _, found = ExternalFields(magnets).fields(places)
    assert (np.abs(found[:2, 0]) > 0.1).all() and (found[2] == 0).all()

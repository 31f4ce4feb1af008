"""Rings of Xsuite with elements of space charge of ours; skipped where xtrack or xfields is missing."""

from __future__ import annotations

import itertools
from collections.abc import Callable, Iterator
from typing import Any

import numpy as np
import pytest
from scipy.optimize import fsolve
from scipy.special import ndtri
from scipy.stats import qmc

import amrpic
from amrpic.hosts import xsuite
from amrpic.units import ELEMENTARY_CHARGE, VACUUM_PERMITTIVITY

pytestmark = pytest.mark.long

PROTON = 938.27208943e6  # eV
GAMMA = 1.2
BETA = np.sqrt(1 - GAMMA**-2)
CELLS, QUADRUPOLE, DRIFT, STRENGTH = 8, 0.2, 0.8, 5.0  # number, m, m, 1/m²
EMITTANCE = 1e-5  # of the edge of a KV beam, four times the rms emittance, m
PERVEANCE = 4.00829777574895e-07  # makes a tune shift of 0.05
CLASSICAL_RADIUS = ELEMENTARY_CHARGE / (4 * np.pi * VACUUM_PERMITTIVITY * PROTON)  # m
HALF_CELL = [
    (QUADRUPOLE / 2, STRENGTH),
    (DRIFT, 0.0),
    (QUADRUPOLE, -STRENGTH),
    (DRIFT, 0.0),
    (QUADRUPOLE / 2, STRENGTH),
]


@pytest.fixture
def host(monkeypatch, tmp_path) -> Iterator[Any]:
    xtrack = pytest.importorskip("xtrack")
    monkeypatch.chdir(tmp_path)  # where setuptools finds no settings of ours
    with xtrack.settings.override(allow_kernel_compilation=True):
        yield xtrack


def ring(host: Any) -> Any:
    """A line of FODO cells that begins and ends in the middle of a focusing quadrupole."""
    elements = [
        host.Quadrupole(length=length, k1=k1) if k1 else host.Drift(length=length)
        for _ in range(CELLS)
        for length, k1 in HALF_CELL
    ]
    line = host.Line(elements=elements)
    line.particle_ref = host.Particles(mass0=PROTON, q0=1, gamma0=GAMMA)
    return line


# ---- theory: the envelope of a KV beam (M. Reiser, "Theory and design of charged particle beams", 4.4) ----
def through_a_cell(perveance: float, a: float, b: float) -> np.ndarray:
    """Half axes, their slopes and phases in x and y, (a, a', b, b', μ, ν), behind a cell, by fourth-order steps."""

    def slope(y: np.ndarray, k: float) -> np.ndarray:
        both = 2 * perveance / (y[0] + y[2])
        return np.array(
            [
                y[1],
                -k * y[0] + both + EMITTANCE**2 / y[0] ** 3,
                y[3],
                k * y[2] + both + EMITTANCE**2 / y[2] ** 3,
                EMITTANCE / y[0] ** 2,
                EMITTANCE / y[2] ** 2,
            ]
        )

    y, steps = np.array([a, 0.0, b, 0.0, 0.0, 0.0]), 20
    for length, k in HALF_CELL:
        h = length / steps
        for _ in range(steps):
            one = slope(y, k)
            two = slope(y + h / 2 * one, k)
            three = slope(y + h / 2 * two, k)
            y = y + h / 6 * (one + 2 * two + 2 * three + slope(y + h * three, k))
    return y


def matched(perveance: float) -> tuple[np.ndarray, np.ndarray]:
    """Half axes (2,) in m where the ring begins, and tunes (2,)."""
    axes = 1e-3 * fsolve(lambda mm: through_a_cell(perveance, *mm * 1e-3)[[1, 3]], [6.0, 3.6])
    return axes, through_a_cell(perveance, *axes)[4:] * CELLS / (2 * np.pi)


# ---- tracking ----
def track(line: Any, particles: Any, turns: int) -> np.ndarray:
    """x, px, y and py at the beginning and after each turn, (turns + 1, 4, n)."""
    seen = []
    for turn in range(turns + 1):
        if turn > 0:
            line.track(particles, num_turns=1)
        order = np.argsort(particles.particle_id)
        seen.append(np.stack([particles.x, particles.px, particles.y, particles.py])[:, order])
    assert (particles.state > 0).all()
    return np.stack(seen)


def emittances(seen: np.ndarray) -> np.ndarray:
    return np.array([[np.sqrt(np.linalg.det(np.cov(turn[d : d + 2]))) for d in (0, 2)] for turn in seen])


def tunes(seen: np.ndarray) -> np.ndarray:
    """Fractional tunes (2,), from the linear maps between turns that fit all particles best, below 0.5."""
    found = []
    for before, after in itertools.pairwise(seen):
        maps = [after[d : d + 2] @ np.linalg.pinv(before[d : d + 2]) for d in (0, 2)]
        found.append([np.arccos(np.trace(each) / 2) / (2 * np.pi) for each in maps])
    return np.mean(found, axis=0)


def test_a_coasting_kv_beam_keeps_its_emittance_and_has_the_tune_of_theory(host):
    """A hundred turns of a matched beam with a tune shift of 0.05."""
    number, period = 2**15, 0.2
    axes, tune = matched(PERVEANCE)
    shift = matched(0.0)[1] - tune
    assert shift == pytest.approx([0.05, 0.05], rel=1e-3)
    u = qmc.Sobol(4, scramble=True, seed=1).random(number)
    part = (np.sqrt(u[:, 0]), np.sqrt(1 - u[:, 0]))  # of the radius of the sphere in four dimensions
    angles, slopes = 2 * np.pi * u[:, 1:3].T, EMITTANCE / axes
    domain = amrpic.Domain(
        (-2.2 * axes.max(), -2.2 * axes.max(), 0.0),
        (2.2 * axes.max(), 2.2 * axes.max(), period),
        (64, 64, 4),
        {"z": "periodic"},
    )
    line = ring(host)
    settings: dict[str, Any] = {"domain": domain, "levels": 0, "compensation": "clouds-and-mesh"}
    xsuite.install_space_charge(line, 4 * CELLS, longitudinal=False, **settings)
    line.build_tracker()
    per_metre = PERVEANCE * BETA**2 * GAMMA**3 / (2 * CLASSICAL_RADIUS)
    particles = line.build_particles(
        x=axes[0] * part[0] * np.cos(angles[0]),
        px=slopes[0] * part[0] * np.sin(angles[0]),
        y=axes[1] * part[1] * np.cos(angles[1]),
        py=slopes[1] * part[1] * np.sin(angles[1]),
        zeta=period * u[:, 3],
        weight=per_metre * period / number,
    )
    seen = track(line, particles, 100)
    assert matched(0.0)[1] % 1 - tunes(seen) == pytest.approx(shift, rel=0.02)
    emittance = emittances(seen)
    assert np.abs(emittance / emittance[0] - 1).max() < 1e-3


def test_a_gaussian_bunch_grows_as_with_the_pic_of_xfields(host):
    """Twenty turns from the same particles, in the same cells: what grows goes with these, and with the particles in each."""
    xfields = pytest.importorskip("xfields")
    number, turns, kicks, length = 2**14, 20, 2 * CELLS, 1.0
    cells = (64, 64, 24)
    axes, _ = matched(PERVEANCE)
    u = ndtri(np.clip(qmc.Sobol(5, scramble=True, seed=2).random(number), 1e-9, 1 - 1e-9))
    sizes, slopes = axes / 2, EMITTANCE / axes / 2
    peak = PERVEANCE * BETA**2 * GAMMA**3 / (2 * CLASSICAL_RADIUS) * length * np.sqrt(2 * np.pi)
    start = dict(
        x=sizes[0] * u[:, 0],
        px=slopes[0] * u[:, 1],
        y=sizes[1] * u[:, 2],
        py=slopes[1] * u[:, 3],
        zeta=length * u[:, 4],
    )

    def with_elements(placed: Callable[[Any], Any]) -> np.ndarray:
        line = ring(host)
        placed(line)
        line.build_tracker()
        return track(line, line.build_particles(**start, weight=peak / number), turns)

    reach = 8 * sizes.max()

    def theirs(line: Any) -> None:
        for element in xsuite.install_space_charge(line, kicks):
            name = next(name for name in line.element_names if line.element_dict[name] is element)
            line.env.remove(name)
            line.env.elements[name] = xfields.SpaceCharge3D(
                length=element.length,
                update_on_track=True,
                apply_z_kick=False,
                x_range=(-reach, reach),
                y_range=(-reach, reach),
                z_range=(-6 * length, 6 * length),
                **dict(zip(("nx", "ny", "nz"), cells, strict=True)),
                solver="FFTSolver2p5D",
                gamma0=GAMMA,
            )

    box = amrpic.Domain((-reach, -reach, -6 * length), (reach, reach, 6 * length), cells)
    settings: dict[str, Any] = {"domain": box, "levels": 0, "compensation": "none", "longitudinal": False}
    ours = with_elements(lambda line: xsuite.install_space_charge(line, kicks, **settings))
    other = with_elements(theirs)
    growth, expected = (emittances(seen)[-1] / emittances(seen)[0] - 1 for seen in (ours, other))
    print("growth", growth, expected, "tunes", tunes(ours), tunes(other))
    assert growth == pytest.approx(expected, rel=0.2)
    assert tunes(ours) == pytest.approx(tunes(other), abs=1e-3)


def test_elements_take_the_place_of_frozen_ones(host):
    """A ring in which xfields has placed frozen space charge, tracked for a turn with ours in its place."""
    xfields = pytest.importorskip("xfields")
    line = ring(host)
    line.append("cavity", host.Cavity(voltage=1e4, frequency=BETA * 299792458.0 / line.get_length(), lag=0.0))
    profile = xfields.LongitudinalProfileQGaussian(number_of_particles=5e9, sigma_z=2.0, z0=0.0, q_parameter=1.0)
    xfields.install_spacecharge_frozen(
        line=line,
        longitudinal_profile=profile,
        nemitt_x=2e-6,
        nemitt_y=2e-6,
        sigma_z=2.0,
        num_spacecharge_interactions=16,
    )
    placed = xsuite.replace_space_charge(line, levels=1, cells=(32, 32, 16))
    assert len(placed) == 16 and sum(one.length for one in placed) == pytest.approx(line.get_length())
    assert len({id(one.charges) for one in placed}) == 1
    line.build_tracker()
    x, y, z = np.random.default_rng(1).normal(size=(3, 2000)) * np.array([[1e-3], [2e-3], [2.0]])
    charged = line.build_particles(x=x, y=y, zeta=z, weight=5e9 / 2000)
    alone = line.build_particles(x=x, y=y, zeta=z, weight=0.0)
    for each in (charged, alone):
        line.track(each, num_turns=1)
    assert (charged.state > 0).all() and np.abs(charged.x - alone.x).max() > 1e-9
    assert np.mean(charged.px) == pytest.approx(np.mean(alone.px), abs=1e-2 * np.std(charged.px - alone.px))


def test_copies_of_a_line_have_elements_of_their_own(host):
    line = ring(host)
    made = xsuite.install_space_charge(line, 4, cells=16, levels=0)
    other = line.copy()
    theirs = [other.element_dict[name] for name in other.element_names if name.startswith("space_charge")]
    assert [one.to_dict() for one in theirs] == [one.to_dict() for one in made]
    assert not {id(one.charges) for one in theirs} & {id(made[0].charges)}
